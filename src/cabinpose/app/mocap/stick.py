"""Bodies as stick figures from the front, the side and above, as inline SVG."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from html import escape

import numpy as np
from numpy.typing import NDArray

from cabinpose.app.report.charts import COLOURS

F64 = NDArray[np.float64]
# Axes of a picture (to the right, upwards) in a frame with x forward, y left, z up.
VIEWS = {"front": ((0, 1, 0), (0, 0, 1)), "side": ((1, 0, 0), (0, 0, 1)), "above": ((0, -1, 0), (1, 0, 0))}
_WIDTH, _HEIGHT, _MARGIN, _TITLE = 620, 300, 14, 20  # px


def stick_figure(
    title: str, bodies: Mapping[str, F64], limbs: Sequence[tuple[int, int]], *, links: Sequence[tuple[str, str]] = ()
) -> str:
    """Bodies (N, 3) m of the same joints over each other, seen three times; joints that are missing (NaN) are left out.

    limbs: pairs of joints with a line between them · links: pairs of bodies with thin lines between their joints (the errors).
    The front view is that of someone who faces the person: the left hand is on the right.
    """
    everything = np.concatenate(list(bodies.values()))
    known = everything[np.isfinite(everything).all(axis=1)]
    if not len(known):
        return ""
    panels, x = [], 0.0
    span = max(float(np.ptp(known @ np.array(axis, float))) for axes in VIEWS.values() for axis in axes[1:])
    scale = (_HEIGHT - 2 * _MARGIN - _TITLE) / max(span, 1e-6)
    for view, axes in VIEWS.items():
        across, up = (known @ np.array(axis, float) for axis in axes)
        width = max(float(np.ptp(across)) * scale, 60.0) + 2 * _MARGIN
        middle = (across.max() + across.min()) / 2, (up.max() + up.min()) / 2
        centre = x + width / 2, _TITLE + (_HEIGHT - _TITLE) / 2
        placed = {
            name: np.stack(
                (
                    centre[0] + (body @ np.array(axes[0], float) - middle[0]) * scale,
                    centre[1] - (body @ np.array(axes[1], float) - middle[1]) * scale,
                ),
                axis=1,
            )
            for name, body in bodies.items()
        }
        panels.append(f'<text x="{centre[0]:.1f}" y="14" class="middle">{view}</text>')
        panels += _errors(placed, links)
        for (_, points), colour in zip(placed.items(), COLOURS, strict=False):
            panels += _body(points, limbs, colour)
        x += width
    left = -max(_WIDTH - x, 0) / 2  # all figures have one width, and so letters of one size
    picture = f'<svg viewBox="{left:.0f} 0 {max(x, _WIDTH):.0f} {_HEIGHT}" class="chart" role="img">{"".join(panels)}</svg>'
    return f"<figure>{picture}<figcaption>{escape(title)}</figcaption></figure>"


def _body(points: F64, limbs: Sequence[tuple[int, int]], colour: str) -> list[str]:
    lines = [
        f'<line x1="{points[a, 0]:.1f}" y1="{points[a, 1]:.1f}" x2="{points[b, 0]:.1f}" y2="{points[b, 1]:.1f}" '
        f'stroke="{colour}" stroke-width="2" stroke-linecap="round" opacity="0.8"/>'
        for a, b in limbs
        if np.isfinite(points[[a, b]]).all()
    ]
    dots = [f'<circle cx="{u:.1f}" cy="{v:.1f}" r="2.6" fill="{colour}"/>' for u, v in points if np.isfinite(u + v)]
    return lines + dots


def _errors(placed: Mapping[str, F64], links: Sequence[tuple[str, str]]) -> list[str]:
    return [
        f'<line x1="{u0:.1f}" y1="{v0:.1f}" x2="{u1:.1f}" y2="{v1:.1f}" stroke="#c0392b" stroke-width="1"/>'
        for one, other in links
        for (u0, v0), (u1, v1) in zip(placed[one], placed[other], strict=True)
        if np.isfinite(u0 + v0 + u1 + v1)
    ]
