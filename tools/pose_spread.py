"""How widely the poses of generated occupants spread: measure it, and hold one measurement against another.

    python tools/pose_spread.py --scenes 2000 > docs/baseline/pose-spread.json
    python tools/pose_spread.py --scenes 500 --occupants 5 > docs/baseline/pose-spread-five.json
    python tools/pose_spread.py --compare docs/baseline/pose-spread.json new.json

Draws valid scenes as `cabinpose synth` does, leaves the rendering out, and prints JSON. For drivers (in cars with a wheel) and
passengers (all others): every joint axis, hands and feet from the pelvis, elbows, knees, torso and eyes, each a row of `columns`;
the covariance of the hands, what they touch, how often an axis is at its limit; what is seen of front passengers, and how alike
both knees are; the drivers' seats against stature; acceptance and CPU time. `--compare` prints what differs, the most narrowed or
shifted first.

Places are in the seat's axes (x forward as the occupant faces, y left, z up) from the middle between the femur heads. A hand's
contact is measured, not taken from the action: the nearest of wheel and own body to its palm. Everything is read from `Scene`,
`Cabin`, `Person` and `PosedBody`; the angles are `PosedBody.q`.
"""

from __future__ import annotations

import argparse
import json
import time
from collections import Counter, defaultdict
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from threadpoolctl import threadpool_limits

import cabinpose
from cabinpose.core.errors import SceneError
from cabinpose.core.skeleton import CABINPOSE
from cabinpose.scene.body import BONE_INDEX, DOFS, SEGMENTS, Person, PosedBody
from cabinpose.scene.cabin import Cabin, Seat, SeatSetting, SteeringWheel
from cabinpose.synth.config import SynthConfig
from cabinpose.synth.posture import SeatContext
from cabinpose.synth.sample import SceneSampler
from cabinpose.synth.scene import Scene, ScenePerson
from cabinpose.synth.streams import frame_rng
from cabinpose.synth.validate import by_cause

SEATS = ("driver", "front_passenger", "rear_left", "rear_right", "rear_center")  # the order in which --occupants fills a car
QUANTILES = (1, 5, 25, 50, 75, 95, 99)  # %
COLUMNS = ("count", "mean", "sd", *(f"q{q}" for q in QUANTILES))
HANDS, FEET = ("lhand", "rhand"), ("lfoot", "rfoot")
LIMIT = 0.002  # rad (`hand.grip`: share) from the end of its range of motion an axis counts as at its limit
_TOUCH_M = {"wheel": 0.03, "thigh": 0.05, "trunk": 0.05, "head": 0.06}  # from a palm's frame, which is 15 mm off its skin
_BODY = {"thigh": ("lthigh", "rthigh"), "trunk": ("pelvis", "abdomen", "thorax"), "head": ("head", "neck")}
_APART = 17  # frames near each other share people: far apart, they meet all of them


def joint_axes(posed: PosedBody) -> dict[str, float]:
    """Every degree of freedom in degrees; `hand.grip` runs from 0 (open) to 1 (fist) and has no unit."""
    return {dof.name: float(v if dof.name.endswith("grip") else np.degrees(v)) for dof, v in zip(DOFS, posed.q, strict=True)}


def bend(joints: NDArray[np.float64], a: str, b: str, c: str) -> float:
    """The angle at joint b between the lines to a and c, deg: 180 is straight."""
    u, v = joints[CABINPOSE.index[a]] - joints[CABINPOSE.index[b]], joints[CABINPOSE.index[c]] - joints[CABINPOSE.index[b]]
    return float(np.degrees(np.arccos(np.clip(u @ v / np.linalg.norm(u) / np.linalg.norm(v), -1.0, 1.0))))


def geometry(posed: PosedBody, facing_yaw: float) -> dict[str, float]:
    """Places (mm) from the pelvis in the seat's axes, and angles (deg) between joints."""
    c, s = np.cos(facing_yaw), np.sin(facing_yaw)
    seat_from_vehicle = np.array(((c, s, 0.0), (-s, c, 0.0), (0.0, 0.0, 1.0)))
    at = {name: posed.joints[index] for name, index in CABINPOSE.index.items()}
    pelvis = (at["lpelvis"] + at["rpelvis"]) / 2
    result: dict[str, float] = {}
    for name in HANDS + FEET:
        place = 1000 * seat_from_vehicle @ (at[name] - pelvis)
        result |= {f"{name} {axis} from pelvis, mm": float(v) for axis, v in zip("xyz", place, strict=True)}
    for side in "lr":
        result[f"{side}elbow angle, deg"] = bend(posed.joints, side + "shoulder", side + "elbow", side + "wrist")
        result[f"{side}knee angle, deg"] = bend(posed.joints, side + "pelvis", side + "knee", side + "ankle")
    back = seat_from_vehicle @ ((at["lshoulder"] + at["rshoulder"]) / 2 - pelvis)
    eyes = seat_from_vehicle @ (posed.eyes_m - pelvis)
    result["torso recline, deg"] = float(np.degrees(np.arctan2(-back[0], back[2])))
    return result | {"pelvis to eyes, mm": float(1000 * np.linalg.norm(eyes)), "eyes above pelvis, mm": float(1000 * eyes[2])}


