"""A drawing of a user's own car: side and top view with the points of its YAML, and one frame with people in it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cabinpose.app.view.draw import amplitude_image, depth_image, depth_range, draw_skeleton, resized, to_view
from cabinpose.core import Camera, apply
from cabinpose.scene import LABEL_ID, coarse_labels
from cabinpose.scene.cabin import SIZES, Cabin, Measure, Seat, SteeringWheel, ViewAnchor
from cabinpose.scene.sensor import place_camera
from cabinpose.store import Colour, Image, Strokes, text

Floats = NDArray[np.float64]
_WIDTH, _MARGIN, _HEAD, _GAP = 1180, 60, 112, 56  # px
_SIZE = (20, 110, 60)
_PAPER, _INK, _GREY = (255, 255, 255), (28, 32, 40), (120, 128, 140)
_SEAT, _WHEEL, _PEDAL, _VIEW, _WRONG = (0, 90, 181), (196, 110, 0), (122, 98, 0), (124, 50, 158), (214, 20, 40)
_TINTS: Mapping[int, Colour] = {
    LABEL_ID["seat"]: (38, 120, 150), LABEL_ID["trim"]: (96, 98, 108), LABEL_ID["glass"]: (110, 190, 230),
    LABEL_ID["floor"]: (150, 100, 50), LABEL_ID["steering_wheel"]: (200, 120, 20),
}  # fmt: skip
_OTHER = (130, 130, 60)
_GRID = (226, 230, 236)
_POINTS = 1_500_000  # of the surface, that are drawn
_THIN = 0.22  # of ink a point leaves: surfaces seen edge on are dark, those seen flat are light
# right, up, towards the eye, in the vehicle frame
_SIDES = {
    "side view, from the left": np.array([[-1.0, 0, 0], [0, 0, 1], [0, 1, 0]]),
    "top view, front to the left": np.array([[-1.0, 0, 0], [0, -1, 0], [0, 0, 1]]),
}


def draw_car(
    cabin: Cabin,
    sizes: Sequence[Measure],
    camera: Camera,
    verdicts: Mapping[str, str],
    wrong: Sequence[Floats],
    frame: Mapping[str, NDArray[Any]] | None,
) -> Image:
    """The sheet, RGB.

    Parameters
    ----------
    cabin
        The car.
    sizes
        What is drawn as dimensions, red where a car hardly has it.
    camera
        Whose field of view the views are drawn with.
    verdicts
        A few words by slot, such as "9/12 hold".
    wrong
        Points (3,) m, vehicle frame, at which poses were refused.
    frame
        Variables of a frame with people in it, or None where no pose held.
    """
    surface = cabin.surface()
    corners = surface.vertices.astype(np.float64)[surface.faces]
    bounds = _bounds(cabin)
    plans = [_Plan(axes, bounds) for axes in _SIDES.values()]
    panels = [_panel(plan, cabin, camera, (corners, coarse_labels(surface.label)), verdicts, wrong) for plan in plans]
    for plan, panel in zip(plans, panels, strict=True):
        _dimensions(plan, panel, sizes)
    pictures = _frame_pictures(frame)
    height = _HEAD + sum(len(p) + _GAP for p in panels) + (len(pictures) + _GAP if pictures is not None else 0) + 40
    sheet = np.full((height, _WIDTH + 2 * _MARGIN, 3), _PAPER, np.uint8)
    text(sheet, f"{cabin.name}: what the YAML says, in the mesh", (_MARGIN, 38), _INK, 22, 600)
    _legend(sheet, 64)
    top = _HEAD
    for name, panel in zip(_SIDES, panels, strict=True):
        text(sheet, name, (_MARGIN, top + 14), _INK, 15, 600)
        sheet[top + 24 : top + 24 + len(panel), _MARGIN : _MARGIN + _WIDTH] = panel
        top += len(panel) + _GAP
    if pictures is not None:
        title = "one frame as the sensor sees it: depth, and amplitude with the joints"
        text(sheet, title, (_MARGIN, top + 14), _INK, 15, 600)
        sheet[top + 24 : top + 24 + len(pictures), _MARGIN : _MARGIN + pictures.shape[1]] = pictures
    else:
        text(sheet, "no pose held, or none was tried: there is no frame to show", (_MARGIN, top + 14), _WRONG, 15, 600)
    return sheet


def _bounds(cabin: Cabin) -> tuple[Floats, Floats]:
    """The box that is drawn: the mesh, and every point of the YAML, with a margin."""
    points = [*cabin.bounds, *(seat.heel_m for seat in cabin.seats.values())]
    points += [p for view in cabin.views.values() for p in (view.eye, view.target)]
    points += [pad[:3, 3] for pad in cabin.pedals.values()]
    every = np.array(points)
    return every.min(axis=0) - 0.12, every.max(axis=0) + 0.12


class _Plan:
    """Pixels of one view of the car."""

    def __init__(self, axes: Floats, bounds: tuple[Floats, Floats]) -> None:
        extent = np.abs(axes @ (bounds[1] - bounds[0]))
        self.scale = _WIDTH / extent[0]
        self.size = _WIDTH, round(extent[1] * self.scale)
        self.axes, self.bounds = axes, bounds

    def px(self, points: Sequence[Floats] | Floats) -> Floats:
        return to_view(np.atleast_2d(np.asarray(points, np.float64)), self.axes, self.bounds, self.size)


def _panel(
    plan: _Plan, cabin: Cabin, camera: Camera, mesh: tuple[Floats, NDArray[np.uint8]], verdicts: Mapping[str, str],
    wrong: Sequence[Floats],
) -> Image:  # fmt: skip
    image = np.full((plan.size[1], plan.size[0], 3), _PAPER, np.uint8)
    _grid(image, plan)
    _mesh(image, plan, *mesh)
    words: list[tuple[str, Floats, Colour]] = []
    with Strokes(image) as strokes:
        for name, view in cabin.views.items():
            _view(strokes, plan, camera, view)
            words.append((name, plan.px(view.eye)[0] + (10, -8), _VIEW))
        for slot, seat in cabin.seats.items():
            _seat(strokes, plan, seat)
            words.append((f"{slot} {verdicts.get(slot, '')}", plan.px(seat.h_point(seat.default))[0] + (10, 16), _SEAT))
        if cabin.steering_wheel is not None:
            _wheel(strokes, plan, cabin.steering_wheel)
        for pad in cabin.pedals.values():
            strokes.dot(plan.px(pad[:3, 3])[0], 5, _PEDAL)
        strokes.dot(plan.px(np.zeros(3))[0], 5, _INK)
    words.append(("origin", plan.px(np.zeros(3))[0] + (8, -6), _INK))
    _words(image, words)
    with Strokes(image) as strokes:  # over the words: what is wrong must not be hidden
        for at in plan.px(wrong) if wrong else ():
            strokes.line(at + (-5, -5), at + (5, 5), _WRONG, 2)
            strokes.line(at + (-5, 5), at + (5, -5), _WRONG, 2)
    return image


def _dimensions(plan: _Plan, image: Image, sizes: Sequence[Measure]) -> None:
    """Dimension lines with their lengths: the car's, the driver's, and what is unusual, as far as the plane shows them."""
    words: list[tuple[str, Floats, Colour]] = []
    with Strokes(image) as strokes:
        for size in sizes:
            start, end = plan.px(size.ends)
            along = end - start
            length = float(np.linalg.norm(along))
            axis = int(np.argmax(np.abs(size.ends[1] - size.ends[0])))
            shown = size.slot in ("", "driver") or size.unusual
            twice = plan.axes[2][2] > 0 and axis == 0 and size.slot  # the side view has it
            if length < 2 or not plan.axes[:2, axis].any() or not shown or twice:
                continue
            colour = _WRONG if size.unusual else _SIZE
            tick = np.array((-along[1], along[0])) / length * 6
            strokes.line(start, end, colour, 3 if size.unusual else 1.5)
            for at in (start, end):
                strokes.line(at - tick, at + tick, colour, 1.5)
            words.append((f"{SIZES[size.name].short} {size.metres:.2f}", (start + end) / 2 + (6, -4), colour))
    _words(image, words)


def _words(image: Image, words: Sequence[tuple[str, Floats, Colour]]) -> None:
    """Labels on white, each moved down until it is clear of those before it."""
    taken: list[tuple[float, float, float]] = []
    for said, at, colour in words:
        x, y, width = float(np.clip(at[0], 2, _WIDTH - 8 * len(said))), float(at[1]), 6.9 * len(said)
        y = float(np.clip(y, 16, len(image) - 6))
        while any(abs(y - other_y) < 17 and x < right and left < x + width for left, right, other_y in taken):
            y += 17
        taken.append((x, x + width, y))
        box = image[max(round(y) - 13, 0) : round(y) + 5, round(x) - 2 : round(x + width)]
        box[...] = (0.25 * box + 0.75 * 255).astype(np.uint8)
        text(image, said, (round(x), round(y)), colour, 14, 600)


def _grid(image: Image, plan: _Plan) -> None:
    """Lines every half metre with their coordinates, the names of the axes, and a scale bar of 1 m."""
    low, high = plan.bounds
    marks = []
    for row, axis in ((0, int(np.argmax(np.abs(plan.axes[0])))), (1, int(np.argmax(np.abs(plan.axes[1]))))):
        for value in np.arange(np.ceil(low[axis] * 2) / 2, high[axis], 0.5):
            point = (low + high) / 2
            point[axis] = value
            at = plan.px(point)[0]
            marks.append((row, "xyz"[axis], value, at[row]))
    with Strokes(image) as strokes:
        for row, _, value, at in marks:
            ends = ((at, 0.0), (at, len(image))) if row == 0 else ((0.0, at), (_WIDTH, at))
            strokes.line(np.array(ends[0]), np.array(ends[1]), _GREY if value == 0 else _GRID, 1)
        bar = np.array((_WIDTH - 24 - plan.scale, len(image) - 34.0))
        strokes.line(bar, bar + (plan.scale, 0), _INK, 4)
    for row, name, value, at in marks:
        place = (round(at) + 3, len(image) - 6) if row == 0 else (3, round(at) - 4)
        text(image, f"{name} {value + 0.0:g}", place, _GREY, 12)
    text(image, "1 m", (round(bar[0] + plan.scale / 2 - 12), len(image) - 40), _INK, 14, 600)
    up = "xyz"[int(np.argmax(np.abs(plan.axes[1])))]
    meaning = {"z": "z up", "y": "y left (down in this picture)"}[up]
    text(image, f"x forward (to the left), {meaning}, m", (48, 18), _GREY, 13)


def _mesh(image: Image, plan: _Plan, corners: Floats, labels: NDArray[np.uint8]) -> None:
    """The surface, translucent, in the colours of its labels: a pixel is darker the more surface projects onto it."""
    rng = np.random.Generator(np.random.Philox(0))  # random points: a regular pattern would be visible
    one, two = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    area = np.linalg.norm(np.cross(one, two), axis=1)
    face = rng.choice(len(area), _POINTS, p=area / area.sum())
    weights = rng.random((_POINTS, 2))
    weights[weights.sum(axis=1) > 1] = 1 - weights[weights.sum(axis=1) > 1]
    points = corners[face, 0] + weights[:, :1] * one[face] + weights[:, 1:] * two[face]
    u, v = np.round(plan.px(points)).astype(int).T
    inside = (u >= 0) & (u < image.shape[1]) & (v >= 0) & (v < image.shape[0])
    pixel, label = (v * image.shape[1] + u)[inside], labels[face][inside]
    colours = np.zeros((256, 3))
    for number in np.unique(labels).tolist():
        colours[number] = _TINTS.get(number, _OTHER)
    tint = colours[label]
    count = np.bincount(pixel, minlength=image.shape[0] * image.shape[1]).reshape(image.shape[:2])
    ink = np.stack([np.bincount(pixel, tint[:, i], count.size).reshape(count.shape) for i in range(3)], axis=-1)
    share = (1 - np.exp(-_THIN * count))[..., None]
    colour = ink / np.maximum(count, 1)[..., None]
    image[...] = (image * (1 - share) + colour * share).astype(np.uint8)


def _seat(strokes: Strokes, plan: _Plan, seat: Seat) -> None:
    """H-point, the torso's line, thigh and shin to the heel point."""
    setting = seat.default
    h, heel = seat.h_point(setting), seat.heel_point(setting)
    shoulder = apply(seat.vehicle_from_back(setting), (0.0, 0.0, 0.5))
    along = heel - h
    knee = h + 0.52 * along + (0, 0, 0.24 + 0.3 * abs(float(along[2])))
    at = plan.px([shoulder, h, knee, heel])
    strokes.line(at[0], at[1], _SEAT, 4)
    strokes.line(at[1], at[2], _SEAT, 2)
    strokes.line(at[2], at[3], _SEAT, 2)
    strokes.dot(at[1], 8, _PAPER)
    strokes.dot(at[1], 6.5, _SEAT)
    strokes.line(at[3] + (-7, 0), at[3] + (7, 0), _SEAT, 4)


