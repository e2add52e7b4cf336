"""Accepted scenes against the exact contact test: no penetration beyond what is stated.

    python tools/exact_gate.py --scenes 200 --workers 2

Draws scenes as `cabinpose synth` does (all presets, both drive sides, several occupants), leaves the rendering out, and
holds each against `exact_contact`: trimesh's distances with the side settled by the winding number. Prints JSON;
exits with 1 where a scene penetrates deeper than stated.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections import Counter
from multiprocessing import get_context
from pathlib import Path
from typing import Any

from exact_contact import exact_penetrations, thing_penetrations

from cabinpose.scene.body import SEGMENTS
from cabinpose.scene.contact import solid_topology
from cabinpose.synth.config import SynthConfig
from cabinpose.synth.sample import SceneSampler
from cabinpose.synth.streams import frame_rng

ROUNDING_M = 1e-6
_APART = 17  # frames


def judge(task: tuple[str, int, list[int], bool]) -> list[dict[str, Any]]:
    """The findings of some scenes: place, occupants, deepest excess by cause, and what goes beyond."""
    config_json, seed, indices, only_things = task
    sampler = SceneSampler(SynthConfig.model_validate_json(config_json), seed)
    rows = []
    for index in indices:
        scene = sampler.sample(index, rng=frame_rng(seed, index))
        occupants = [(p.slot, p.person, p.posed) for p in scene.people]
        first = scene.people[0]
        topology = solid_topology(first.person.skin_faces, first.person.skin_segment, SEGMENTS, first.posed.skin)
        found = (
            thing_penetrations(occupants, scene.things)
            if only_things
            else exact_penetrations(scene.cabin, occupants, topology, scene.settings, scene.wheel_angle, scene.things)
        )
        deepest: dict[str, float] = {}
        for p in found:
            deepest[p.cause] = max(deepest.get(p.cause, -1.0), p.excess_m)
        beyond = [f"frame {index}: {p.cause}: {p.detail} {1000 * p.excess_m:.2f} mm" for p in found if p.excess_m > ROUNDING_M]
        things = [f"{thing.thing.kind} ({thing.at})" for thing in scene.things]
        rows.append({"place": scene.place, "occupants": len(occupants), "things": things, "deepest": deepest, "beyond": beyond})
        print(f"frame {index} {scene.place}: {len(beyond)} beyond", file=sys.stderr)
    return rows


def main() -> None:
    """Run the gate over the processes asked for."""
    parser = argparse.ArgumentParser(description="Accepted scenes against the exact contact test.")
    parser.add_argument("--scenes", type=int, default=200)
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--config", type=Path, help="a configuration; left out: the default one")
    parser.add_argument("--things", action="store_true", help="only child seats and objects against people")
    arguments = parser.parse_args()
    config = SynthConfig.load(arguments.config) if arguments.config else SynthConfig()
    # Frames of a block share their cars: far apart, they meet all of them.
    shares = [[_APART * i for i in range(w, arguments.scenes, arguments.workers)] for w in range(arguments.workers)]
    tasks = [(config.model_dump_json(), arguments.seed, share, arguments.things) for share in shares]
    with get_context("spawn").Pool(arguments.workers) as pool:
        rows = [row for part in pool.map(judge, tasks) for row in part]
    beyond = [text for row in rows for text in row["beyond"]]
    result = {
        "scenes": len(rows),
        "occupants": sum(row["occupants"] for row in rows),
        "things": dict(sorted(Counter(thing for row in rows for thing in row["things"]).items())),
        "places": dict(sorted(Counter(row["place"] for row in rows).items())),
        "deepest_excess_mm": {
            cause: 1000 * max(row["deepest"].get(cause, -1.0) for row in rows) for cause in ("self", "person", "car", "thing")
        },
        "beyond_stated": len(beyond),
        "which": beyond,
    }
    print(json.dumps(result, indent=1))
    sys.exit(1 if beyond else 0)


if __name__ == "__main__":
    main()
