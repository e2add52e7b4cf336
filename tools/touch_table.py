"""How near hands and what they hold come to what they are to touch: a table of the rendered surfaces, action by action.

    python tools/touch_table.py --scenes 40 > touch.json
    python tools/touch_table.py --scenes 60 --only gear drink

Draws valid scenes as `cabinpose synth` does, each with one action asked for, leaves the rendering out, and prints a table on
stderr and JSON on stdout. Of each scene the least distance between two rendered surfaces is measured: points of either against
the triangles of the other, exact. A row of the table has the median and the 90 % quantile of the gap (mm), the share of scenes
in which it is at most 10 mm with no point deeper than flesh gives way (8 mm), the median and the greatest depth (mm), the fingers
of the nearer hand that are within 5 mm (of 5), and how many poses were drawn for one that holds. Hair gives way: depths are
those in the skin under it.

A second table is of hands at the steering wheel's rim, of scenes and of frames of sequences half a second apart: in what share of
them the skin of the last phalanges of at least three fingers, the thumb's among them, is within 10 mm of the rim and nothing of
the hand deeper in it than 8 mm.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from threadpoolctl import threadpool_limits

import cabinpose
from cabinpose.core.errors import SceneError
from cabinpose.scene import LABEL_ID, Surface, merge
from cabinpose.scene.body import BONE_INDEX, SEGMENTS
from cabinpose.scene.contact import FLESH_M, TriangleMesh, triangle_mesh
from cabinpose.synth.config import SynthConfig
from cabinpose.synth.motion.ways import rim_distance
from cabinpose.synth.sample import SceneSampler
from cabinpose.synth.scene import Scene, ScenePerson
from cabinpose.synth.streams import frame_rng

NEAR_M, FINGER_M = 0.010, 0.005
_HOLDING_M, _PADS = 0.030, 3  # of a palm's origin from the rim's axis; fingers around it
_STEER = {"frames": 90, "rate_hz": 30.0, "activities": ["steer"]}
_STEER_APART = 15  # frames
_KNOB_M = 0.035  # of a knob from its middle
_FAR_M = 0.40  # gaps are measured up to here
_APART = 17  # frames
_CARS = ("city_car", "hatchback", "sedan", "coupe", "suv", "van")
_DOOR = ("front door trim", "rear door trim", "armrests", "door fittings")
_HEAD = ("head_left", "head_right", "hair", "headwear", "glasses")
_THIGH = ("thigh_left", "thigh_right", "knee_left", "knee_right", "hip_left", "hip_right")


class Row(NamedTuple):
    """A row of the table: what somebody in a seat does, with what of them (hand or thing), and what that is to touch."""

    name: str
    slot: str
    action: str
    mover: str
    target: Callable[[Scene, ScenePerson], Surface]
    held: tuple[str, ...] = ()


def part(*names: str) -> Callable[[Scene, ScenePerson], Surface]:
    """Parts of the car by name."""

    def surface(scene: Scene, _: ScenePerson) -> Surface:
        assert scene.cabin is not None
        at = scene.cabin.group_transforms(scene.settings, wheel_angle=scene.wheel_angle)
        found = [p.surface.moved(at[p.group]) for p in scene.cabin.parts if p.name in names]
        return merge(found)

    return surface


def knob(scene: Scene, person: ScenePerson) -> Surface:
    """The upper end of the gear lever."""
    lever = part("gear lever")(scene, person)
    assert scene.cabin is not None
    near = np.linalg.norm(lever.vertices - scene.cabin.reach_targets["gear_lever"], axis=1) < _KNOB_M
    return _cut(lever, near[lever.faces].all(axis=1))


def _cut(surface: Surface, keep: NDArray[np.bool_]) -> Surface:
    """Some faces (F,) of a surface."""
    kept = (a[keep] for a in (surface.faces, surface.label, surface.material, surface.instance))
    return Surface(surface.vertices, surface.normals, *kept)


def own(labels: tuple[str, ...], *, of: int = 0) -> Callable[[Scene, ScenePerson], Surface]:
    """What is seen of the person's own body with these labels; of: 1 for the belt."""

    def surface(_: Scene, person: ScenePerson) -> Surface:
        seen = person.surfaces[of]
        return _cut(seen, np.isin(seen.label, [LABEL_ID[label] for label in labels]))

    return surface


