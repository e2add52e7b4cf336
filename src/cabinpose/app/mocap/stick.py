"""Bodies as stick figures from the front, the side and above, as inline SVG."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cabinpose.app.report.charts import COLOURS, line, svg, text
from cabinpose.app.report.html import Html, el, figure

F64 = NDArray[np.float64]
# Axes of a picture (to the right, upwards) in a frame with x forward, y left, z up.
VIEWS = {"front": ((0, 1, 0), (0, 0, 1)), "side": ((1, 0, 0), (0, 0, 1)), "above": ((0, -1, 0), (1, 0, 0))}
_WIDTH, _HEIGHT, _MARGIN, _TITLE = 620, 300, 14, 20  # px


def stick_figure(
    title: str, bodies: Mapping[str, F64], limbs: Sequence[tuple[int, int]], *, links: Sequence[tuple[str, str]] = ()
) -> Html:
    """Bodies (N, 3) m of the same joints over each other, seen three times; joints that are missing (NaN) are left out.

    limbs: pairs of joints with a line between them · links: pairs of bodies with thin lines between their joints (the errors).
    The front view is that of someone who faces the person: the left hand is on the right.
    """
    everything = np.concatenate(list(bodies.values()))
    known = everything[np.isfinite(everything).all(axis=1)]
    if not len(known):
        return Html()
    panels: list[Html] = []
    x = 0.0
    span = max(float(np.ptp(known @ np.array(axis, float))) for axes in VIEWS.values() for axis in axes[1:])
    scale = (_HEIGHT - 2 * _MARGIN - _TITLE) / max(span, 1e-6)
    for view, axes in VIEWS.items():
        across, up = (known @ np.array(axis, float) for axis in axes)
        width = max(float(np.ptp(across)) * scale, 60.0) + 2 * _MARGIN
        middle = (across.max() + across.min()) / 2, (up.max() + up.min()) / 2
        centre = x + width / 2, _TITLE + (_HEIGHT - _TITLE) / 2
        flat, shift = np.array(axes, float) * [[scale], [-scale]], np.array((middle[0], -middle[1])) * scale
        placed = {name: body @ flat.T - shift + centre for name, body in bodies.items()}
        panels.append(text(centre[0], 14, view, "middle"))
        panels += _errors(placed, links)
        for (_, points), colour in zip(placed.items(), COLOURS, strict=False):
            panels += _body(points, limbs, colour)
        x += width
    left = -max(_WIDTH - x, 0) / 2  # every figure has the same width, so that letters have the same size
    return figure(svg(max(x, _WIDTH), _HEIGHT, panels, left=left), title)


def _body(points: F64, limbs: Sequence[tuple[int, int]], colour: str) -> list[Html]:
    style: dict[str, Any] = {"stroke": colour, "stroke_width": 2, "stroke_linecap": "round", "opacity": 0.8}
    lines = [line(*points[a], *points[b], **style) for a, b in limbs if np.isfinite(points[[a, b]]).all()]
    return lines + [el("circle", cx=float(u), cy=float(v), r=2.6, fill=colour) for u, v in points if np.isfinite(u + v)]


def _errors(placed: Mapping[str, F64], links: Sequence[tuple[str, str]]) -> list[Html]:
    ends = (pair for one, other in links for pair in zip(placed[one], placed[other], strict=True))
    return [line(*a, *b, stroke="#c0392b", stroke_width=1) for a, b in ends if np.isfinite(a + b).all()]