def _wheel(strokes: Strokes, plan: _Plan, wheel: SteeringWheel) -> None:
    rim = plan.px([wheel.grip_point(angle) for angle in np.linspace(0, 2 * np.pi, 49)])
    for one, other in pairwise(rim):
        strokes.line(one, other, _WHEEL, 4)
    centre, axis = wheel.vehicle_from_wheel[:3, 3], wheel.vehicle_from_wheel[:3, 2]
    ends = plan.px([centre, centre + 0.2 * axis])
    strokes.line(ends[0], ends[1], _WHEEL, 2)
    strokes.dot(ends[0], 4, _WHEEL)


def _view(strokes: Strokes, plan: _Plan, camera: Camera, view: ViewAnchor) -> None:
    """The eye, its line of sight to the target, and the edges of the field of view in the plane of the picture."""
    no_jitter = np.random.Generator(np.random.Philox(0))
    vehicle_from_camera = place_camera(view.eye, view.target, rng=no_jitter)  # it may look straight down
    seen = camera.k
    width, height = camera.width / seen[0, 0] / 2, camera.height / seen[1, 1] / 2
    reach = float(np.linalg.norm(view.target - view.eye)) * 1.25
    side = ((-width, 0.0), (width, 0.0)) if plan.axes[2][2] > 0 else ((0.0, -height), (0.0, height))
    edges = [np.array((x, y, 1.0)) * reach / np.hypot(1.0, np.hypot(x, y)) for x, y in side]
    at = plan.px([view.eye, view.target, *apply(vehicle_from_camera, np.array(edges))])
    strokes.line(at[0], at[1], _VIEW, 2)
    for edge in at[2:]:
        strokes.line(at[0], edge, _VIEW, 1)
    strokes.dot(at[0], 6, _VIEW)


