"""The pictures of docs/gallery.md, and that of labels in docs/dataset.md: generated frames, chosen by configuration and seed
alone and not by hand.

    python tools/make_gallery.py --out docs/images/gallery

A picture is a grid of frames. Depth is bright where it is near, dark grey where the sensor saw nothing; amplitude is grey, with
the skeletons of everybody, the joints in the colours of their visibility: green visible, yellow hidden by the own body, red by
something else.
"""

from __future__ import annotations

import argparse
import itertools
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from PIL import Image as PilImage

import cabinpose
from cabinpose.app.view.draw import amplitude_image, depth_image, draw_skeleton, resized
from cabinpose.core import apply, camera_from, invert
from cabinpose.scene.cabin import PRESETS
from cabinpose.scene.labels import LABELS
from cabinpose.store import AXES, PERSON_COLOUR, Colour, Image, Strokes, text

WIDTH, HEIGHT, GAP, CAPTION = 264, 216, 6, 20
ENLARGED, WORDS = 3, 380  # of the picture of labels: how much larger a frame is, and the width of what is written beside it, px
AXIS_M, EYES_M, GAZE_M, NEAR_M, PIECES = 0.14, 0.09, 0.6, 0.15, 17
AXIS_COLOURS = ((220, 40, 40), (40, 170, 60), (60, 110, 255))  # x to the front of the face, y left, z up
SENSOR = "camera.sensor=pico_monstar_105/4"
LEFT = "scene.right_hand_drive=0"
FRONT_ROW, DRIVER = "camera.views={front_row: 1}", "camera.views={driver: 1}"
# Of the rear seats from between the front ones, of the right one and the floor before it from above the bench.
REAR_SEATS = "camera.views={rear_seats: {position_m: [-1.00, 0.0, 1.12], look_at_m: [-1.66, 0.0, 0.50]}}"
REAR_RIGHT = "camera.views={rear_right: {position_m: [-1.70, 0.20, 1.15], look_at_m: [-1.30, -0.38, 0.40]}}"
PAIR, ALONE = "scene.occupancy={driver: 1, front_passenger: 1}", "scene.occupancy={driver: 1}"
FULL = "scene.occupancy={driver: 1, front_passenger: 1, rear_left: 1, rear_center: 1, rear_right: 1}"
ACTIONS = ("drive", "drive_one_hand", "reach_infotainment", "gear", "phone_text", "phone_ear_outer", "rest_lap", "armrest")
PEOPLE = ("S01", "S02", "S03", "S04", "S06", "S07", "S08", "S10", "S11", "S12", "S13", "S15")
CLOSEUPS = (
    ("jeans, slack hands", "lap", "S09", "rest_lap", 1),
    ("jumper", "lap", "S12", "rest_lap", 3),
    ("shorts", "lap", "S15", "rest_lap", 5),
    ("jacket", "lap", "S04", "rest_lap", 7),
    ("long hair", "face", "S02", "look_around", 2),
    ("cap and beard", "face", "S13", "look_around", 4),
    ("a cuff over the belt", "face", "S14", "belt", 8),
    ("a raised sleeve", "face", "S04", "sun_visor", 6),
)
SENSORS = ("pico_monstar_105/3", "pico_monstar_105/4", "pico_monstar_105/5", "evk75023", "evk75123")


class Cell(NamedTuple):
    """One frame of the gallery: what stands above it, and how it is generated."""

    caption: str
    overrides: tuple[str, ...]
    seed: int = 3


def cars() -> list[Cell]:
    """The seven presets, and one drawn at random."""
    scene = (LEFT, PAIR, FRONT_ROW, SENSOR)
    cells = [Cell(car.replace("_", " "), (f"scene.cars=[{car}]", *scene), seed) for seed, car in enumerate(PRESETS)]
    return [*cells, Cell("drawn at random", ("scene.cars=[]", "scene.random_cars=1", *scene), len(PRESETS))]


