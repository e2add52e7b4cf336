"""A three-point belt over a posed occupant: two taut ribbons that lie on the body.

Each ribbon runs in planes through its two anchors and a point of the body: the collar bone, the front of the pelvis.
"""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from functools import lru_cache
from typing import Any, Literal, NamedTuple

import numpy as np

from cabinpose._native import cabin as native
from cabinpose.core import CABINPOSE, Bytes, ConfigError, Floats, Floats32, Ints32, Matrix, apply, cross, transform
from cabinpose.core import reproducible as rp
from cabinpose.scene.cabin.model import BeltAnchors, Cabin, Seat, SeatSetting, Vector
from cabinpose.scene.cabin.shading import to_surface
from cabinpose.scene.cabin.shapes import Solid, rounded_box, slab, slab_faces, smoothstep
from cabinpose.scene.labels import LABEL_ID as LABEL
from cabinpose.scene.materials import MATERIAL_ID as MATERIAL
from cabinpose.scene.surface import Surface, merge

BeltMisuse = Literal["behind_back", "under_arm"]
BeltWear = Literal["worn"] | BeltMisuse
WEBBING_WIDTH = 0.047  # UN R16: at least 46 mm wide under load
WEBBING_THICKNESS = 0.0015
_ASIDE = np.radians(60.0)  # from straight ahead, as far as a collar bone leads the belt
_BETWEEN_M = 0.08  # by which one shoulder is nearer to the anchor than the other, where the belt lies on that one alone
_COLLAR, _PAD = 0.48, 0.62  # from the neck to a shoulder: where a belt lies on it, and the pads of a harness
_OVER_THIGHS = (0.3, 0.10)  # likewise, share of their length and m: what a lap part passes above, however high the knees are
_CREASE = (0.12, 0.03)  # along the thighs from the hips, and above their bones (m of an adult)
# Of a harness, by the width of its straps: the buckle, across, up, and out of the body; and where its two tongues go into it.
_BUCKLE, _TONGUES = np.array((1.25, 1.6, 0.55)), np.array(((0.32, 0.55, 0.05), (-0.32, 0.55, 0.05)))
_UNDER = (0.2, 0.12)  # along the legs and down (m of an adult): from the buckle to where their strap leaves the cushion
_BESIDE_M, _OVER_RIM_M, _HANGS_M = 0.02, 0.006, (0.035, 0.14)  # of a loose strap: its rim, and how it hangs there, out and down
_PAST_M = 0.15  # of a tongue from the middle of the body, towards its buckle
# Of the tongue of a belt that hangs: how far down to the lap's anchor it is, off that line to the door and to the back (assumed).
_DOWN, _TO_DOOR_M, _TO_BACK_M = 0.42, 0.04, 0.06
STEPS = 40  # cross-sections of a ribbon
# Cosines of the angle within which a lap part is straight, on its way to the buckle, and of that off up and ahead at the side.
_STRAIGHT, _ASIDE_OF = 0.985, 0.55
_APART_M = 1e-4  # of the cross-sections of a ribbon, at least
_BELOW_M = (0.005, 0.03)  # of a part before the chest, below the lap part: from where on it ends there, and wholly so