def held(scene: Scene, person: ScenePerson) -> Surface:
    """What the person has in the hand."""
    return next(thing for thing in scene.things if thing.at == "hand" and thing.slot == person.slot).surface(0)


HEAD, BELT = own(_HEAD), own(("seat_belt",), of=1)
ROWS = (
    Row("telephone, head", "front_passenger", "phone_ear", "thing", HEAD, ("phone",)),
    Row("telephone at the door's side, head", "driver", "phone_ear_outer", "thing", HEAD, ("phone",)),
    Row("hand, telephone read", "front_passenger", "phone_text", "hand", held, ("phone",)),
    Row("bottle, face", "front_passenger", "drink", "thing", HEAD, ("bottle",)),
    Row("cup, face", "driver", "drink", "thing", HEAD, ("cup",)),
    Row("hand, bottle", "front_passenger", "drink", "hand", held, ("bottle",)),
    Row("hand, book", "rear_left", "read", "hand", held),
    Row("hand, mouth", "front_passenger", "at_mouth", "hand", HEAD),
    Row("hand, gear knob", "driver", "gear", "hand", knob),
    Row("hand, mirror", "driver", "adjust_mirror", "hand", part("rear-view mirror")),
    Row("hand, screen", "driver", "reach_infotainment", "hand", part("screen")),
    Row("hand, climate", "driver", "reach_climate", "hand", part("dashboard", "vents")),
    Row("hand, glove box", "front_passenger", "reach_glovebox", "hand", part("dashboard")),
    Row("hand, sun visor", "driver", "sun_visor", "hand", part("sun visors")),
    Row("hand, window switch", "driver", "window", "hand", part(*_DOOR)),
    Row("hand, armrest", "front_passenger", "armrest", "hand", part(*_DOOR)),
    Row("hand, belt", "front_passenger", "belt", "hand", BELT),
    Row("hand, rim", "driver", "drive", "hand", part("steering wheel rim")),
    Row("hand, rim, one hand", "driver", "drive_one_hand", "hand", part("steering wheel rim")),
    Row("hand, own thigh", "front_passenger", "rest_lap", "hand", own(_THIGH)),
)


def mesh_of(surface: Surface, *, closed: bool = True) -> TriangleMesh:
    """Its triangles alone."""
    used, faces = np.unique(surface.faces, return_inverse=True)
    return triangle_mesh(surface.vertices[used], faces.reshape(-1, 3), closed=closed)


def gap_and_depth(
    points: NDArray[np.float64], mesh: TriangleMesh, other: TriangleMesh, firm: TriangleMesh
) -> tuple[float, float]:
    """The least distance between two surfaces, and how deep the deepest point of the first one is in what of it is firm, m.

    points: the vertices of the first, `mesh`.
    """
    signed = other.signed_distance(points, _FAR_M)
    back = mesh.signed_distance(other.vertices, _FAR_M)
    gap = float(min(signed.min(), np.abs(back).min()))
    inside = signed if firm is other else firm.signed_distance(points, _FAR_M)
    return max(gap, 0.0), max(-float(inside.min()), 0.0)


def _bare_head(person: ScenePerson) -> Surface:
    """The skin of the head, without hair and what is worn on it."""
    head = np.flatnonzero(person.person.skin_segment == SEGMENTS.index("head"))
    faces = person.person.skin_faces[np.isin(person.person.skin_faces, head).all(axis=1)]
    none = np.zeros(len(faces), np.uint8)
    return Surface(person.posed.skin, person.posed.skin, faces, none, none, none)


class Measured(NamedTuple):
    """Of one scene: gap and depth (m), and fingers of the nearer hand within `FINGER_M`."""

    gap_m: float
    depth_m: float
    fingers: int