def views() -> list[Cell]:
    """One car from its places of a camera, with the wheel on either side, and full."""
    suv = ("scene.cars=[suv]", SENSOR)
    return [
        Cell("driver's view", (*suv, LEFT, ALONE, DRIVER), 1),
        Cell("front row's view", (*suv, LEFT, PAIR, FRONT_ROW), 5),
        Cell("the same, wheel on the right", (*suv, "scene.right_hand_drive=1", PAIR, FRONT_ROW), 5),
        Cell("five people", (*suv, LEFT, FULL, FRONT_ROW)),
        Cell("rear view", (*suv, LEFT, FULL, "camera.views={rear: 1}")),
        Cell("shuttle, facing benches", ("scene.cars=[shuttle]", SENSOR, FULL, FRONT_ROW), 1),
    ]


def actions() -> list[Cell]:
    """What drivers do."""
    scene = ("scene.cars=[sedan]", LEFT, ALONE, "people.subjects=[S01]", FRONT_ROW, SENSOR)
    return [Cell(name.replace("_", " "), (*scene, f"scene.motion={{driver: {{{name}: 1}}}}")) for name in ACTIONS]


def things() -> list[Cell]:
    """Child seats, objects on seats and laps, and what people hold."""
    rear = ("scene.cars=[suv]", LEFT, ALONE, "camera.views={rear: 1}", SENSOR)
    pair = ("scene.cars=[sedan]", LEFT, PAIR, FRONT_ROW, SENSOR, "scene.in_hand=1")
    full = ("scene.cars=[van]", LEFT, FULL, "camera.views={rear: 1}", SENSOR)
    seats = "scene.child_seats={rear_left: infant, rear_right: toddler}"
    around = "scene.objects={rear_left: {backpack: 1}, rear_center: {bottle: 1}, rear_right: {box: 1}}"
    laps = "scene.objects={rear_left: {laptop: 1}, rear_center: {bag: 1}, rear_right: {box: 1}}"
    return [
        Cell("carrier, toddler seat", (*rear, seats), 2),
        Cell("booster, bag", (*rear, "scene.child_seats={rear_right: booster}", "scene.objects={rear_left: {bag: 1}}"), 4),
        Cell("on the seats", (*rear, around), 3),
        Cell("on laps", (*full, laps), 6),
        Cell("drink, read", (*pair, "scene.motion={driver: {drink: 1}, front_passenger: {read: 1}}"), 5),
        Cell("text, telephone", (*pair, "scene.motion={driver: {phone_text: 1}, front_passenger: {phone_ear: 1}}"), 8),
    ]


def children() -> list[Cell]:
    """Children in child seats, and how belts and harnesses hold them."""
    rear = ("scene.cars=[suv]", LEFT, ALONE, REAR_SEATS, SENSOR, "scene.children=1", "scene.infants=1")
    both = (*rear, "scene.child_seats={rear_left: booster, rear_right: toddler}")
    return [
        Cell("booster, toddler seat", (*both, "scene.belted=1"), 1),
        Cell("a harness undone", (*both, "scene.belted=0"), 2),
        Cell("booster cushions, belt under the arm", (
            *rear, "scene.child_seats={rear_left: booster_cushion, rear_right: booster_cushion}", "scene.belted=1",
            "scene.belt_misuse={under_arm: 1}",
        ), 3),
        Cell("seats held by the belt", (
            *rear, "scene.child_seats={rear_left: infant, rear_right: toddler}", "scene.children=0", "scene.infants=0",
            "scene.attachments={belt: 1}",
        ), 4),
        Cell("toddlers", (*both, "scene.child_seats={rear_left: toddler, rear_right: toddler}", "scene.toddlers=1"), 5),
        Cell("jackets on seats", (*both, "scene.objects={rear_center: {jacket: 1}}"), 6),
    ]  # fmt: skip


def infants() -> list[Cell]:
    """Infants in carriers, and children without a seat."""
    car = ("scene.cars=[suv]", LEFT, "scene.occupancy={rear_center: 0.001}", SENSOR, "scene.infants=1", "scene.belted=1")
    carrier = (*car, REAR_RIGHT, "scene.child_seats={rear_right: infant}")
    return [
        Cell("an infant, buckled up", carrier, 1),
        Cell("under a blanket", (*carrier, "scene.objects={rear_right: {blanket: 1}}"), 2),
        Cell("two carriers", (*car, REAR_SEATS, "scene.child_seats={rear_left: infant, rear_right: infant}"), 3),
        Cell("standing", (*car, REAR_SEATS, "scene.loose_children={rear_center: child_stand}"), 4),
        Cell("lying on the bench", (*car, REAR_SEATS, "scene.loose_children={rear_right: child_lie}"), 5),
        Cell("in the footwell", (*car, REAR_RIGHT, "scene.loose_children={rear_right: child_footwell}"), 6),
    ]