# Bones of the trunk, by which the flesh about the shoulders is told from the rest of it: ends, the piece of the bone (0 first end
# .. 1 second), and the girth of the flesh around it (m).
_TRUNK = (
    ("neck", "chest", 0.0, 1.0, 0.15), ("chest", "hip", 0.0, 1.0, 0.15), ("hip", "lpelvis", 0.0, 1.0, 0.14),
    ("hip", "rpelvis", 0.0, 1.0, 0.14), ("neck", "lshoulder", 0.0, 1.0, 0.08), ("neck", "rshoulder", 0.0, 1.0, 0.08),
    ("lshoulder", "lelbow", 0.0, 0.3, 0.06), ("rshoulder", "relbow", 0.0, 0.3, 0.06),
    ("lpelvis", "lknee", 0.0, 0.4, 0.085), ("rpelvis", "rknee", 0.0, 0.4, 0.085),
)  # fmt: skip
_NEAR_HIP, _ON_THIGHS = 0.7, 0.8  # how far down the thighs a lap part lies: on a seat of a car, and on one of a child
# The limbs that belts lie on near their roots: class, joints, and how far down: the lap belt farther than one before the chest,
# which does not climb a thigh.
_ROOTS = tuple(
    (LABEL[f"{part}_{side}"], CABINPOSE.index[side[0] + near], CABINPOSE.index[side[0] + far], shares)
    for side in ("left", "right")
    for part, near, far, shares in (
        ("upper_arm", "shoulder", "elbow", (0.3, 0.3)),
        ("hip", "pelvis", "knee", (0.1, _NEAR_HIP)),
        ("thigh", "pelvis", "knee", (0.1, _NEAR_HIP)),
    )
)
_ROOT_OF, _END_OF = (np.array([root[n] for root in _ROOTS]) for n in (1, 2))
_UP_TO = np.array([root[3] for root in _ROOTS]).T  # of a belt before the chest, and of a lap part
# What belts lie on by class, as `belt_ribbon` has it: the trunk all over, limbs near their roots. Of a thing, everywhere.
_KINDS = np.zeros(256, np.uint8)
_KINDS[[LABEL[name] for name in LABEL if name.startswith(("torso", "hip_center", "shoulder"))]] = 1
_KINDS[[root[0] for root in _ROOTS]] = 2 + np.arange(len(_ROOTS))
_EVERYWHERE = np.ones(256, np.uint8)
_KNEES = CABINPOSE.indices(("lknee", "rknee"))
_BONES = np.array([(CABINPOSE.index[a], CABINPOSE.index[b]) for a, b, *_ in _TRUNK], dtype=np.int64)
_PIECE = np.array([piece for _, _, *piece, _ in _TRUNK])[:, :, None]
_GIRTH = np.array([girth for *_, girth in _TRUNK])


