"""The people of a scene whose poses are given: seats, hands and joint axes by sliders and numbers, which the keyboard moves."""

from __future__ import annotations

import math
from collections.abc import Awaitable, Callable
from dataclasses import dataclass
from typing import Any

from nicegui import ui

from cabinpose.app.studio.scene_form import axis_words
from cabinpose.app.studio.scene_session import SceneRoom
from cabinpose.scene.body import DOFS
from cabinpose.synth import CabinScene, dof_scale, limits_deg

SLIDER_KEYS = (("Shift ← →, Home, End", "on a slider: ten steps, to its ends"),)
_SEAT = (("fore_aft_m", "fore_aft_m"), ("height_m", "height_m"), ("torso_angle_rad", "torso_angle"))
_STEPS = {"ArrowLeft": -10, "ArrowDown": -10, "ArrowRight": 10, "ArrowUp": 10}
_SIDES = (("l", "left hand"), ("r", "right hand"))
# Quasar moves a slider by a step for each arrow; what it does not know is taken before it.
_TAKE = """(event) => {
  const slider = event.target.closest("[data-axis]"), arrow = event.key.startsWith("Arrow");
  if (!slider || event.ctrlKey || event.metaKey || !(["Home", "End"].includes(event.key) || (arrow && event.shiftKey))) return;
  event.preventDefault(); event.stopPropagation();
  emit([slider.dataset.axis, event.key]);
}"""


@dataclass
class _Slider:
    """One slider. told: the value that it was set to, which is no change of a hand."""

    slider: ui.slider
    number: ui.label
    ends: tuple[float, float]
    step: float
    unit: str
    told: float

    def show(self, value: float) -> None:
        """Set it without a change of the scene."""
        self.told = value
        self.number.text = self.words(value)
        self.slider.value = value

    def words(self, value: float) -> str:
        """The value with its unit."""
        return f"{value:.{2 if self.step < 0.1 else 1}f} {self.unit}".strip()