def people() -> list[Cell]:
    """Twelve of the named people."""
    scene = ("scene.cars=[hatchback]", LEFT, ALONE, DRIVER, SENSOR)
    return [Cell(name, (*scene, f"people.subjects=[{name}]"), seed) for seed, name in enumerate(PEOPLE)]


def closeups() -> list[Cell]:
    """Passengers from 60 cm: clothes, hands, hair."""
    scene = ("scene.cars=[sedan]", LEFT, SENSOR, "camera.jitter_m=0", "camera.jitter_deg=0", "scene.people_jitter_m=0")
    lap = "camera.views={near: {position_m: [-0.36, -0.30, 0.92], look_at_m: [-0.66, -0.37, 0.36]}}"
    face = "camera.views={near: {position_m: [-0.40, -0.18, 0.92], look_at_m: [-0.98, -0.37, 0.78]}}"
    cells = []
    for caption, view, subject, action, seed in CLOSEUPS:
        who = f"subject: {subject}, outfit: 0, action: {action}, belted: {seed % 2 == 0}"
        sits = f"scene.occupants={{front_passenger: {{{who}}}}}"
        cells.append(Cell(caption, (*scene, lap if view == "lap" else face, sits), seed))
    return cells


def sensors() -> list[Cell]:
    """One scene, seen by several cameras."""
    scene = ("scene.cars=[van]", LEFT, PAIR, FRONT_ROW)
    return [Cell(name, (*scene, f"camera.sensor={name}")) for name in SENSORS]


def frame_of(cell: Cell) -> dict[str, Any]:
    """The first frame of a cell's configuration."""
    return next(cabinpose.generate(*cell.overrides, frames=1, seed=cell.seed))


def depth_panel(frame: dict[str, Any]) -> Image:
    """Depth in colours between its own 1st and 99th percentile."""
    near, far = np.nanquantile(frame["depth"], (0.01, 0.99))
    return depth_image(frame["depth"], float(near), float(far))


def skeleton_panel(frame: dict[str, Any]) -> Image:
    """Amplitude with everybody's skeleton; depth where the camera has no amplitude."""
    bright = float(np.quantile(frame["amplitude"], 0.97))
    image = amplitude_image(frame["amplitude"], bright) if bright > 0 else depth_panel(frame)
    for joints, visibility in zip(frame["joints_2d"], frame["visibility"], strict=True):
        if np.isfinite(joints).any():
            draw_skeleton(image, joints, visibility)
    return image


def plain_panel(frame: dict[str, Any]) -> Image:
    """Amplitude alone."""
    return np.asarray(amplitude_image(frame["amplitude"], float(np.quantile(frame["amplitude"], 0.97))))


def label_panel(frame: dict[str, Any]) -> Image:
    """The classes in their colours."""
    colours = np.zeros((256, 3), np.uint8)
    for label in LABELS:
        colours[label.id] = label.rgb >> 16 & 255, label.rgb >> 8 & 255, label.rgb & 255
    return np.asarray(colours[frame["labels"]])


def grid(rows: Sequence[Sequence[tuple[str, Image]]]) -> Image:
    """Captioned pictures in rows, on white."""
    tops = np.cumsum([CAPTION * any(caption for caption, _ in row) + (HEIGHT + GAP if r else 0) for r, row in enumerate(rows)])
    columns = max(len(row) for row in rows)
    sheet = np.full((int(tops[-1]) + HEIGHT, columns * (WIDTH + GAP) - GAP, 3), 255, np.uint8)
    for top, row in zip(tops.tolist(), rows, strict=True):
        for c, (caption, picture) in enumerate(row):
            left = c * (WIDTH + GAP)
            text(sheet, caption, (left + 2, top - 6), size=14)
            sheet[top : top + HEIGHT, left : left + WIDTH] = resized(picture, (WIDTH, HEIGHT))
    return sheet


