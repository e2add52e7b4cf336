"""Where lap belts and harnesses lie on bodies: a table of the rendered webbing against bones and the dressed surface.

    python tools/belt_fit.py --scenes 30 > belts.json

Draws valid scenes as `cabinpose synth` does, each with one place asked for, leaves the rendering out, and prints a table on
stderr and JSON on stdout. Heights are along the pelvis, mm, as far aside as the anterior superior iliac spines (ASIS) are: of the
upper edge of the lap part over the ASIS, of its middle over the femur heads, and how far that is before the ASIS; the share of
scenes in which the upper edge is below. ASIS are placed from the femur heads after Bell, Pedersen and Brand (1990): these lie
30 % of the distance of the two ASIS below, 19 % behind and 14 % inwards of them. The gap is that of all webbing from the dressed
surface: its 90 % quantile, and the share within 10 mm.
"""

from __future__ import annotations

import argparse
import json
import sys
from typing import Any

import numpy as np
from numpy.typing import NDArray
from threadpoolctl import threadpool_limits

from cabinpose.core import CABINPOSE
from cabinpose.core.errors import SceneError
from cabinpose.scene import LABEL_ID
from cabinpose.scene.contact import triangle_mesh
from cabinpose.synth.config import SynthConfig
from cabinpose.synth.sample import SceneSampler
from cabinpose.synth.scene import ScenePerson
from cabinpose.synth.streams import frame_rng

_APART = 17  # frames
_CARS = ("city_car", "hatchback", "sedan", "suv", "van")
_STATION = 6  # vertices of a ribbon's cross-section
_STEPS = 40
ROWS: dict[str, tuple[str, dict[str, Any]]] = {
    "adult": ("front_passenger", {}),
    "booster": ("rear_left", {"child_seats": {"rear_left": "booster"}, "children": 1.0}),
    "booster_cushion": ("rear_left", {"child_seats": {"rear_left": "booster_cushion"}, "children": 1.0}),
    "toddler": ("rear_left", {"child_seats": {"rear_left": "toddler"}, "children": 1.0, "toddlers": 0.5}),
    "infant": ("rear_left", {"child_seats": {"rear_left": "infant"}, "infants": 1.0}),
}


def asis(person: ScenePerson) -> NDArray[np.float64]:
    """(2, 3) m: the left and the right ASIS of a posed body, vehicle frame."""
    heads = person.posed.joints[[CABINPOSE.index["lpelvis"], CABINPOSE.index["rpelvis"]]]
    pelvis = np.asarray(person.posed.vehicle_from_root)[:3, :3]
    apart = np.linalg.norm(heads[0] - heads[1]) / (1.0 - 2.0 * 0.14)
    inwards = np.array(((0.0, 1.0, 0.0), (0.0, -1.0, 0.0)))
    return np.asarray(heads + apart * (np.array((0.19, 0.0, 0.30)) + 0.14 * inwards) @ pelvis.T)


def lap_rows(webbing: NDArray[np.float64]) -> NDArray[np.float64]:
    """(2 sides, stations, edge - middle - edge, 3) m of the last ribbon of a belt: the lap part, outer and inner side."""
    return webbing[-_STATION * _STEPS :].reshape(2, _STEPS, 3, 3)


def measured(person: ScenePerson) -> dict[str, float]:
    """Heights of the lap part (mm), and the gap and the depth of all the webbing."""
    webbing = person.surfaces[1]
    vertices = webbing.vertices.astype(np.float64)
    skin = person.surfaces[0]
    kept = skin.label != LABEL_ID["hair"]
    mesh = triangle_mesh(skin.vertices, np.ascontiguousarray(skin.faces[kept]), closed=False)
    distance = np.abs(mesh.signed_distance(vertices, 0.3))
    found = {"gap_90": 1000 * float(np.quantile(distance, 0.9)), "within_10": float((distance < 0.010).mean())}
    if person.belt != "harness":
        over, above, before = height_of_lap(person)
        found |= {"over_asis": 1000 * over, "over_heads": 1000 * above, "before_asis": 1000 * before}
    return found


def height_of_lap(person: ScenePerson) -> tuple[float, float, float]:
    """Of a worn lap part, m: its upper edge over the ASIS, its middle over the femur heads, and before the ASIS."""
    pelvis = np.asarray(person.posed.vehicle_from_root)[:3, :3]
    rows = lap_rows(person.surfaces[1].vertices.astype(np.float64))[1] @ pelvis
    spines = asis(person) @ pelvis
    heads = person.posed.joints[[CABINPOSE.index["lpelvis"], CABINPOSE.index["rpelvis"]]] @ pelvis
    rows = rows[4:-4]  # but for what hangs at the anchors
    at = [int(np.argmin(np.abs(rows[:, 1, 1] - spine[1]) + (rows[:, 1, 0] < spine[0]))) for spine in spines]
    over = np.mean([rows[k, :, 2].max() - spine[2] for k, spine in zip(at, spines, strict=True)])
    above = np.mean([rows[k, 1, 2] - head[2] for k, head in zip(at, heads, strict=True)])
    before = np.mean([rows[k, 1, 0] - spine[0] for k, spine in zip(at, spines, strict=True)])
    return float(over), float(above), float(before)


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scenes", type=int, default=30)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--only", nargs="*", default=list(ROWS))
    given = parser.parse_args()
    table = {}
    for name in given.only:
        slot, scene = ROWS[name]
        data = {"cars": list(_CARS), "right_hand_drive": 0.0, "belted": 1.0, "occupants": {slot: {}}, "occupancy": {}} | scene
        sampler = SceneSampler(SynthConfig.parse({"scene": data}), given.seed)
        values: list[dict[str, float]] = []
        for index in range(0, given.scenes * _APART, _APART):
            try:
                found = sampler.sample(index, rng=frame_rng(given.seed, index))
            except SceneError:
                continue
            values.append(measured(next(person for person in found.people if person.slot == slot)))
        keys = values[0]
        table[name] = {key: round(float(np.median([v[key] for v in values])), 2) for key in keys}
        if "over_asis" in keys:
            table[name]["below_asis"] = round(float(np.mean([v["over_asis"] < 0.0 for v in values])), 3)
        sys.stderr.write(f"{name}: {table[name]}\n")
    sys.stdout.write(json.dumps({"scenes": given.scenes, "seed": given.seed, "rows": table}, indent=1) + "\n")


if __name__ == "__main__":
    with threadpool_limits(1):
        main()
