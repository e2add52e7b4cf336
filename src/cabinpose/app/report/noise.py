"""The page on a camera's noise, measured on walls: one HTML file without scripts, that needs no other file and no network."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from cabinpose.app.report.charts import COLOURS, Axis, Plot, charts, legend, nice_step
from cabinpose.app.report.html import Html, document, el, figure, picture_uri, section, table
from cabinpose.app.view.draw import amplitude_image, resized
from cabinpose.scene.sensor import F64, EmpiricalFit, Estimate, PhysicalFit, Wall

_Lines = Mapping[str, tuple[Sequence[float] | F64, Sequence[float] | F64]]
_HEIGHT = 180  # px of a picture
_UNITS = {
    "a_mm": "mm", "b_mm_per_m": "mm/m", "c_mm_per_m2": "mm/m²", "signal_e_per_s": "e⁻/s", "read_noise_e": "e⁻",
    "amplitude_per_electron": "per e⁻",
}  # fmt: skip


def noise_page(walls: Sequence[Wall], empirical: EmpiricalFit, physical: PhysicalFit | None) -> str:
    """The page (HTML) on the fits of the walls, in their order."""
    z, measured = empirical.z_m, 1e3 * empirical.sigma_m
    order = np.argsort(z)
    laws = {"measured": measured, "empirical": 1e3 * empirical.fitted_m}
    if physical is not None:
        laws["physical"] = 1e3 * physical.fitted_m
    lines: _Lines = {name: (z[order], values[order]) for name, values in laws.items()}
    residuals = {name: (z[order], 100 * (values / measured - 1)[order]) for name, values in laws.items() if name != "measured"}
    drawn = [
        _chart("σ of depth, mm", "distance, m", lines, dots=("measured",)),
        _chart("model − measured, %", "distance, m", {"": ([], []), **residuals}, dots=tuple(residuals)),
    ]
    if physical is not None:
        bins = np.argsort(physical.signal_e)
        e = np.log10(physical.signal_e[bins])
        seen, said = (1e3 * sigma[bins] for sigma in (physical.sigma_range_m, physical.fitted_range_m))
        of_bins: _Lines = {"measured": (e, seen), "": ([], []), "physical": (e, said)}
        drawn.append(_chart("σ of range, mm", "log₁₀ of signal, electrons", of_bins, dots=("measured",)))
    rows = [["wall", "distance m", "frames", "pixels", "bias mm", "flatness mm", *(f"σ {name} mm" for name in laws)]]
    for k, wall in enumerate(walls):
        facts = (f"{wall.distance_m:.3f}", wall.frames, int(wall.used.sum()))
        plane = f"{1e3 * wall.bias_m:+.1f}", f"{1e3 * wall.flatness_m:.1f}"
        rows.append([wall.name, *map(str, facts), *plane, *(f"{values[k]:.2f}" for values in laws.values())])
    found = {**empirical.parameters, **(physical.parameters if physical is not None else {})}
    sections = [
        section("Noise over distance and signal", legend(laws) + charts(drawn)),
        section("Coefficients", _parameters(found), "95 % intervals."),
        section("Walls", table(rows)),
        section("σ of each pixel", el("div", *map(_picture, walls), class_="shots"), "White: three times the median."),
    ]
    reach = f"{len(walls)} walls from {z.min():.2f} m to {z.max():.2f} m"
    return document("Noise of a camera", "Noise of a camera", reach, sections)


def _chart(title: str, x_label: str, lines: _Lines, dots: Sequence[str]) -> Html:
    """Lines, some of them as dots, in the colours of the legend; 0 is in view."""
    xs, ys = (np.concatenate([np.asarray(line[k], float) for line in lines.values()]) for k in (0, 1))
    step = nice_step(float(max(np.ptp(np.append(ys, 0.0)), 1e-3)) / 4)
    low, high = (float(step * f(v / step)) for f, v in ((np.floor, min(ys.min(), 0.0)), (np.ceil, max(ys.max(), 0.0))))
    margin = 0.03 * max(float(np.ptp(xs)), 1e-3)
    x_axis = Axis(float(xs.min()) - margin, float(xs.max()) + margin)
    plot = Plot(title, (420, 220), x_axis, Axis(low, high if high > low else low + step))
    plot.rows(np.round(np.arange(low, high + step / 2, step), 9).tolist())
    plot.columns()
    for (name, (x, y)), colour in zip(lines.items(), COLOURS, strict=False):
        if name in dots:
            places = (plot.at(float(u), float(v)) for u, v in zip(x, y, strict=True))
            plot.body += [el("circle", el("title", name), cx=u, cy=v, r=3, fill=colour) for u, v in places]
        else:
            plot.body.append(el("path", el("title", name), d=plot.path(x, y), fill="none", stroke=colour, stroke_width=1.8))
    return plot.svg(x_label)


def _parameters(found: Mapping[str, Estimate]) -> Html:
    rows = [["key", "value", "from", "to", "unit"]]
    rows += [[name, *(f"{v:.4g}" for v in (e.value, e.low, e.high)), _UNITS.get(name, "")] for name, e in found.items()]
    return table(rows, words=(0, 4))


def _picture(wall: Wall) -> Html:
    sigma_um = 1e6 * np.nan_to_num(wall.sigma_m)
    shown = amplitude_image(np.minimum(sigma_um, 65535).astype(np.uint16), 3e6 * float(np.nanmedian(wall.sigma_m)))
    sized = resized(shown, (round(shown.shape[1] * _HEIGHT / shown.shape[0]), _HEIGHT)).astype(np.uint8)
    return figure(el("img", src=picture_uri(sized), alt=""), f"{wall.distance_m:.2f} m")
