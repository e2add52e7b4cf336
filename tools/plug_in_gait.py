"""Plug-in Gait on bodies whose joints are known: its markers on the skin, and the joint centres that it makes of them.

Markers are placed on somebody who stands, stay at their place of the skin, and are 14 mm large. Where the package knows no
landmark, `places` says where one is taken to be. The knee's and ankle's markers are placed without error: in the plane of joint
and axis.

References
----------
Equations: Davis, Ounpuu, Tyburski and Gage 1991 (hip); Vicon, Plug-in Gait Reference Guide (chord function, upper body); both as
in pyCGM (`cadop/pyCGM`, `SingleCoreCode/pyCGM.py`). Places of markers: Vicon's guide; Harrington 2007, solved for the spines of
the pelvis; Gray's column lengths, as in docs/joints.md.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cabinpose.core import JOINTS
from cabinpose.scene.body import DOF_INDEX, DOFS, SEGMENTS, Person, PosedBody
from cabinpose.scene.contact import first_crossings

Array = NDArray[np.float64]
RADIUS_M = 0.007  # of a marker
_THETA, _BETA = 0.5, 0.314  # rad, of Davis' hip, as Plug-in Gait has them
_FAR_M = 0.6
# Degrees of who sits, and by how much either way they are drawn; of trunk and head from upright.
_SITTING = {
    "hip.flexion": (80, 15), "hip.abduction": (5, 10), "knee.flexion": (80, 30), "ankle.dorsiflexion": (0, 15),
    "shoulder.flexion": (30, 35), "shoulder.abduction": (10, 20), "shoulder.rotation": (0, 30), "elbow.flexion": (60, 40),
    "elbow.pronation": (0, 40), "wrist.flexion": (0, 20),
}  # fmt: skip
_TRUNK_SPREAD = {
    "lumbar.flexion": 15, "thorax.flexion": 10, "thorax.lateral": 8, "thorax.rotation": 10, "neck.flexion": 15,
    "neck.rotation": 25, "head.flexion": 10, "head.rotation": 15,
}  # fmt: skip
_WIDTHS = ("elbow", "wrist", "hand", "knee", "ankle")
# Standing pelvis: how far its plane of ASIS and PSIS leans forward (assumed, as in `anatomy`), and its depth as a share of
# stature (165 mm of Rajagopal's generic adult, whose stature of 1.70 m is assumed).
_TILT, _DEPTH = np.radians(10.0), 0.165 / 1.70
# C7's skin above C7/T1, and the notch below it, men and women, shares of stature: heights of ANSUR II, Reed's angle, with 0.073
# of the stature (assumed) between the two.
_C7, _NOTCH = (0.020, 0.013), (0.0248, 0.0276)
_T10, _XIPHOID = 0.16, 0.11  # of the way from T8 to L5/S1: Gray's column; the xiphoid lies at T9/T10 (known, not opened)
# Of the shoulder's marker outwards of the joint: the acromion's edge is 25 mm out (docs/populations.md), the joint of acromion
# and clavicle 20 mm inwards from there (assumed; Rajagopal's marker lies 40 mm inwards of the shoulder).
_AC_M = 0.005
# Segments whose skin a marker, or calipers, touch; arms that hang may be in the thighs' flesh.
_ARM, _LEG, _TRUNK = ("upper_arm", "forearm", "hand"), ("thigh", "shin", "foot"), ("pelvis", "abdomen", "thorax", "neck")
_ON_LEG = ("THI", "KNE", "TIB", "ANK", "TOE", "knee", "ankle")
_ON_TRUNK = ("C7", "T10", "CLAV", "STRN", "ASI", "PSI")


class Measured(NamedTuple):
    """Subject measurements, m: leg from ASIS over knee to medial malleolus; offset of the shoulder's marker; widths."""

    leg: float
    shoulder: float
    elbow: float
    wrist: float
    hand: float
    knee: float
    ankle: float


def chord(plane: Array, proximal: Array, marker: Array, offset: float) -> Array:
    """The chord function: the joint centre (3,) at `offset` (m) from a marker, seen from which the proximal centre and it make a
    right angle at the joint, in the plane of three points, on the other side of the line to `proximal` than `plane` is.
    """
    along = proximal - marker
    length = np.linalg.norm(along)
    along = along / length
    away = (plane - marker) - ((plane - marker) @ along) * along
    away = -away / np.linalg.norm(away)
    share = offset / length
    return np.asarray(marker + offset * (share * along + np.sqrt(1.0 - share * share) * away))


def hips(markers: Mapping[str, Array], leg_m: float) -> tuple[Array, Array]:
    """Left and right hip centre (3,) m after Davis 1991, in the pelvis of LASI, RASI, LPSI and RPSI."""
    left, right = markers["LASI"], markers["RASI"]
    origin, sacrum = (left + right) / 2, (markers["LPSI"] + markers["RPSI"]) / 2
    width = float(np.linalg.norm(left - right))
    y = (left - right) / width
    x = (origin - sacrum) - ((origin - sacrum) @ y) * y
    x = x / np.linalg.norm(x)
    z = np.cross(x, y)
    c, depth = 0.115 * leg_m - 0.0153, 0.1288 * leg_m - 0.04856 + RADIUS_M
    forward = c * np.cos(_THETA) * np.sin(_BETA) - depth * np.cos(_BETA)
    up = -c * np.cos(_THETA) * np.cos(_BETA) - depth * np.sin(_BETA)
    out = width / 2 - c * np.sin(_THETA)
    return origin + forward * x + up * z + out * y, origin + forward * x + up * z - out * y


