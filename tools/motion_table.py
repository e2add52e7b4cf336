"""How sequences of generated people come out: what share of their poses and ways holds, and how fast hands are.

    python tools/motion_table.py --sequences 20 > motion.json
    python tools/motion_table.py --cars suv --seats driver --activities reach_down --sequences 8

Plans sequences of 90 frames at 30 frames a second as `cabinpose synth` does, leaves the rendering out, and prints tables on
stderr and JSON on stdout. Acceptance is that of `cabinpose synth`: of the poses, and the ways between them, of which it was said
whether they hold, the share of those that do. Of each seat and activity: how often it was tried and done, and what was most in
the way. Of each activity the movements of the faster hand's palm: peak and mean of its speed and the peak of its acceleration,
from places every 1/120 s, medians over movements of more than 0.1 m, with the ratio of peak to mean speed (1.875 for a
straight movement of least jerk: Flash and Hogan 1985).
"""

from __future__ import annotations

import argparse
import json
import sys
from collections import Counter, defaultdict
from typing import Any

import numpy as np
from threadpoolctl import threadpool_limits

import cabinpose
from cabinpose.core.errors import SceneError
from cabinpose.synth.config import SynthConfig
from cabinpose.synth.motion.film import Film
from cabinpose.synth.sample import SceneSampler
from cabinpose.synth.scene import Tried
from cabinpose.synth.validate import by_cause, most_common

STEP_S, LEAST_M = 1.0 / 120.0, 0.1


def movements(film: Film) -> list[tuple[str, float, float, float]]:
    """Activity, peak and mean speed (m/s), and peak acceleration (m/s^2) of the faster palm in each movement."""
    lasts_s, found = (film.sequence.frames - 1) / film.sequence.rate_hz, []
    for slot, track in film.tracks.items():
        person = film.cast.people[slot]
        for segment in track.segments:
            if segment.evenly or segment.start_s + segment.lasts_s > lasts_s:
                continue
            times = np.arange(segment.start_s, segment.start_s + segment.lasts_s, STEP_S)
            poses = [track.pose_of(state) for state in segment.states(times)]
            bodies = [person.pose(pose.q, pose.root) for pose in poses]
            places = np.stack([[body.palms[side][:3, 3] for side in "lr"] for body in bodies])
            velocity = np.diff(places, axis=0) / STEP_S
            speed = np.linalg.norm(velocity, axis=2)
            hand = int(speed.max(axis=0).argmax())
            if speed[:, hand].sum() * STEP_S > LEAST_M:
                jerky = np.linalg.norm(np.diff(velocity[:, hand], axis=0), axis=1) / STEP_S
                found.append((segment.activity, speed[:, hand].max(), speed[:, hand].mean(), jerky.max()))
    return found


def medians(found: list[tuple[str, float, float, float]]) -> dict[str, dict[str, float]]:
    """By activity, and of all movements."""
    by = defaultdict(list)
    for activity, *numbers in found:
        by[activity].append(numbers)
        by["all"].append(numbers)
    result = {}
    for activity, rows in sorted(by.items()):
        peak, mean, acceleration = np.array(rows).T
        result[activity] = {
            "movements": len(rows), "peak_m_s": round(float(np.median(peak)), 2), "mean_m_s": round(float(np.median(mean)), 2),
            "peak_over_mean": round(float(np.median(peak / mean)), 2),
            "acceleration_m_s2": round(float(np.median(acceleration)), 1),
        }  # fmt: skip
    return result


def main() -> None:
    """Plan the sequences asked for."""
    parser = argparse.ArgumentParser(description="How sequences of generated people come out.")
    parser.add_argument("--sequences", type=int, default=20, help="how many; %(default)s")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--frames", type=int, default=90, help="of each, at 30 a second; %(default)s")
    parser.add_argument("--activities", nargs="+", help="those asked for; left out: anything")
    parser.add_argument("--cars", nargs="+", help="left out: the default ones")
    parser.add_argument("--seats", nargs="+", help="those that are taken in each scene; left out: as by default")
    parser.add_argument("--in-hand", type=float, default=0.0, help="share of people with something in the hand; %(default)s")
    given = parser.parse_args()
    scene: dict[str, Any] = {"kind": "cabin", "in_hand": given.in_hand, "sequence": {"frames": given.frames, "rate_hz": 30.0}}
    scene |= {"cars": given.cars} if given.cars else {}
    scene |= {"occupancy": dict.fromkeys(given.seats, 1.0)} if given.seats else {}
    scene["sequence"] |= {"activities": given.activities} if given.activities else {}
    sampler = SceneSampler(SynthConfig.model_validate({"scene": scene}), given.seed)
    judged, scenes, given_up, tried, rejections, found = 0, 0, 0, Counter[Tried](), Counter(), []
    with threadpool_limits(1):
        for number in range(given.sequences):
            try:
                film = sampler.plan_sequence(number)
            except SceneError as error:
                given_up += 1
                print(error, file=sys.stderr)
                continue
            judged, scenes = judged + film.attempts.judged, scenes + len(film.attempts.scenes)
            tried.update(film.attempts.tried)
            rejections.update(film.attempts.rejections)
            found += movements(film)
    rows = {}
    for slot, activity in sorted({(t.slot, t.activity) for t in tried}):
        mine = {t.against: n for t, n in tried.items() if (t.slot, t.activity) == (slot, activity)}
        against = Counter({reason: n for reason, n in mine.items() if reason})
        done, worst = sum(mine.values()) - sum(against.values()), against.most_common(1)
        rows[f"{slot} {activity}"] = {"tried": sum(mine.values()), "done": done, "against": worst[0][0] if worst else ""}
        print(f"{slot:16}{activity:20}{sum(mine.values()):5}{done:5}  {worst[0][0] if worst else ''}", file=sys.stderr)
    times, done = (max(sum(row[of] for row in rows.values()), 1) for of in ("tried", "done"))
    result = {
        "version": cabinpose.__version__, "seed": given.seed, "sequences": given.sequences, "given_up": given_up,
        "scenes": scenes,
        "acceptance": round(1.0 - sum(rejections.values()) / max(judged, 1), 3), "judged": judged,
        "activities_done": round(done / times, 3),
        "causes": by_cause(rejections), "most": most_common(rejections, 5), "activities": rows, "hands": medians(found),
    }  # fmt: skip
    print(json.dumps({k: v for k, v in result.items() if k not in ("activities", "hands")}, indent=1), file=sys.stderr)
    print(json.dumps(result, indent=1))


if __name__ == "__main__":
    main()