def _frame_pictures(frame: Mapping[str, NDArray[Any]] | None) -> Image | None:
    """Depth, and amplitude with the joints, side by side."""
    if frame is None:
        return None
    depth, amplitude = frame["depth"], frame["amplitude"]
    width = (_WIDTH - 20) // 2
    size = width, round(depth.shape[0] * width / depth.shape[1])
    images = depth_image(depth, *depth_range(depth)), amplitude_image(amplitude, float(np.quantile(amplitude, 0.995)))
    pictures = [resized(image, size).copy() for image in images]
    for uv, visibility in zip(frame["joints_2d"], frame["visibility"], strict=True):
        draw_skeleton(pictures[1], uv.astype(np.float32), visibility, size[0] / depth.shape[1])
    both = np.full((size[1], _WIDTH, 3), _PAPER, np.uint8)
    both[:, :width], both[:, _WIDTH - width :] = pictures
    return both


def _legend(sheet: Image, top: int) -> None:
    points = (
        (_SEAT, "seat: H-point, line of the back, heels"), (_WHEEL, "wheel and axis"), (_PEDAL, "pedals"),
        (_VIEW, "views, their field of view"), (_SIZE, "dimensions, m"), (_WRONG, "refused poses, sizes"),
    )  # fmt: skip
    surfaces = [(_TINTS[LABEL_ID[name]], name.replace("_", " ")) for name in ("seat", "trim", "glass", "floor", "steering_wheel")]
    for level, entries, ink in ((top, points, _INK), (top + 20, surfaces, _GREY)):
        left = _MARGIN
        for colour, words in entries:
            sheet[level - 11 : level + 1, left : left + 12] = colour
            text(sheet, words, (left + 18, level), ink, 14)
            left += 44 + round(7.2 * len(words))