def wrapped(cells: Sequence[tuple[str, Image]], columns: int = 4) -> list[Sequence[tuple[str, Image]]]:
    """Cells in rows of so many."""
    return [cells[i : i + columns] for i in range(0, len(cells), columns)]


def pair_rows(cells: Sequence[Cell]) -> list[list[tuple[str, Image]]]:
    """A row of depth, and below it one of amplitude with skeletons."""
    frames = [(cell.caption, frame_of(cell)) for cell in cells]
    return [[(name, depth_panel(f)) for name, f in frames], [("", skeleton_panel(f)) for _, f in frames]]


def with_labels(cells: Sequence[Cell]) -> list[list[tuple[str, Image]]]:
    """Rows of depth, amplitude and classes."""
    frames = [(cell.caption, frame_of(cell)) for cell in cells]
    plain = [plain_panel(f) for _, f in frames]
    return [
        [(name, depth_panel(f)) for name, f in frames],
        [("", picture) for picture in plain],
        [("", label_panel(f)) for _, f in frames],
    ]


def room() -> Image:
    """People standing before a Kinect-class camera, by the configuration of `cabinpose config init --scene room`."""
    from cabinpose.synth.config import room_preset

    frames = list(cabinpose.generate(frames=4, seed=3, config=room_preset()))
    return grid([[("", depth_panel(f)) for f in frames], [("", skeleton_panel(f)) for f in frames]])


def sequences() -> Image:
    """Three activities, six moments of each."""
    rows = []
    for activity, slot, subject, first, seed in (
        ("drink", "front_passenger", "S07", 2, 1),
        ("look_over_shoulder", "front_passenger", "S05", 8, 3),
        ("operate", "driver", "S06", 4, 2),
    ):
        overrides = (
            "scene.cars=[suv]", LEFT, FRONT_ROW, SENSOR, f"scene.occupants={{{slot}: {{subject: {subject}}}}}",
            f"scene.sequence={{frames: 60, rate_hz: 15, activities: [{activity}]}}", "scene.in_hand=1",
        )  # fmt: skip
        frames = list(cabinpose.generate(*overrides, frames=40, seed=seed))[first : first + 36 : 6]
        bright = float(np.quantile(frames[0]["amplitude"], 0.97))
        row = []
        for frame in frames:
            image = amplitude_image(frame["amplitude"], bright)
            draw_skeleton(image, *next((j, v) for j, v in zip(frame["joints_2d"], frame["visibility"], strict=True) if v.any()))
            doing = next(action for action in frame["action"] if action)
            row.append((f"{frame['sync_ns'] / 1e9:.1f} s  {doing.replace('_', ' ')}", image))
        rows.append(row)
    return grid(rows)