def _unit(v: Array) -> Array:
    return np.asarray(v / np.linalg.norm(v))


def joint_centres(markers: Mapping[str, Array], size: Measured) -> dict[str, Array]:
    """Plug-in Gait's joint centres (3,) m by our names; it has no `neck`.

    `head`, `chest` and `foot` are origins of segments: midway between the front head markers, CLAV moved by a radius, the toe's
    marker; `hip` is midway between the hips.
    """
    found = {"head": (markers["LFHD"] + markers["RFHD"]) / 2}
    upper, lower = (markers["CLAV"] + markers["C7"]) / 2, (markers["STRN"] + markers["T10"]) / 2
    z = _unit(upper - lower)
    front, back = (markers["CLAV"] + markers["STRN"]) / 2, (markers["C7"] + markers["T10"]) / 2
    y = _unit(np.cross(z, front - back))
    x = np.cross(y, z)
    found["chest"] = thorax = markers["CLAV"] - RADIUS_M * x
    hip = dict(zip("lr", hips(markers, size.leg), strict=True))
    found["hip"] = (hip["l"] + hip["r"]) / 2
    for side in "lr":
        m = {name[1:]: at for name, at in markers.items() if name[0].lower() == side}
        sign = 1.0 if side == "l" else -1.0
        wand = thorax + sign * np.cross(x, _unit(m["SHO"] - thorax))
        shoulder = chord(wand, thorax, m["SHO"], size.shoulder + RADIUS_M)
        wrists = (m["WRA"] + m["WRB"]) / 2
        beside = m["ELB"] + sign * np.cross(_unit(shoulder - m["ELB"]), _unit(wrists - m["ELB"]))
        elbow = chord(beside, shoulder, m["ELB"], size.elbow / 2 + RADIUS_M)
        down = _unit(elbow - wrists)
        through = -sign * _unit(np.cross(down, m["WRA"] - m["WRB"]))
        wrist = wrists + (size.wrist / 2 + RADIUS_M) * through
        knee = chord(m["THI"], hip[side], m["KNE"], size.knee / 2 + RADIUS_M)
        found |= {
            side + "shoulder": shoulder, side + "elbow": elbow, side + "wrist": wrist,
            side + "hand": chord(wrists, wrist, m["FIN"], size.hand / 2 + RADIUS_M),
            side + "pelvis": hip[side], side + "knee": knee,
            side + "ankle": chord(m["TIB"], knee, m["ANK"], size.ankle / 2 + RADIUS_M), side + "foot": m["TOE"],
        }  # fmt: skip
    return found


class Wearer:
    """Somebody with Plug-in Gait's markers on."""

    def __init__(self, person: Person) -> None:
        self._faces = person.skin_faces
        body = person.pose(np.zeros(len(DOFS)), np.eye(4))
        skin = body.skin.astype(np.float64)
        at = dict(zip(JOINTS, body.joints, strict=True))
        rays = places(at, person.stature_m, female=person.phenotype.gender > 0.5)
        through = {  # both sides of what calipers hold
            f"{name}{sign}": (at[f"l{name}"], np.array((0.0, way, 0.0)))
            for name in _WIDTHS
            for sign, way in (("+", 1.0), ("-", -1.0))
        }
        starts, ways = (np.array(each) for each in zip(*(*rays.values(), *through.values()), strict=True))
        ways = ways / np.linalg.norm(ways, axis=1, keepdims=True)
        share, which = np.empty(len(starts)), np.empty(len(starts), np.int64)
        segment = person.skin_segment[self._faces]
        names = [*rays, *through]
        for segments in dict.fromkeys(map(_touched, names)):
            mine = np.array([_touched(name) == segments for name in names])
            faces = np.flatnonzero(np.isin(segment, [SEGMENTS.index(each) for each in segments]).all(axis=1))
            share[mine], there = first_crossings(starts[mine], starts[mine] + _FAR_M * ways[mine], skin[self._faces[faces]])
            which[mine] = faces[there]
        if not np.isfinite(share).all():
            raise ValueError(f"no skin for {[name for name, far in zip(names, share, strict=True) if np.isinf(far)]}")
        met = starts + _FAR_M * share[:, None] * ways
        count = len(rays)
        self._names, self._which = tuple(rays), which[:count]
        self._weights = np.array(
            [_barycentric(point, skin[self._faces[f]]) for point, f in zip(met[:count], which, strict=False)]
        )
        ends = dict(zip(through, met[count:], strict=True))
        width = {name: float(np.linalg.norm(ends[f"{name}+"] - ends[f"{name}-"])) for name in _WIDTHS}
        skin_of = dict(zip(rays, met, strict=False))
        leg = np.linalg.norm(skin_of["LASI"] - at["lknee"]) + np.linalg.norm(at["lknee"] - ends["ankle-"])
        offset = skin_of["LSHO"][2] - at["lshoulder"][2]
        self.size = Measured(float(leg), float(offset), **width)

    def markers(self, body: PosedBody) -> dict[str, Array]:
        """The markers' centres (3,) m on their wearer's posed body."""
        corners = body.skin[self._faces[self._which]].astype(np.float64)
        normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        centres = (self._weights[:, :, None] * corners).sum(axis=1)
        centres += RADIUS_M * normal / np.linalg.norm(normal, axis=1, keepdims=True)
        return dict(zip(self._names, centres, strict=True))