def contacts(person: Person, posed: PosedBody, wheel: SteeringWheel | None) -> dict[str, str]:
    """What each hand touches: wheel, thigh, trunk, head, or other (the car or nothing)."""
    result = {}
    for side in "lr":
        palm = posed.palms[side][:3, 3]
        distance = {}
        if wheel is not None:
            x, y, z = wheel.vehicle_from_wheel[:3, :3].T @ (palm - wheel.vehicle_from_wheel[:3, 3])
            distance["wheel"] = float(np.hypot(np.hypot(x, y) - wheel.rim_radius_m, z))
        for place, segments in _BODY.items():
            skin = posed.skin[np.isin(person.skin_segment, [SEGMENTS.index(name) for name in segments])]
            distance[place] = float(np.linalg.norm(skin - palm, axis=1).min())
        touched = [place for place, d in distance.items() if d < _TOUCH_M[place]]
        result[side + "hand"] = min(touched, key=distance.__getitem__) if touched else "other"
    return result


def seen_of_passenger(person: ScenePerson, seat: Seat, setting: SeatSetting, cabin: Cabin) -> dict[str, bool]:
    """What Reed (2020, UMTRI-2020-2) counted in photographs of front passengers, by measures of ours.

    Turned is more than 20 deg of the head (nose against the vehicle) or of the shoulders; pitched forward is a trunk 12 deg
    before its usual place on the backrest; a thigh is raised whose slope is 8 deg more than on the cushion; legs are crossed
    where an ankle is beyond the other one, or a knee.
    """
    at = {name: person.posed.joints[index] for name, index in CABINPOSE.index.items()}
    fit = SeatContext(person.person, seat, setting, cabin).fit
    head = person.posed.bones[BONE_INDEX["head"]][:3, 0]
    across = at["lshoulder"] - at["rshoulder"]
    trunk = (at["lshoulder"] + at["rshoulder"] - at["lpelvis"] - at["rpelvis"]) / 2
    usual = fit.shoulders.mean(axis=0) - fit.seat_from_root[:3, 3]
    slopes = [np.arcsin((at[s + "knee"] - at[s + "pelvis"])[2] / np.linalg.norm(at[s + "knee"] - at[s + "pelvis"])) for s in "lr"]
    return {
        "head turned": abs(np.arctan2(head[1], head[0])) > np.radians(20),
        "torso turned": abs(np.arctan2(-across[0], across[1])) > np.radians(20),
        "pitched forward": np.arctan2(trunk[0], trunk[2]) - np.arctan2(usual[0], usual[2]) > np.radians(12),
        "a thigh raised": max(slopes) - fit.thigh_angle > np.radians(8),
        "legs crossed": any(at["l" + joint][1] < at["r" + joint][1] for joint in ("ankle", "knee")),
        "backrest beyond 30 deg": setting.torso_angle > np.radians(30),
        "behind the middle of the track": setting.fore_aft_m < sum(end.fore_aft_m for end in seat.ranges) / 2,
        "full rear": setting.fore_aft_m < seat.ranges[0].fore_aft_m + 0.01,
    }