def labels_of_people() -> Image:
    """What a dataset says of the people in a frame: boxes, head pose, gaze, distances and words."""
    seats = "scene.occupants={front_passenger: {action: read}, rear_left: {}}"
    scene = ("scene.cars=[suv]", LEFT, PAIR, FRONT_ROW, SENSOR, "scene.in_hand=1", "output.gaze=true", seats)
    frame = frame_of(Cell("", scene, 11))
    small = plain_panel(frame)
    height, width = (ENLARGED * size for size in small.shape[:2])
    image = np.array(PilImage.fromarray(small).resize((width, height), PilImage.Resampling.BICUBIC))
    camera = camera_from(frame["camera_k"], frame["camera_dist"], small.shape[1], small.shape[0])
    camera_from_vehicle = invert(frame["vehicle_from_camera"])
    sheet = np.full((height, width + WORDS, 3), 255, np.uint8)
    top = 0
    with Strokes(image) as strokes:

        def line(start: np.ndarray, end: np.ndarray, colour: Colour, thick: float) -> None:
            """Of what lies before the camera, in pieces: a lens bends it."""
            points = apply(camera_from_vehicle, np.linspace(start, end, PIECES))
            with np.errstate(all="ignore"):
                places = ENLARGED * (camera.project(points) + 0.5) - 0.5
            shown = (points[:, 2] > NEAR_M) & np.isfinite(places).all(axis=1)
            for k in np.flatnonzero(shown[:-1] & shown[1:]):
                strokes.line(places[k], places[k + 1], colour, thick)

        for row in np.flatnonzero(np.array(frame["subject"]) != ""):
            colour = PERSON_COLOUR[row % len(PERSON_COLOUR)]
            corners = np.array(list(itertools.product(*frame["box_3d"][row].T.tolist())))
            for start, end in itertools.combinations(corners, 2):
                if np.count_nonzero(start - end) == 1:
                    line(start, end, colour, 1.0)
            left, upper, right, lower = ENLARGED * (frame["box_2d"][row] + (-0.5, -0.5, 0.5, 0.5)) + (ENLARGED - 1) / 2
            corners = np.array(((left, upper), (right, upper), (right, lower), (left, lower)))
            for start, end in zip(corners, np.roll(corners, -1, axis=0), strict=True):
                strokes.line(start, end, colour, 3.0)
            head = frame["vehicle_from_head"][row]
            for axis, axis_colour in enumerate(AXIS_COLOURS):
                line(head[:3, 3], head[:3, 3] + AXIS_M * head[:3, axis], axis_colour, 3.0)
            if np.isfinite(gaze := frame["gaze"][row]).all():
                eyes = head[:3, 3] + EYES_M * head[:3, 0]
                line(eyes, eyes + GAZE_M * gaze, (255, 255, 255), 2.0)
            top += 26
            text(sheet, frame["subject"][row], (width + 14, top), colour, 17, 700)
            for words in told_of(frame, row):
                top += 19
                text(sheet, words, (width + 14, top), size=13)
            top += 12
    sheet[:, :width] = image
    return sheet


def told_of(frame: dict[str, Any], row: int) -> list[str]:
    """What stands in words and numbers of somebody, in lines."""
    label = {name: frame[name][row] for name in ("sex", "age", "stature", "mass", "occupancy", "stance", "alertness", "belt")}
    lines = [
        f"{label['occupancy']}, {label['sex'] or 'sex not known'}, {label['age']:.0f} years",
        f"{label['stature']:.2f} m, {label['mass']:.0f} kg",
        f"{label['stance']}, {label['alertness']}; belt {label['belt']}",
        f"hands: {', '.join(frame['in_hand'][row])}",
        f"looks at: {frame['gaze_target'][row] or 'not known'}",
    ]
    for part, off in zip(AXES["body_part"], frame["distance"][row], strict=True):
        known = [f"{name} {value:.2f} m" for name, value in zip(AXES["hazard"], off, strict=True) if np.isfinite(value)]
        if known and "foot" not in part:
            lines.append(f"{part} to {', '.join(known)}")
    return lines


def main() -> None:
    """Make all pictures."""
    parser = argparse.ArgumentParser(description="The pictures of docs/gallery.md.")
    parser.add_argument("--out", type=Path, required=True, help="folder of the pictures (WebP)")
    arguments = parser.parse_args()
    arguments.out.mkdir(parents=True, exist_ok=True)
    pictures = {
        "cars": grid([row for half in wrapped(cars()) for row in pair_rows(half)]),
        "views": grid([row for half in wrapped(views(), 3) for row in pair_rows(half)]),
        "actions": grid(wrapped([(cell.caption, skeleton_panel(frame_of(cell))) for cell in actions()])),
        "people": grid(wrapped([(cell.caption, skeleton_panel(frame_of(cell))) for cell in people()])),
        "closeups": grid(wrapped([(cell.caption, plain_panel(frame_of(cell))) for cell in closeups()])),
        "things": grid([row for half in wrapped(things(), 3) for row in with_labels(half)]),
        "children": grid([row for half in wrapped(children(), 3) for row in with_labels(half)]),
        "infants": grid([row for half in wrapped(infants(), 3) for row in with_labels(half)]),
        "sensors": grid(pair_rows(sensors())),
        "room": room(),
        "sequences": sequences(),
        "labels-of-people": labels_of_people(),
    }
    for name, picture in pictures.items():
        path = arguments.out / f"{name}.webp"
        PilImage.fromarray(picture).save(path, quality=82, method=6)
        print(f"{path}: {picture.shape[1]} x {picture.shape[0]}, {path.stat().st_size / 1000:.0f} kB")


if __name__ == "__main__":
    main()