def _touched(name: str) -> tuple[str, ...]:
    """The segments of whose skin a marker or a width takes a point; widths are taken on the left."""
    if name.endswith("HD"):
        return ("head",)
    if name.endswith("ASI"):
        return (*_TRUNK, "lthigh", "rthigh")
    if name in _ON_TRUNK or name[1:] in _ON_TRUNK:
        return _TRUNK
    side = "r" if name[0] == "R" else "l"
    if name.endswith("SHO"):
        return (*_TRUNK, side + "upper_arm")
    parts = _LEG if any(part in name for part in _ON_LEG) else _ARM
    return tuple(side + part for part in parts)


def _barycentric(point: Array, triangle: Array) -> Array:
    one, two, to = triangle[1] - triangle[0], triangle[2] - triangle[0], point - triangle[0]
    weights = np.linalg.lstsq(np.stack((one, two), axis=1), to, rcond=None)[0]
    return np.array((1.0 - weights.sum(), *weights))


def seated(person: Person, *, rng: np.random.Generator | None = None) -> PosedBody:
    """Somebody who sits with arms before them; drawn around this where `rng` is given."""
    q = np.zeros(len(DOFS))
    for name, (degrees, spread) in _SITTING.items():
        for side in "lr":
            q[DOF_INDEX[side + name]] = np.radians(degrees if rng is None else rng.uniform(degrees - spread, degrees + spread))
    for name, spread in _TRUNK_SPREAD.items():
        q[DOF_INDEX[name]] = 0.0 if rng is None else np.radians(rng.uniform(-spread, spread))
    return person.pose(q, np.eye(4))


def places(at: Mapping[str, Array], stature_m: float, *, female: bool) -> dict[str, tuple[Array, Array]]:
    """By marker: a point in somebody who stands upright (x forward, y left, z up), and the way from it to the marker's skin.

    at: joints (3,) m by name.
    """
    size = stature_m / 1.75
    ahead, left, up = np.eye(3)
    middle = (at["lpelvis"] + at["rpelvis"]) / 2
    width = (float(np.linalg.norm(at["lpelvis"] - at["rpelvis"])) / 2 - 0.0073) / 0.33
    forward, upward = np.array((np.cos(_TILT), 0.0, -np.sin(_TILT))), np.array((np.sin(_TILT), 0.0, np.cos(_TILT)))
    spine = middle + (0.24 * _DEPTH * stature_m + 0.0099) * forward + (0.30 * width + 0.0109) * upward
    neck, t8, sacrum = at["neck"], at["chest"], at["hip"]
    found = {
        "C7": (neck + _C7[female] * stature_m * up, -ahead), "CLAV": (neck - _NOTCH[female] * stature_m * up, ahead),
        "T10": (t8 + _T10 * (sacrum - t8), -ahead), "STRN": (t8 + _XIPHOID * (sacrum - t8), ahead),
    }  # fmt: skip
    temple = at["head"] + 0.075 * size * up + 0.02 * size * ahead
    for side, out in (("L", left), ("R", -left)):
        joint = {name[1:]: place for name, place in at.items() if name[0] == side.lower()}
        wrist, beside = joint["wrist"], 0.015 * size * ahead
        inside = 0.04 * size * (ahead + out)  # where the spine of the pelvis is not below the skin, as in slender people
        found |= {
            f"{side}FHD": (temple, ahead + 0.8 * out), f"{side}BHD": (temple, -ahead + 0.6 * out),
            f"{side}ASI": (spine + width / 2 * out - inside, ahead + out), f"{side}PSI": (spine + 0.02 * size * out, -forward),
            f"{side}SHO": (joint["shoulder"] + _AC_M * size * out, up), f"{side}ELB": (joint["elbow"], out),
            f"{side}WRA": (wrist + beside, out), f"{side}WRB": (wrist - beside, out),
            f"{side}FIN": (joint["hand"] + 0.02 * size * ahead, out),
            f"{side}THI": ((joint["pelvis"] + 2 * joint["knee"]) / 3, out), f"{side}KNE": (joint["knee"], out),
            f"{side}TIB": ((joint["knee"] + 2 * joint["ankle"]) / 3, out), f"{side}ANK": (joint["ankle"], out),
            f"{side}TOE": (joint["foot"] - 0.012 * size * out, up),
        }  # fmt: skip
    return found