class Spread:
    """Gathers what is measured, scene by scene."""

    def __init__(self) -> None:
        self._values: defaultdict[str, defaultdict[str, list[float]]] = defaultdict(lambda: defaultdict(list))  # by role
        self._counts: defaultdict[str, defaultdict[str, Counter[str]]] = defaultdict(lambda: defaultdict(Counter))
        self._seats: list[tuple[str, str, float, float]] = []  # car, subject, stature (cm), pelvis ahead of the heel point (mm)
        self._scenes: defaultdict[str, list[tuple[float, int, int]]] = defaultdict(list)  # CPU ms, people, proposals

    def add(self, scene: Scene, cpu_ms: float) -> None:
        """Takes in a scene in a car."""
        assert scene.cabin is not None, "a configuration of people in cars is needed"
        people, wheel = len(scene.people), scene.cabin.steering_wheel
        for group in ("all", f"{people} people"):
            self._scenes[group].append((cpu_ms, people, scene.proposals))
        self._counts["scenes"]["cars"][scene.place] += 1
        self._counts["scenes"]["rejections"].update(by_cause(scene.rejections))
        for p in scene.people:
            role = "driver" if p.slot == "driver" and wheel is not None else "passenger"
            row = joint_axes(p.posed) | geometry(p.posed, scene.cabin.seats[p.slot].facing_yaw)
            if role == "driver":
                pelvis = 500 * (p.posed.joints[CABINPOSE.index["lpelvis"]] + p.posed.joints[CABINPOSE.index["rpelvis"]])
                row |= {"pelvis ahead of the heel point, mm": float(pelvis[0]), "pelvis above the floor, mm": float(pelvis[2])}
                self._seats.append((scene.place, p.subject, 100 * p.person.stature_m, float(pelvis[0])))
            elif p.slot == "front_passenger" and wheel is not None:
                seat, setting = scene.cabin.seats[p.slot], scene.settings[p.slot]
                row["backrest, deg"] = float(np.degrees(setting.torso_angle))
                seen = seen_of_passenger(p, seat, setting, scene.cabin)
                self._counts["front_passengers"]["seen"].update(name for name, is_so in seen.items() if is_so)
                self._counts["front_passengers"]["seen"]["all"] += 1
            for name, value in row.items():
                self._values[role][name].append(value)
            self._counts["actions"][role][p.action] += 1
            near = [min(v - dof.lower, dof.upper - v) < LIMIT for dof, v in zip(DOFS, p.posed.q, strict=True)]
            self._counts["at_limit"][role].update(dof.name for dof, pinned in zip(DOFS, near, strict=True) if pinned)
            for hand, place in contacts(p.person, p.posed, wheel if role == "driver" else None).items():
                self._counts["hands_touch"][f"{role} {hand}"][place] += 1
                self._counts["hands_touch"][f"{role} {p.action}"][place] += 1

    def result(self) -> dict[str, Any]:
        """Everything as plain data, numbers rounded."""
        places = {f"{role} {hand}": [values[f"{hand} {axis} from pelvis, mm"] for axis in "xyz"]
                  for role, values in self._values.items() for hand in HANDS}  # fmt: skip
        number = {role: self._counts["actions"][role].total() for role in self._values}
        return {
            "cars": self._counts["scenes"]["cars"],
            "scenes": {name: effort(rows) for name, rows in sorted(self._scenes.items())},
            "rejections": self._counts["scenes"]["rejections"],
            "actions": {role: shares(counts, number[role]) for role, counts in self._counts["actions"].items()},
            "hands_touch": {n: shares(counts, counts.total()) for n, counts in sorted(self._counts["hands_touch"].items())},
            "at_limit": {role: shares(counts, number[role]) for role, counts in self._counts["at_limit"].items()},
            "front_passengers": shares(front, front["all"]) if (front := self._counts["front_passengers"]["seen"]) else {},
            "knees_left_right": {role: round(float(np.corrcoef(values["lknee angle, deg"], values["rknee angle, deg"])[0, 1]), 3)
                                 for role, values in self._values.items()},
            "seat_by_stature": {car: line([r for r in self._seats if car in (r[0], "all")])
                                for car in (*sorted({r[0] for r in self._seats}), "all")},
            "hands_covariance_mm2": {name: np.cov(rows).round(1).tolist() for name, rows in places.items()},
            "columns": COLUMNS,
            "quantities": {role: {name: summary(v) for name, v in values.items()} for role, values in self._values.items()},
        }  # fmt: skip


def summary(values: list[float]) -> list[float]:
    """A row of `COLUMNS`."""
    figures = np.mean(values), np.std(values), *np.percentile(values, QUANTILES)
    return [len(values), *(round(float(v), 3) for v in figures)]


def shares(counts: Counter[str], whole: int) -> dict[str, float]:
    """Counts as shares of a whole, the largest first."""
    return {name: round(count / whole, 4) for name, count in counts.most_common()}