def measure(row: Row, scene: Scene) -> Measured | None:
    """What a row says of a scene; None where the scene has not what it asks for."""
    person = next(p for p in scene.people if p.slot == row.slot)
    if row.mover == "thing" and not any(thing.at == "hand" and thing.slot == row.slot for thing in scene.things):
        return None
    if row.target is held and not any(thing.at == "hand" and thing.slot == row.slot for thing in scene.things):
        return None
    target = mesh_of(row.target(scene, person), closed=row.target is not BELT)  # webbing has no inside to speak of
    firm = mesh_of(_bare_head(person)) if row.target is HEAD else target  # hair and hats give way
    hands = []
    leading = person.person.leading_bone
    for side in "lr":
        rows = np.flatnonzero(person.person.skin_segment == SEGMENTS.index(side + "hand"))
        inside = np.isin(person.person.skin_faces, rows).all(axis=1)
        skin = person.posed.skin.astype(np.float64)
        used, faces = np.unique(person.person.skin_faces[inside], return_inverse=True)
        mesh = triangle_mesh(skin[used], faces.reshape(-1, 3), closed=True)
        gap, depth = gap_and_depth(mesh.vertices, mesh, target, firm)
        fingers = 0
        for number in range(1, 6):
            bones = [BONE_INDEX[f"{side}finger{number}_{phalanx}"] for phalanx in (1, 2, 3)]
            mine = skin[np.isin(leading, bones)]
            fingers += bool(np.abs(target.signed_distance(mine, 2 * FINGER_M)).min() < FINGER_M) or bool(
                target.signed_distance(mine, 2 * FINGER_M).min() < 0.0
            )
        hands.append(Measured(gap, depth, fingers))
    nearer = min(hands, key=lambda found: (found.gap_m, -found.depth_m))
    if row.mover == "hand":
        return nearer
    mesh = mesh_of(held(scene, person))
    gap, depth = gap_and_depth(mesh.vertices, mesh, target, firm)
    return Measured(gap, depth, nearer.fingers)


class Grips(NamedTuple):
    """Of the hands at the rim in a scene: fingers whose last phalanx is near it, depth (m) in it."""

    pads: list[int]
    depth_m: list[float]


def grips(scene: Scene) -> Grips:
    """How the driver's hands hold the rim, those that do."""
    person = next(p for p in scene.people if p.slot == "driver")
    assert scene.cabin is not None
    wheel = scene.cabin.steering_wheel
    assert wheel is not None
    rim, skin = mesh_of(part("steering wheel rim")(scene, person)), person.posed.skin.astype(np.float64)
    leading, found = person.person.leading_bone, Grips([], [])
    for side in "lr":
        if rim_distance(wheel, person.posed.palms[side][:3, 3]) > _HOLDING_M:
            continue
        hand = skin[person.person.skin_segment == SEGMENTS.index(side + "hand")]
        last = [skin[leading == BONE_INDEX[f"{side}finger{number}_3"]] for number in range(1, 6)]
        found.pads.append(sum(float(rim.signed_distance(pad, 2 * NEAR_M).min()) <= NEAR_M for pad in last))
        found.depth_m.append(max(-float(rim.signed_distance(hand, 2 * NEAR_M).min()), 0.0))
    return found


def rim_table(scenes: int, seed: int, cars: tuple[str, ...]) -> dict[str, Any]:
    """Figures of hands at the rim, by action; `steer` is of sequences."""
    result = {}
    for action in ("drive", "drive_one_hand", "steer"):
        driver: dict[str, Any] = {"belted": True} | ({"action": action} if action != "steer" else {})
        scene = {"kind": "cabin", "occupants": {"driver": driver}, "occupancy": {}, "cars": cars}
        scene |= {"sequence": _STEER} if action == "steer" else {}
        sampler = SceneSampler(SynthConfig.model_validate({"scene": scene}), seed)
        pads, depth = list[int](), list[float]()
        apart = _STEER_APART if action == "steer" else _APART
        for index in range(0, apart * scenes, apart):
            try:
                found = grips(sampler.sample(index, rng=frame_rng(seed, index)))
            except SceneError:
                continue
            pads += found.pads
            depth += found.depth_m
        held = (np.array(pads) >= _PADS) & (np.array(depth) <= FLESH_M)
        result[action] = {
            "hands": len(pads), "held": round(float(held.mean()), 3), "pads": round(float(np.mean(pads)), 2),
            "depth_median_mm": round(1000 * float(np.median(depth)), 1), "depth_max_mm": round(1000 * max(depth), 1),
        }  # fmt: skip
    return result