class Wearer(NamedTuple):
    """Who a belt is worn by: a posed body, clothed or not, vehicle frame.

    vertices: (V, 3) m · faces: (F, 3) · labels: (F,) the faces' classes, of which belts lie on some · joints: (20, 3) m, of the
    same pose.
    """

    vertices: Floats32
    faces: Ints32
    labels: Bytes
    joints: Floats

    @classmethod
    def of(cls, body: Surface, joints: Floats) -> Wearer:
        """A body as it is seen, and its joints (20, 3) m."""
        return cls(body.vertices, body.faces, body.label, joints)

    def belt(
        self, seat: Seat, setting: SeatSetting, cabin: Cabin, *, gap_m: float = 0.004, worn: BeltWear = "worn",
        guide: Vector | None = None, lap_guides: Floats | None = None,
    ) -> Surface:  # fmt: skip
        """The belt of a seat over its occupant, vehicle frame, class seat_belt, instance 0.

        gap_m: clearance of the webbing from the surface · worn: how · guide: (3,) m, through which a booster leads the belt to
        the shoulder · lap_guides: (2, 3) m, the openings below its armrests, through which it leads the lap part over the thighs.
        Raises ConfigError for a seat that has no belt or is not in the cabin.
        """
        anchors = _anchors(seat, setting, cabin)
        body = _Trunk.of(self, _NEAR_HIP if lap_guides is None else _ON_THIGHS)
        ahead, up, size = body.ahead, body.up, body.size
        shoulder = body.shoulder_at(anchors.upper)
        collar, front = body.collar(shoulder), 0.4 * ahead + 0.6 * seat.vehicle_from_seat(setting)[:3, 0]
        front_of_pelvis = body.front_of_pelvis(anchors)
        start, courses = anchors.upper, list[_Course]()
        outer, buckle = anchors.outer_lap, anchors.buckle
        if lap_guides is not None:
            outer, buckle = sorted(lap_guides, key=lambda at: float(rp.norm(at - anchors.outer_lap)))
            front_of_pelvis = body.crease()
            courses += [_Course(a, a + ahead, b, None) for a, b in ((anchors.outer_lap, outer), (buckle, anchors.buckle))]
        lap = _ribbon(body, _Course(outer, front_of_pelvis, buckle, ahead + up, lap=True), gap_m)
        if worn == "behind_back":
            behind = body.at["chest"] + 0.3 * (shoulder - body.at["neck"]) - 0.12 * size * ahead
            courses += [_Course(start, collar, behind, None), _Course(behind, collar, anchors.buckle, None)]
        else:
            if worn == "under_arm":
                body = body._replace(shoulders=False)
                armpit = shoulder + 0.2 * (body.at["neck"] - shoulder) - 0.17 * size * up
                guide, collar = armpit - 0.03 * size * ahead, 0.5 * (armpit + body.at["chest"]) + 0.12 * size * ahead
            elif guide is not None:
                collar = 0.5 * (guide + buckle) + 0.3 * ahead
            if guide is not None:
                courses.append(_Course(start, collar, guide, None))
                start = guide
            courses.append(_Course(start, _kept_in_front(start, collar, buckle, front), buckle, front))
        laid = [_ribbon(body, course, gap_m) for course in courses]
        upright = _upright(body, seat.vehicle_from_seat(setting))
        if worn == "worn" and guide is None and (meet := _met(laid[-1], lap, ahead + up, upright)) is not None:
            over_lap = _ribbon(body, _Course.before(start, _kept_in_front(start, collar, meet, front), meet, front), gap_m)
            laid[-1] = over_lap if _drawn_out(over_lap) else laid[-1]
        return merge([*laid, lap])

    def belt_in_hand(self, seat: Seat, setting: SeatSetting, cabin: Cabin, tongue: Vector, *, gap_m: float = 0.004) -> Surface:
        """The belt of a seat while a hand draws it across: from its guide to the tongue, and from there to the lap's anchor.

        Until the tongue is past the middle of the body it is straight between anchors, collar bone, hip and tongue; then it lies
        on the body as a worn one. tongue: (3,) m, vehicle frame. Raises what `belt` does.
        """
        anchors, body = _anchors(seat, setting, cabin), _Trunk.of(self)
        outer = min((body.at["lpelvis"], body.at["rpelvis"]), key=lambda hip: rp.norm(hip - anchors.outer_lap))
        over = body.collar(body.shoulder_at(anchors.upper)) + body.size * (0.08 * body.ahead + 0.07 * body.up)
        before = outer + body.size * (0.14 * body.ahead + 0.05 * body.up)
        ways = ((anchors.upper, over), (over, tongue), (anchors.outer_lap, before), (before, tongue))
        courses = [_Course(a, a + body.ahead, b, None) for a, b in ways]
        inwards = anchors.buckle - anchors.outer_lap
        if rp.matmul(tongue - body.pelvis, inwards) > _PAST_M * rp.norm(inwards):
            front, up = 0.4 * body.ahead + 0.6 * seat.vehicle_from_seat(setting)[:3, 0], body.ahead + body.up
            collar = body.collar(body.shoulder_at(anchors.upper))
            through = _kept_in_front(anchors.upper, collar, tongue, front)
            lap = body.front_of_pelvis(anchors)
            courses = [_Course(anchors.upper, through, tongue, front), _Course(anchors.outer_lap, lap, tongue, up, lap=True)]
        return merge([_ribbon(body, course, gap_m) for course in courses])

    def harness(self, slots: Floats, hips: Floats, *, gap_m: float = 0.004, width_m: float = WEBBING_WIDTH) -> Surface:
        """The five-point harness of a child seat over the child in it, buckled up, vehicle frame, class seat_belt, instance 0.

        Straps over both shoulders, one over the hips, and one between the legs meet in a buckle that lies on the pelvis.

        slots, hips: (2, 3) m, where straps come out of the shell behind the left and the right shoulder, and beside the hips ·
        gap_m: as for `belt` · width_m: of the straps.
        """
        body = _Trunk.of(self, _ON_THIGHS)
        lap = _ribbon(body, _Course(hips[0], body.crease(), hips[1], body.ahead + body.up, lap=True), gap_m, width=width_m)
        middle = slice(3 * (STEPS // 2 - 1), 3 * (STEPS // 2 + 1))  # of the outer side
        at, out = (rows[middle].mean(axis=0).astype(np.float64) for rows in (lap.vertices, lap.normals))
        out /= rp.norm(out)
        across = body.at["lpelvis"] - body.at["rpelvis"]
        across -= (rp.matmul(across, out)) * out
        across /= rp.norm(across)
        frame = transform(np.column_stack((across, cross(out, across), out)), at)
        tongues = apply(frame, _TONGUES * width_m)
        straps = [
            _Course.before(slot, body.collar(body.at[side + "shoulder"], _PAD), tongue, body.ahead)
            for side, slot, tongue in zip("lr", slots, tongues, strict=True)
        ]
        thighs, below = body.thighs()
        under = at + _UNDER[0] * thighs + _UNDER[1] * body.size * below
        between = to_surface(_flat(np.linspace(under, at, 4), across, width_m), "seat_belt", "belt_webbing")
        buckle = rounded_box((width_m * _BUCKLE).tolist(), 0.2 * width_m, (1, 1, 1), corner=1).moved(frame)
        laid = [_ribbon(body, course, gap_m, width=width_m) for course in straps]
        return merge([lap, *laid, between, to_surface(buckle, "seat_belt", "hard_plastic")])


def loose_straps(shell: Surface, slots: Floats, outwards: Floats, down: Vector, *, width_m: float = WEBBING_WIDTH) -> Surface:
    """The shoulder straps of a harness that is not buckled up, thrown over the sides of the shell, vehicle frame.

    shell: of the child seat · slots: (2, 3) m, where they come out of it · outwards: (2, 3) to its left and its right side ·
    down: (3,) along which they hang. Class seat_belt, instance 0.
    """
    straps = []
    for slot, out in zip(slots, outwards, strict=True):
        along = shell.vertices.astype(np.float64) - slot
        near = along[(np.abs(rp.matmul(along, down)) < _BESIDE_M) & (rp.matmul(along, out) > 0.0)]
        if not len(near):
            continue
        ahead = cross(down, out) * (1.0 if rp.matmul(cross(down, out), near.sum(axis=0)) > 0.0 else -1.0)
        rim = slot + near[int(np.argmax(rp.matmul(near, ahead)))] + _OVER_RIM_M * ahead
        over = rim + _HANGS_M[0] * out
        corners = np.stack((slot, rim, over, over + _HANGS_M[1] * down))
        shares = np.linspace(0.0, len(corners) - 1.0, 3 * len(corners) - 2)
        path = np.stack([np.interp(shares, np.arange(len(corners)), column) for column in corners.T], axis=1)
        straps.append(to_surface(_flat(path, ahead + down, width_m), "seat_belt", "belt_webbing"))
    return merge(straps)


def _flat(path: Floats, aside: Vector, width_m: float) -> Solid:
    """Webbing along points (N, 3) m, its width as far as it can be along `aside` (3,), which they never are."""
    tangents = np.gradient(path, axis=0)
    tangents /= np.linalg.norm(tangents, axis=1, keepdims=True)
    across = aside - (tangents * aside).sum(axis=1, keepdims=True) * tangents
    across *= 0.5 * width_m / np.linalg.norm(across, axis=1, keepdims=True)
    off = WEBBING_THICKNESS / width_m * np.cross(tangents, across)
    inner, outer = (np.stack((path - across, path, path + across), axis=1) + sign * off[:, None] for sign in (-1.0, 1.0))
    return slab(inner, outer).outward()


def hanging_tongue(seat: Seat, setting: SeatSetting, cabin: Cabin) -> Vector:
    """(3,) m, vehicle frame: where the tongue of a belt hangs that nobody wears, beside the backrest."""
    anchors = _anchors(seat, setting, cabin)
    forward, outwards = seat.vehicle_from_seat(setting)[:3, 0], anchors.outer_lap - anchors.buckle
    straight = anchors.upper + _DOWN * (anchors.outer_lap - anchors.upper)
    return np.asarray(straight + _TO_DOOR_M * outwards / rp.norm(outwards) - _TO_BACK_M * forward)


def loose_belt(seat: Seat, setting: SeatSetting, cabin: Cabin, tongue: Vector) -> Surface:
    """A belt that nobody wears: straight from its guide to the tongue (3,) m, vehicle frame, and to the lap's anchor."""
    anchors, forward = _anchors(seat, setting, cabin), seat.vehicle_from_seat(setting)[:3, 0]
    no_points, no_faces, no_codes = np.zeros((0, 3), np.float32), np.zeros((0, 3), np.int32), np.zeros(0, np.uint8)
    nothing = Surface(no_points, no_points, no_faces, no_codes, no_codes, no_codes)
    body = _Trunk.without_bones(nothing, -forward, forward)
    courses = [_Course(a, a + forward, b, None) for a, b in ((anchors.upper, tongue), (anchors.outer_lap, tongue))]
    return merge([_ribbon(body, course, 0.004) for course in courses])


class _Trunk(NamedTuple):
    """What belts lie on: the surface, the pieces of the trunk's bones, and directions and places of the body, m.

    lain_on: which faces a belt before the chest lies on, and a lap part · shoulders: whether what surrounds their bones is trunk.
    """

    skin: Floats32
    faces: Ints32
    lain_on: tuple[_LainOn, _LainOn]
    bones: Floats
    at: Mapping[str, Floats]
    pelvis: Vector
    up: Vector
    ahead: Vector
    size: float
    shoulders: bool = True

    @classmethod
    def of(cls, wearer: Wearer, thighs: float = _NEAR_HIP) -> _Trunk:
        """thighs: how far down them a lap part lies, share of their length."""
        joints = wearer.joints
        at = {name: joints[i] for name, i in CABINPOSE.index.items()}
        pelvis = 0.5 * (at["lpelvis"] + at["rpelvis"])
        up = at["chest"] - pelvis
        up = up / rp.norm(up)
        across = at["lpelvis"] - at["rpelvis"]
        ahead = cross(across, up)
        ahead = ahead / rp.norm(ahead)
        size = rp.norm(at["neck"] - pelvis) / 0.52  # against an adult's trunk
        ends = joints[_BONES]
        bones = ends[:, :1] + _PIECE * (ends[:, 1:] - ends[:, :1])  # (bones, 2, 3)
        vertices = np.ascontiguousarray(wearer.vertices, dtype=np.float32)
        faces = np.ascontiguousarray(wearer.faces, dtype=np.int32)
        roots = joints[_ROOT_OF]
        up_to = _UP_TO[0], np.where(np.isin(_END_OF, _KNEES), thighs, _UP_TO[1])
        limbs = (np.concatenate((roots, joints[_END_OF] - roots, share[:, None]), axis=1) for share in up_to)
        chest, lap = (_LainOn(wearer.labels, _KINDS, each) for each in limbs)
        return cls(vertices, faces, (chest, lap), bones, at, pelvis, up, ahead, size)

    @classmethod
    def without_bones(cls, surface: Surface, down: Vector, ahead: Vector) -> _Trunk:
        """Of a thing: all of it is lain on."""
        everywhere, bones = _LainOn(surface.label, _EVERYWHERE, np.empty((0, 7))), np.zeros((len(_GIRTH), 2, 3))
        return cls(surface.vertices, surface.faces, (everywhere, everywhere), bones, {}, np.zeros(3), -down, ahead, 1.0)

    def shoulder_at(self, anchor: Vector) -> Vector:
        """The shoulder beside an anchor; a place between the two where somebody leans so far that both are about as near."""
        left, right = self.at["lshoulder"], self.at["rshoulder"]
        nearer_m = rp.norm(right - anchor) - rp.norm(left - anchor)
        share = float(smoothstep(nearer_m, -_BETWEEN_M, _BETWEEN_M))
        return np.asarray(share * left + (1.0 - share) * right)

    def thighs(self) -> tuple[Vector, Vector]:
        """From the middle of the hips to that of the knees, m; and the direction out of the thighs' undersides."""
        thighs = 0.5 * (self.at["lknee"] + self.at["rknee"]) - self.pelvis
        below = (rp.matmul(self.up, thighs)) / (rp.matmul(thighs, thighs)) * thighs - self.up
        return thighs, below / rp.norm(below)

    def front_of_pelvis(self, anchors: BeltAnchors) -> Vector:
        """What a lap part runs over: the front of the pelvis, or a thigh where it rises before that."""
        places = [self.pelvis + self.size * (0.10 * self.ahead + 0.065 * self.up)]
        above = _OVER_THIGHS[1] * self.size * self.thighs()[1]
        for side in "lr":
            hip = self.at[side + "pelvis"]
            places.append(hip + _OVER_THIGHS[0] * (self.at[side + "knee"] - hip) - above)
        chord = anchors.buckle - anchors.outer_lap
        chord = chord / rp.norm(chord)
        aside = [at - anchors.outer_lap - rp.matmul(at - anchors.outer_lap, chord) * chord for at in places]
        return places[int(np.argmax([rp.matmul(off, self.up) / rp.norm(off) for off in aside]))]

    def crease(self) -> Vector:
        """Between the two thighs, on top of them, where they meet the pelvis: where a lap part lies that cannot slip up."""
        thighs, below = self.thighs()
        return np.asarray(self.pelvis + _CREASE[0] * thighs - _CREASE[1] * self.size * below)

    def collar(self, shoulder: Vector, share: float = _COLLAR) -> Vector:
        """The middle between neck and arm; share: another place on the way to the shoulder."""
        return np.asarray((1.0 - share) * self.at["neck"] + share * shoulder + 0.03 * self.size * self.ahead)


def belt_surface(skin: Floats32, faces: Ints32, joints: Floats, *where: Any, labels: Bytes, **options: Any) -> Surface:
    """Deprecated: `Wearer.belt`, which says what the others are."""
    warnings.warn("belt_surface(...) is Wearer(...).belt(...) now", DeprecationWarning, stacklevel=2)
    return Wearer(skin, faces, labels, joints).belt(*where, **options)


def harness_surface(skin: Floats32, faces: Ints32, joints: Floats, *where: Any, labels: Bytes, **options: Any) -> Surface:
    """Deprecated: `Wearer.harness`, which says what the others are."""
    warnings.warn("harness_surface(...) is Wearer(...).harness(...) now", DeprecationWarning, stacklevel=2)
    return Wearer(skin, faces, labels, joints).harness(*where, **options)


def fastening_surface(surface: Surface, seat: Seat, setting: SeatSetting, cabin: Cabin, path: Floats, *, over: bool) -> Surface:
    """The belt that fastens a child seat, vehicle frame, class seat_belt.

    surface: of what the belt can lie on · path: (2, 3) m, where its lap part and its shoulder part run · over: they lie on
    the surface there; else they pass straight through it, as through the guides of a base.
    """
    anchors = _anchors(seat, setting, cabin)
    forward, up = seat.vehicle_from_seat(setting)[:3, 0], np.array([0.0, 0.0, 1.0])
    body = _Trunk.without_bones(surface, -up, forward)
    lap, shoulder = path
    if over:
        courses = [
            _Course(anchors.outer_lap, lap, anchors.buckle, forward + up),
            _Course(anchors.upper, shoulder, anchors.buckle, forward),
        ]
    else:
        ways = ((anchors.outer_lap, lap), (lap, anchors.buckle), (anchors.upper, shoulder), (shoulder, lap))
        courses = [_Course(a, a + forward, b, None) for a, b in ways]
    return merge([_ribbon(body, course, 0.004) for course in courses])


def _anchors(seat: Seat, setting: SeatSetting, cabin: Cabin) -> BeltAnchors:
    if seat.slot not in cabin.seats:
        raise ConfigError(f"cabin '{cabin.name}' has no seat '{seat.slot}'", hint=f"its seats: {', '.join(cabin.seats)}")
    anchors = seat.belt_anchors(setting)
    if anchors is None:
        raise ConfigError(f"seat '{seat.slot}' of cabin '{cabin.name}' has no belt", hint="leave the belt out for this seat")
    return anchors


_SHOULDERS = (4, 5, 6, 7)  # of `_TRUNK`


def _kept_in_front(start: Vector, through: Vector, end: Vector, front: Vector) -> Vector:
    """The point of the body that a belt's plane goes through, turned about the line of its ends where it is too far aside.

    Somebody who leans or twists far has the collar bone beside that line: a belt in its plane would lie on the outside of the
    other arm. A real one has slipped towards the belly.
    """
    chord = (end - start) / rp.norm(end - start)
    aside, ahead = (v - (rp.matmul(v, chord)) * chord for v in (through - start, front))
    reach = rp.norm(aside)
    aside, ahead = aside / reach, ahead / rp.norm(ahead)
    angle = float(rp.arccos(np.clip(rp.matmul(aside, ahead), -1.0, 1.0)))
    if angle <= _ASIDE:
        return through
    kept = max(_ASIDE - (angle - _ASIDE), 0.0)  # without a jump from one pose to the next
    across = aside - (rp.matmul(aside, ahead)) * ahead
    across /= max(rp.norm(across), 1e-9)
    return np.asarray(through + reach * (rp.cos(kept) * ahead + rp.sin(kept) * across - aside))


class _LainOn(NamedTuple):
    """Which faces a belt lies on: their classes (F,), kinds (256,) of classes, roots, bones (m) and shares (n, 7) of limbs."""

    labels: Bytes
    kinds: Bytes
    limbs: Floats


class _TrunkBones(NamedTuple):
    """Pieces of bones, ends (N, 2, 3) m and girth (N,) m of the flesh around them, the `n_trunk` of the trunk first."""

    ends: Floats
    girth: Floats
    n_trunk: int


class _Webbing(NamedTuple):
    """Width, thickness and clearance from the body of a belt, m."""

    width: float
    thickness: float
    gap: float


class _Course(NamedTuple):
    """A ribbon from `start` to `end` (3,) in the plane with `through`, on the side of the body to which `front` points, m.

    front: None for one that is straight, whatever is in its way · lap: whether it lies on thighs too.
    """

    start: Vector
    through: Vector
    end: Vector
    front: Vector | None
    lap: bool = False

    @classmethod
    def before(cls, start: Vector, through: Vector, end: Vector, front: Vector) -> _Course:
        """One whose ends are the same way to the front, so that not they but what lies between tells that side of the body."""
        chord = (end - start) / rp.norm(end - start)
        return cls(start, through, end, front - (rp.matmul(front, chord)) * chord)


def _drawn_out(ribbon: Surface) -> bool:
    """Whether none of a ribbon's cross-sections lie on each other, as at an end that is within what it lies on."""
    steps = np.diff(ribbon.vertices.reshape(2, STEPS, 3, 3)[0], axis=0)
    return bool((np.einsum("sri,sri->sr", steps, steps) > _APART_M**2).all())


def _upright(body: _Trunk, vehicle_from_seat: Matrix) -> float:
    """1 of who sits straight in a seat, 0 of who leans aside or turns far: there the belt's plane goes to the buckle."""
    turned, aside = (abs(rp.matmul(each, vehicle_from_seat[:3, 1])) for each in (body.ahead, body.up))
    return float((1.0 - smoothstep(turned, 0.28, 0.5)) * (1.0 - smoothstep(aside, 0.10, 0.25)))


def _met(chest: Surface, lap: Surface, out: Vector, most: float) -> Vector | None:
    """(3,) m: where the part of a belt before the chest meets the lap part, None where that is the buckle.

    Beside who has slid down, or sits in a wide skirt, a straight way to the buckle goes through hip and thigh, below the lap
    part; there it ends on the lap part, at most where that turns to the side of the body. out: (3,) up and ahead, of any length.
    """
    string = chest.vertices.reshape(2, STEPS, 3, 3)[0, :, 1].astype(np.float64)
    rows, over = (each.reshape(2, STEPS, 3, 3)[0, :, 1].astype(np.float64) for each in (lap.vertices, lap.normals))
    across = (rows[-1] - rows[0]) / rp.norm(rows[-1] - rows[0])
    beside = np.abs(rp.matmul(string[STEPS // 2 :], across)[:, None] - rp.matmul(rows, across)).argmin(axis=1)
    below = ((rows[beside] - string[STEPS // 2 :]) * over[beside]).sum(axis=1)
    share = most * float(smoothstep(below.max(), *_BELOW_M))
    if share == 0.0:
        return None
    along = np.diff(rows, axis=0)
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    bent = (rp.matmul(along, along[-1]) < _STRAIGHT) & (rp.matmul(over[1:], out) > _ASIDE_OF * rp.norm(out))
    turns = max(int(np.flatnonzero(bent)[-1]) + 1 if bent.any() else 0, STEPS // 2)
    at = (STEPS - 1) - share * (STEPS - 1 - turns)
    place = np.stack([np.interp(at, np.arange(STEPS), column) for column in (rows + 2.0 * WEBBING_THICKNESS * over).T])
    return np.asarray(place)


def _ribbon(body: _Trunk, course: _Course, gap: float, width: float = WEBBING_WIDTH) -> Surface:
    straight = course.front is None
    rows = np.array((*course[:3], course.through - course.start if straight else course.front), dtype=np.float64)
    vertices, normals = np.empty((2, STEPS, 3, 3), np.float32), np.empty((2, STEPS, 3, 3), np.float32)
    mine = [n for n in range(len(_TRUNK)) if body.shoulders or n not in _SHOULDERS]
    order = [*mine, *(() if body.shoulders else _SHOULDERS)]
    trunk = _TrunkBones(body.bones[order], _GIRTH[order], len(mine))
    webbing = _Webbing(width, WEBBING_THICKNESS, gap)
    faces, lain_on = body.faces[: 0 if straight else None], body.lain_on[course.lap]
    turned = native.belt_ribbon(body.skin, faces, lain_on, trunk, rows, webbing, vertices=vertices, normals=normals)
    topology = _ribbon_faces(turned)
    return Surface(
        vertices.reshape(-1, 3),
        normals.reshape(-1, 3),
        topology,
        np.full(len(topology), LABEL["seat_belt"], np.uint8),
        np.full(len(topology), MATERIAL["belt_webbing"], np.uint8),
        np.zeros(len(topology), np.uint8),
    )


@lru_cache(maxsize=2)
def _ribbon_faces(flip: bool) -> Ints32:
    """Triangles of a closed ribbon whose outer grid (STEPS, 3) comes before its inner one."""
    faces = slab_faces(STEPS, 3)
    return np.ascontiguousarray(faces[:, ::-1] if flip else faces)