class ScenePeople:
    """The panel of one browser. `do` makes a change and has it drawn."""

    def __init__(self, room: SceneRoom, do: Callable[[Callable[[], Any]], Awaitable[None]]) -> None:
        self._room, self._editor, self._do = room, room.editor, do
        self._sliders: dict[tuple[str, str], _Slider] = {}
        self._hands: dict[tuple[str, str], list[ui.number]] = {}
        self._given: tuple[tuple[str, str | None], ...] | None = None
        self._quiet = False
        self._body = ui.column().classes("w-full").style("gap: 2px")
        self._body.on("keydown.capture", self._key, js_handler=_TAKE)

    def show(self) -> None:
        """Show what is edited now: in place where the people are the same, with their groups open as they are."""
        scene = self._editor.config.scene
        seats = self._editor.given if self._room.posed is not None and isinstance(scene, CabinScene) else ()
        given = tuple((slot, scene.occupants[slot].subject) for slot in seats) if isinstance(scene, CabinScene) else ()
        if given != self._given:
            self._given = given
            self._build(given)
        for (slot, axis), slider in self._sliders.items():
            value = self._value(slot, axis)
            if value is not None and abs(value - slider.told) > 1e-9:
                slider.show(value)
        self._show_hands()

    def _build(self, given: tuple[tuple[str, str | None], ...]) -> None:
        self._body.clear()
        self._sliders, self._hands = {}, {}
        with self._body:
            if not given:
                ui.label("Accept a scene: then every joint axis of its people is a slider here, and their hands can be dragged.")
            for slot, subject in given:
                with ui.expansion(f"{slot}: {subject}").props("dense").classes("w-full studio-group") as group:
                    inside = ui.column().classes("w-full").style("gap: 0")
                group.on_value_change(lambda _, slot=slot, inside=inside: self._fill(slot, inside))

    def _fill(self, slot: str, inside: ui.column) -> None:
        posed = self._room.posed
        if inside.default_slot.children or posed is None or posed.scene.cabin is None or slot not in posed.scene.settings:
            return
        low, high = posed.scene.cabin.seats[slot].ranges
        with inside:
            for side, words in _SIDES:
                self._hand(slot, side, words)
            for key, name in _SEAT:
                scale = math.radians(1.0) if key.endswith("_rad") else 1.0
                words, unit = ("torso angle", "°") if key.endswith("_rad") else (f"seat {name.removesuffix('_m')}", "m")
                ends = float(getattr(low, name)) / scale, float(getattr(high, name)) / scale
                self._slider(slot, key, words.replace("_", "-"), ends, unit)
            for dof in DOFS:
                self._slider(
                    slot, dof.name, axis_words(dof.name), limits_deg(dof.name), "" if dof_scale(dof.name) == 1.0 else "°"
                )
        self._show_hands()

    def _value(self, slot: str, axis: str) -> float | None:
        """What the configuration in force says of a seat or joint axis, in the slider's unit."""
        scene = self._editor.config.scene
        pose = scene.occupants[slot].pose if isinstance(scene, CabinScene) and slot in scene.occupants else None
        if pose is None:
            return None
        if axis in dict(_SEAT):
            value = float(getattr(pose, axis))
            return math.degrees(value) if axis.endswith("_rad") else value
        return pose.angles_rad.get(axis, 0.0) / dof_scale(axis)

    def _slider(self, slot: str, axis: str, words: str, ends: tuple[float, float], unit: str) -> None:
        low, high = ends
        value = self._value(slot, axis) or 0.0
        with ui.row().classes("no-wrap items-center w-full").style("gap: 6px; font-size: 12px; height: 26px"):
            name = ui.label(words).style("width: 148px; white-space: nowrap; overflow: hidden; text-overflow: ellipsis")
            name.tooltip(f"{words} ({axis}): {low:.4g} to {high:.4g}{unit}")
            number = ui.label().style("width: 52px; text-align: right; font-variant-numeric: tabular-nums; white-space: nowrap")
            step = 0.01 if high - low <= 2.0 else 0.5
            slider = ui.slider(min=low, max=high, step=step, value=value).style("flex: 1")
            slider.props(f"dense data-axis='{slot} {axis}' aria-label='{words} of {slot}'").mark(axis)
        row = _Slider(slider, number, ends, step, unit, value)
        row.show(value)
        self._sliders[slot, axis] = row

        async def moved(event: Any) -> None:
            chosen = min(max(float(event.value), low), high)
            if abs(chosen - row.told) < 1e-9:  # the browser tells a place twice, and undo tells it here
                return
            row.told, number.text = chosen, row.words(chosen)
            await self._do(lambda: self._put(slot, axis, chosen))

        slider.on_value_change(moved)

    def _put(self, slot: str, axis: str, value: float) -> None:
        posed = self._room.posed
        if posed is not None and axis in dict(_SEAT):
            self._editor.set_seat(posed, slot, axis, math.radians(value) if axis.endswith("_rad") else value)
        elif posed is not None:
            self._editor.turn_joint(posed, slot, axis, value * dof_scale(axis))

    def _key(self, event: Any) -> None:
        """Ten steps, or to an end."""
        place, key = map(str, event.args)
        slot, _, axis = place.partition(" ")
        row = self._sliders.get((slot, axis))
        if row is not None:
            low, high = row.ends
            now = float(row.slider.value)
            row.slider.value = {"Home": low, "End": high}.get(key, min(max(now + _STEPS.get(key, 0) * row.step, low), high))

    # ------------------------------------------------------------------------------------------------------------- hands

    def _hand(self, slot: str, side: str, words: str) -> None:
        """Where a palm is, as numbers: what its handle does in the 3D view."""
        numbers: list[ui.number] = []

        async def moved(_: Any) -> None:
            values = [number.value for number in numbers]
            if not self._quiet and None not in values:
                await self._do(lambda: self.move_hand(slot, side, [float(value) for value in values]))

        with ui.row().classes("no-wrap items-center w-full studio-hand").style("gap: 4px; font-size: 12px"):
            ui.label(words).style("width: 64px").tooltip("the palm in the vehicle's frame: x forward, y left, z up")
            for axis in "xyz":
                number = ui.number(
                    f"{axis} · m", step=0.01, format="%.3f", on_change=lambda event: None if self._quiet else moved(event)
                )
                number.props(f"dense outlined debounce=300 aria-label='{words} of {slot}, {axis} in metres'")
                numbers.append(number.style("flex: 1; min-width: 0"))
        self._hands[slot, side] = numbers

    def move_hand(self, slot: str, side: str, place: list[float]) -> None:
        """Bring a hand to a place (vehicle frame, m), or as near as arm and trunk allow, which is told."""
        posed = self._room.posed
        if posed is None:
            return
        missed = self._editor.move_hand(posed, slot, side, place)
        if missed > 0.01:
            ui.notify(f"the hand ends {100 * missed:.0f} cm before that place", position="top")

    def _show_hands(self) -> None:
        posed = self._room.posed
        people = {person.slot: person for person in posed.scene.people} if posed is not None else {}
        self._quiet = True
        for (slot, side), numbers in self._hands.items():
            if slot in people:
                for number, value in zip(numbers, people[slot].posed.palms[side][:3, 3].tolist(), strict=True):
                    number.value = round(value, 3)
        self._quiet = False