def draw(row: Row, scenes: int, seed: int, cars: tuple[str, ...]) -> dict[str, Any]:
    """A row's figures over some scenes."""
    wanted = {"occupants": {row.slot: {"action": row.action, "belted": True}}, "occupancy": {}, "cars": cars, "in_hand": 1.0}
    if row.held:
        wanted["held"] = row.held
    config = SynthConfig.model_validate({"scene": {"kind": "cabin", **wanted}})
    sampler, found, proposals, none = SceneSampler(config, seed), [], 0, 0
    for index in range(0, _APART * scenes, _APART):
        try:
            scene = sampler.sample(index, rng=frame_rng(seed, index))
        except SceneError:
            none += 1
            continue
        proposals += scene.proposals
        one = measure(row, scene)
        if one is not None:
            found.append(one)
    gap, depth, fingers = (np.array(v) for v in zip(*found, strict=True))
    touches = (gap <= NEAR_M) & (depth <= FLESH_M)
    return {
        "count": len(found), "no_scene_found": none,
        "gap_median_mm": round(1000 * float(np.median(gap)), 1), "gap_q90_mm": round(1000 * float(np.quantile(gap, 0.9)), 1),
        "touches": round(float(touches.mean()), 3),
        "depth_median_mm": round(1000 * float(np.median(depth)), 1), "depth_max_mm": round(1000 * float(depth.max()), 1),
        "fingers": float(np.median(fingers)), "poses_per_scene": round(proposals / max(len(found), 1), 2),
    }  # fmt: skip


def main() -> None:
    """Measure the rows asked for."""
    parser = argparse.ArgumentParser(description="How near hands come to what they are to touch.")
    parser.add_argument("--scenes", type=int, default=60, help="of each row; %(default)s")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--only", nargs="+", default=[], help="rows in whose name or action one of these words is")
    parser.add_argument("--cars", nargs="+", default=list(_CARS))
    parser.add_argument("--out", type=Path, help="a file for the JSON; default: stdout")
    arguments = parser.parse_args()
    rows = [row for row in ROWS if not arguments.only or any(w in row.name or w in row.action for w in arguments.only)]
    result = {}
    print(f"{'':38}{'median':>8}{'q90':>7}{'touches':>9}{'depth':>7}{'most':>7}{'fingers':>9}{'poses':>7}", file=sys.stderr)
    with threadpool_limits(1):
        for row in rows:
            r = result[row.name] = draw(row, arguments.scenes, arguments.seed, tuple(arguments.cars))
            print(
                f"{row.name:38}{r['gap_median_mm']:8.1f}{r['gap_q90_mm']:7.1f}{r['touches']:9.2f}{r['depth_median_mm']:7.1f}"
                f"{r['depth_max_mm']:7.1f}{r['fingers']:9.0f}{r['poses_per_scene']:7.2f}",
                file=sys.stderr, flush=True,
            )  # fmt: skip
        rim = (
            {}
            if arguments.only and "rim" not in arguments.only
            else rim_table(arguments.scenes, arguments.seed, tuple(arguments.cars))
        )
    for action, r in rim.items():
        print(
            f"rim, {action:33}{r['hands']:8}{r['held']:9.2f}{r['pads']:7.1f}{r['depth_median_mm']:7.1f}{r['depth_max_mm']:7.1f}",
            file=sys.stderr,
        )
    about = {"version": cabinpose.__version__, "seed": arguments.seed, "scenes": arguments.scenes}
    text = json.dumps({**about, "rows": result, "rim": rim}, indent=1)
    if arguments.out:
        arguments.out.write_text(text + "\n", encoding="utf-8")
    else:
        print(text)


if __name__ == "__main__":
    main()
