"""Where things worn lie on the body: fields over the skin's vertices, positive inside, zero along the border.

Fields are distances to the border in metres, roughly, on the average adult. They are smooth across the border, so that the
mesh can be cut along it and no border follows the edges of faces.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache
from types import MappingProxyType

import numpy as np

from cabinpose.core import Floats
from cabinpose.core import reproducible as rp
from cabinpose.scene.body.chart import load_chart

ARM_M, LEG_M, UP_M, NECK_M = 0.26, 0.42, 0.50, 0.08  # of a unit of the chart's coordinates, and of the neck's share

# Ends of the garments in the chart's units: the sleeve along the arm, the hem up the trunk, the collar as the share of the
# neck's weights that stays free, the leg along the leg.
TOP_ENDS: Mapping[str, tuple[float, float, float]] = MappingProxyType(
    {
        "t_shirt": (0.68, 0.02, 0.25), "long_sleeve": (1.95, 0.02, 0.35),
        "jumper": (1.95, 0.05, 0.45), "jacket": (2.02, 0.0, 0.60),
    }
)  # fmt: skip
BOTTOM_ENDS: Mapping[str, float] = MappingProxyType({"trousers": 1.99, "jeans": 1.99, "shorts": 0.78})
HEM_M = 0.006  # width of the strip beyond a garment's border over which it ends
_WAIST, _SOCK, _OVER_LAP = 0.27, 1.72, 0.08


def step(x: Floats, edge: float, width: float) -> Floats:
    """Smooth step from 0 to 1 about `edge`."""
    t = np.clip((x - edge) / width + 0.5, 0.0, 1.0)
    return np.asarray(t * t * (3 - 2 * t))


def bump(x: Floats, centre: float, width: float) -> Floats:
    """Bell curve of height 1."""
    return np.asarray(rp.exp(-(((x - centre) / width) ** 2)))


def _top(name: str) -> Floats:
    c, (sleeve, hem, collar) = load_chart(), TOP_ENDS[name]
    lap = _OVER_LAP * step(c.rest[:, 0], 0.03, 0.08)  # in front it lies on the lap of who sits, and not in the groin
    trunk = np.minimum((c.up - hem - lap) * UP_M, (collar - c.neck - c.head) * NECK_M)
    return np.where(c.arm > 0.5, (sleeve - c.along_arm) * ARM_M, trunk)


def _bottom(name: str) -> Floats:
    c = load_chart()
    trunk = np.where(c.arm < 0.3, (_WAIST - c.up) * UP_M, -0.1)
    return np.where(c.leg > 0.5, np.minimum(trunk, (BOTTOM_ENDS[name] - c.along_leg) * LEG_M), trunk)


def _socks() -> Floats:
    c = load_chart()
    return np.where(c.leg > 0.5, (c.along_leg - _SOCK) * LEG_M, -0.1)


def _face() -> tuple[Floats, Floats, Floats]:
    """(V,) forward and up from the point between the eyes of the average adult, and sideways, m."""
    c = load_chart()
    p = c.rest - (c.heads["leye"] + c.heads["reye"]) / 2
    return p[:, 0], p[:, 2], np.abs(p[:, 1])


def _ears() -> Floats:
    x, z, y = _face()
    box = np.minimum(np.minimum(0.034 - np.abs(x + 0.085), y - 0.066), 0.041 - np.abs(z + 0.019))
    return np.minimum(box, (load_chart().head - 0.5) * NECK_M)


def _waver(scale: float) -> Floats:
    """A hairline is not a drawn line: smooth wavering, a few millimetres."""
    x, z, y = _face()
    return np.asarray(scale * (rp.sin(310 * y + 170 * z) + rp.sin(240 * z - 190 * x + 1.0) + rp.sin(150 * x + 260 * y + 2.0)))


def _scalp(*, over_ears: bool) -> Floats:
    """Behind a hairline from the forehead over the temples, round the ears, to the nape."""
    c = load_chart()
    x, z, _ = _face()
    line = np.interp(x, (-0.16, -0.105, -0.085, -0.06, -0.035, -0.01, 0.02), (-0.085, -0.075, -0.02, 0.0, 0.03, 0.062, 0.068))
    hair = np.minimum(z - line + _waver(0.0012), (c.head + c.neck - 0.5) * NECK_M)
    return np.maximum(hair, _ears()) if over_ears else np.minimum(hair, -_ears())


def cap_rim_m(x: Floats) -> Floats:
    """Height of a cap's rim over the eyes of the average adult, `x` m before them, m."""
    return np.asarray(np.interp(x, (-0.16, -0.06, 0.02), (0.0, 0.03, 0.040)))


def _cap() -> Floats:
    x, z, _ = _face()
    return np.minimum(z - cap_rim_m(x), (load_chart().head - 0.5) * NECK_M)


def _beard() -> Floats:
    """Jaw, chin and sideburns, without the mouth; lower on the cheek than before the ear."""
    x, z, y = _face()
    cheek = np.interp(x, (-0.075, -0.05, 0.0, 0.03), (-0.030, -0.055, -0.062, -0.050))
    jaw = np.minimum(np.minimum(cheek - z, x + 0.075), z + 0.135)
    sideburn = np.minimum(0.022 - 0.2 * (z + 0.06) - np.abs(x + 0.045), np.minimum(y - 0.052, 0.04 - np.abs(z + 0.02)))
    mouth = 0.024 * (rp.hypot(y / 0.024, (z + 0.0685) / 0.011) - 1)
    mouth = np.where(x > 0.0, mouth, 0.1)
    hair = np.minimum(np.maximum(jaw, sideburn), mouth) + _waver(0.0008)
    return np.minimum(np.minimum(hair, (load_chart().head - 0.5) * NECK_M), -_ears())


def _brows() -> Floats:
    """Above each eye from near the nose to the temple, highest and thinner beyond two thirds of the way."""
    x, z, y = _face()
    middle = np.interp(y, (0.008, 0.018, 0.036, 0.052, 0.060), (0.0145, 0.0170, 0.0205, 0.0165, 0.0120))
    half = np.interp(y, (0.008, 0.011, 0.020, 0.036, 0.054, 0.058), (0.0015, 0.0038, 0.0042, 0.0034, 0.0016, 0.0004))
    along = np.minimum(y - 0.009, 0.057 - y)
    return np.minimum(np.where(x > -0.02, np.minimum(half - np.abs(z - middle), along), -0.1), 0.01) + _waver(0.0003)


def _lips() -> Floats:
    x, z, y = _face()
    return np.where(x > 0.0, 0.010 * (1.0 - rp.hypot(y / 0.0255, (z + 0.0685) / 0.0095)), -0.1)


@cache
def borders() -> Mapping[str, Floats]:
    """Field (V,) of everything that can lie on the skin, by name.

    Each garment, "socks", "scalp", "scalp_and_ears", "cap", "beard", "brows", "lips"; and "ears".
    """
    fields = {name: _top(name) for name in TOP_ENDS} | {name: _bottom(name) for name in BOTTOM_ENDS}
    fields |= {"socks": _socks(), "scalp": _scalp(over_ears=False), "scalp_and_ears": _scalp(over_ears=True)}
    fields |= {"cap": _cap(), "beard": _beard(), "brows": _brows(), "lips": _lips()}
    return MappingProxyType(fields | {"ears": _ears()})