def effort(rows: list[tuple[float, int, int]]) -> dict[str, float]:
    """CPU ms a scene, and people kept of poses proposed. The first half meets most cars and people; the second half is warm."""
    ms, people, proposals = np.array(rows).T
    figures = {"people": people.sum(), "poses": proposals.sum(), "kept": people.sum() / proposals.sum(), "cpu_ms": ms.mean(),
               "cpu_ms_median": np.median(ms), "cpu_ms_second_half": ms[len(ms) // 2 :].mean()}  # fmt: skip
    return {"count": len(ms)} | {name: round(float(value), 4) for name, value in figures.items()}


def line(rows: list[tuple[str, str, float, float]]) -> dict[str, float]:
    """Pelvis fore-aft (mm, + forward) over stature (cm), each car about its own mean; standard error clustered by person."""
    (car, subject), (x, y) = np.array([r[:2] for r in rows]).T, np.array([r[2:] for r in rows]).T
    for name in set(car):
        x[car == name] -= x[car == name].mean()
        y[car == name] -= y[car == name].mean()
    persons = set(subject)
    if len(persons) < 3:
        return {"count": len(x), "persons": len(persons)}
    slope = x @ y / (x @ x)
    rest = y - slope * x
    meat = sum((x * rest)[subject == name].sum() ** 2 for name in persons) * len(persons) / (len(persons) - 1)
    figures = {"slope_mm_per_cm": slope, "standard_error": np.sqrt(meat) / (x @ x), "residual_sd_mm": rest.std()}
    return {"count": len(x), "persons": len(persons), **{k: round(float(v), 3) for k, v in figures.items()}}


def measure(config: SynthConfig, seed: int, scenes: int) -> dict[str, Any]:
    """Draw and measure. A frame for which no scene is found is counted, with what it took."""
    sampler, spread = SceneSampler(config, seed), Spread()
    unfound: Counter[str] = Counter(frames=0)
    for index in range(0, _APART * scenes, _APART):
        start = time.process_time()
        try:
            scene = sampler.sample(index, rng=frame_rng(seed, index))
        except SceneError as error:
            unfound.update(frames=1, poses=getattr(error, "proposals", 0), cpu_ms=round(1000 * (time.process_time() - start)))
            continue
        spread.add(scene, 1000 * (time.process_time() - start))
    return {"version": cabinpose.__version__, "seed": seed, "no_scene_found": unfound, **spread.result()}


def flat(data: Any, name: str = "") -> dict[str, float]:
    """Numbers of nested mappings by their path; lists are left out."""
    if isinstance(data, dict):
        return {k: v for key, value in data.items() for k, v in flat(value, f"{name} / {key}").items()}
    return {name.strip(" /"): float(data)} if isinstance(data, int | float) else {}


def compare(a: dict[str, Any], b: dict[str, Any]) -> None:
    """Print how B departs from A: ranges and means with the worst first, then the hands' clouds, then what else differs."""
    rows, low, high = [], COLUMNS.index("q5"), COLUMNS.index("q95")
    for role, quantities in a["quantities"].items():
        for name, x in quantities.items():
            y = b["quantities"].get(role, {}).get(name, [0] + [np.nan] * (len(COLUMNS) - 1))  # not in B: comes first
            wide = x[high] - x[low], y[high] - y[low]
            ratio, shift = (wide[1] + 1e-9) / (wide[0] + 1e-9), (y[1] - x[1]) / (x[2] + 1e-9)
            worst = max(abs(np.log(ratio)), abs(shift)) if y[0] else np.inf
            text = f"{ratio:8.3f} {shift:+8.2f} {wide[0]:9.2f} {wide[1]:9.2f} {x[1]:9.2f} {y[1]:9.2f}  {role} {name}"
            rows.append((worst, text))
    print("ratio of the 5-95 % ranges B/A, shift of the mean in SDs of A; 5-95 % range of A, of B; mean of A, of B; quantity")
    print("\n".join(text for _, text in sorted(rows, reverse=True)))
    for name in sorted(a["hands_covariance_mm2"].keys() & b["hands_covariance_mm2"].keys()):
        volume = [np.sqrt(np.linalg.det(data["hands_covariance_mm2"][name])) for data in (a, b)]
        print(f"volume of the cloud of {name}, B/A: {volume[1] / volume[0]:.3f}")
    x, y = flat(a), flat(b)
    for name in sorted(x.keys() | y.keys()):
        if x.get(name) != y.get(name):
            print(f"{name}: {x.get(name, 0.0):g} -> {y.get(name, 0.0):g}")


def main() -> None:
    """Measure, or compare."""
    parser = argparse.ArgumentParser(description="How widely the poses of generated occupants spread.")
    parser.add_argument("--config", type=Path, default=Path("docs/examples/demo.yaml"), help="mix of scenes; %(default)s")
    parser.add_argument("--scenes", type=int, default=2000)
    parser.add_argument("--occupants", type=int, choices=range(1, 6), help="people in every car; default: as the mix says")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--compare", type=Path, nargs=2, metavar=("A", "B"), help="two measurements")
    arguments = parser.parse_args()
    if arguments.compare:
        compare(*(json.loads(path.read_text(encoding="utf-8")) for path in arguments.compare))
        return
    config = SynthConfig.load(arguments.config)
    if arguments.occupants:
        taken = dict.fromkeys(SEATS[: arguments.occupants], 1.0)
        config = config.model_copy(update={"scene": config.scene.model_copy(update={"occupancy": taken})})
    with threadpool_limits(1):
        result = measure(config, arguments.seed, arguments.scenes)
    print(json.dumps({"config": arguments.config.name, "occupants": arguments.occupants, **result}, separators=(",", ":")))


if __name__ == "__main__":
    main()
