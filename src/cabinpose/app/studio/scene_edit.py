"""A scene's configuration as it is edited: checked changes, undo, files, and what the scene looks like. Without any UI."""

from __future__ import annotations

import copy
import dataclasses
import re
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from numpy.typing import ArrayLike, NDArray
from pydantic import ValidationError

from cabinpose.app.studio.scene_form import Path as Key
from cabinpose.app.studio.scene_preview import Posed, Shown, camera_of, words_of
from cabinpose.core import ConfigError, Matrix, apply, invert, nearest_rigid, read_yaml, write_whole
from cabinpose.scene.body import DOF_INDEX, DOFS, Person
from cabinpose.scene.cabin import SeatSetting, read_car_file
from cabinpose.synth import (
    CabinScene,
    Camera,
    SynthConfig,
    check_seed,
    exact_scene,
    is_car_file,
    without_defaults,
)
from cabinpose.synth.posture import hand_to

_SAME_STEP_S = 1.0  # changes of one key that follow so close are one step of undo, as a slider makes them
_MOST_STEPS = 200
_REMEMBERED = re.compile(r"^# seed (\d+), frame (\d+)$", re.MULTILINE)
_MESH_KEY = re.compile(r"^mesh:", re.MULTILINE)
_OF_SEATS = ("occupants", "child_seats", "objects")  # keys of a scene by seat, as a conflict is told
_SHORT = 80  # letters of a value that is told
_ROUND_M = 3  # digits of a dragged place: a millimetre
_EMPTY: dict[str, Any] = {"scene": {"kind": "cabin"}, "noise": {"kind": "physical"}}


@dataclass(frozen=True)
class State:
    """One step of the history: the configuration as plain data, and which frame of which seed is looked at."""

    data: dict[str, Any]
    seed: int = 0
    index: int = 0


class SceneEditor:
    """The scene that is open.

    `state.data` is what was typed, `config` the last of it that was valid, `errors` what is wrong by key.
    """

    def __init__(self, folder: Path, state: State | None = None) -> None:
        self.folder = folder
        self.state = state or State(copy.deepcopy(_EMPTY))
        self.config = SynthConfig()
        self.errors: dict[Key, str] = {}
        self._elsewhere = {path for _, path in _files(self.state.data)}  # named by files on the disk, not in the browser
        self.file = ""
        self.saved = self.state
        self._past: list[State] = []
        self._future: list[State] = []
        self._last: tuple[Key, float] = ((), 0.0)
        self._check(())

    # ------------------------------------------------------------------------------------------------------- changes

    def set(self, key: Key, value: Any) -> None:
        """Put a value in. What is wrong with it is told by `errors`."""
        data = copy.deepcopy(self.state.data)
        if key[:1] == ("scene",):
            _with_occupancy(data)
        at: Any = data
        for depth, part in enumerate(key[:-1]):
            if isinstance(at, dict) and at.get(part) is None:
                at[part] = copy.deepcopy(self._default(key[: depth + 1]))
            at = at[part]
        at[key[-1]] = value
        self._step(dataclasses.replace(self.state, data=data), key)

    def remove(self, key: Key) -> None:
        """Take an entry of a mapping or list out."""
        data = copy.deepcopy(self.state.data)
        at: Any = data
        for part in key[:-1]:
            at = at[part]
        del at[key[-1]]
        self._step(dataclasses.replace(self.state, data=data), key)

    def look_at(self, seed: int, index: int) -> None:
        """Look at another frame, or the frames of another seed. Raises ConfigError for what is no seed."""
        check_seed(seed)
        self._step(dataclasses.replace(self.state, seed=seed, index=max(index, 0)), ("frame",))

    def sample_again(self) -> None:
        """Go to the next frame: another draw of everything that is not given."""
        self._step(dataclasses.replace(self.state, index=self.state.index + 1), ())

    def accept(self, shown: Posed) -> None:
        """Keep the scene that is shown as it is: everybody's pose and the camera's. Raises ConfigError for rooms."""
        self._step(dataclasses.replace(self.state, data=without_defaults(exact_scene(shown.config, shown.scene))), ())

    def let_go(self, shown: Posed) -> list[str]:
        """What was given and would be no more once the scene that is shown is accepted, `key: value` each.

        Raises ConfigError for rooms.
        """
        before, after = shown.config.model_dump(mode="json"), exact_scene(shown.config, shown.scene).model_dump(mode="json")
        default = SynthConfig().model_dump(mode="json")
        return [f"{'.'.join(key)}: {_short(value)}" for key, value in _given(before, default) if _at(after, key) != value]

    def conflicts(self, posed: Posed | None, error: str) -> list[tuple[Key, str]]:
        """What is wrong, each with the key that it belongs to: with what was typed, and with the scene that comes of it.

        error: why nothing could be drawn, "" where something was.
        """
        found = list(self.errors.items())
        if error:
            found.append((("scene",), error))
        for verdict in posed.verdicts if posed is not None else ():
            slot = verdict.rejection.slot if verdict.rejection is not None else ""
            of_slot = [("scene", name, slot) for name in _OF_SEATS if slot in (self.state.data["scene"].get(name) or ())]
            found.append((of_slot[0] if of_slot else ("scene",) if slot else ("camera", "views"), words_of(verdict)))
        if isinstance(posed, Shown):
            found += [(("camera", "views"), doubt) for doubt in posed.doubts]
        return found

    @property
    def given(self) -> tuple[str, ...]:
        """The seats whose people have a whole pose."""
        scene = self.config.scene
        return tuple(s for s, o in scene.occupants.items() if o.pose is not None) if isinstance(scene, CabinScene) else ()

    def turn_joint(self, shown: Posed, slot: str, axis: str, angle: float) -> None:
        """Set a joint axis of somebody who has a whole pose, rad (grips: 0..1). What a hand holds follows it."""
        self._repose(shown, slot, ("scene", "occupants", slot, "pose", "angles_rad", axis), {axis: angle})

    def move_hand(self, shown: Posed, slot: str, side: str, place: Sequence[float]) -> float:
        """Bring a palm as near to `place` (vehicle frame, m) as arm and trunk allow; by how much it misses it, m."""
        person, q, root = _posed(shown, slot)
        solved = hand_to(person, q, root, "lr".index(side), np.asarray(place, np.float64))
        changed = {dof.name: float(value) for dof, value, old in zip(DOFS, solved, q, strict=True) if value != old}
        self._repose(shown, slot, (), changed)
        return float(np.linalg.norm(person.pose(solved, root).palms[side][:3, 3] - place))

    def set_seat(self, shown: Posed, slot: str, name: str, value: float) -> None:
        """Set a seat whose person has a whole pose; who sits in it goes along.

        name: fore_aft_m, height_m or torso_angle_rad. Of the angle only the pelvis, with all it carries, follows.
        """
        assert shown.scene.cabin is not None
        seat, pose = shown.scene.cabin.seats[slot], self.state.data["scene"]["occupants"][slot]["pose"]
        old = SeatSetting(*(float(pose[key]) for key in ("fore_aft_m", "height_m", "torso_angle_rad")))
        new = dataclasses.replace(old, **{name.replace("_rad", ""): value})
        seat.check(new)
        root = seat.vehicle_from_back(new) @ invert(seat.vehicle_from_back(old)) @ np.array(pose["vehicle_from_root"])
        rows = [row.tolist() for row in nearest_rigid(root)]
        self._repose(shown, slot, ("scene", "occupants", slot, "pose", name), {}, {name: value, "vehicle_from_root": rows})

    def _repose(
        self, shown: Posed, slot: str, key: Key, angles: Mapping[str, float], others: Mapping[str, Any] | None = None
    ) -> None:
        """Change somebody's whole pose; what the hands hold and the lap carries goes along."""
        data = copy.deepcopy(self.state.data)
        pose = data["scene"]["occupants"][slot]["pose"]
        things = data["scene"].get("things") or ()
        carried = [thing for thing in things if thing["where"] in ("lap", "hand") and thing["slot"] == slot]
        person = _posed(shown, slot)[0]
        before = _frames(person, pose)
        pose["angles_rad"] = {**pose["angles_rad"], **angles}
        pose |= others or {}
        after = _frames(person, pose)
        if (tongue := pose.get("tongue")) and tongue["how"] == "drawn":
            at, by = np.array(tongue["at_m"]), _nearest_hand(before, tongue["at_m"])
            pose["tongue"] = {**tongue, "at_m": apply(after[by] @ invert(before[by]), at).tolist()}
        for thing in carried:
            held, by = np.array(thing["vehicle_from_thing"]), "lap"
            if thing["where"] == "hand":
                by = _nearest_hand(before, held[:3, 3])
            thing["vehicle_from_thing"] = [row.tolist() for row in nearest_rigid(after[by] @ invert(before[by]) @ held)]
        self._step(dataclasses.replace(self.state, data=data), key)

    def move_camera(
        self, shown: Posed, *, position: Sequence[float] | None = None, target: Sequence[float] | None = None
    ) -> None:
        """Move the camera, or what it looks at (vehicle frame, m). It is the only view then, without jitter."""
        eye, looked_at, roll = camera_of(shown)
        view = {
            "position_m": [round(float(x), _ROUND_M) for x in (eye if position is None else position)],
            "look_at_m": [round(float(x), _ROUND_M) for x in (looked_at if target is None else target)],
            "roll_deg": roll,
        }
        data = copy.deepcopy(self.state.data)
        camera = data.setdefault("camera", {})
        camera |= {"views": {shown.scene.pov: view}, "jitter_m": 0.0, "jitter_deg": 0.0}
        self._step(dataclasses.replace(self.state, data=data), ("camera", "views"))

    def undo(self) -> bool:
        """One step back; False where there is none."""
        return self._go(self._past, self._future)

    def redo(self) -> bool:
        """One step forward again; False where there is none."""
        return self._go(self._future, self._past)

    def _go(self, source: list[State], target: list[State]) -> bool:
        if not source:
            return False
        target.append(self.state)
        self.state = source.pop()
        self._last = ((), 0.0)
        self._check(())
        return True

    def _step(self, state: State, key: Key) -> None:
        now = time.monotonic()
        if not key or key != self._last[0] or now - self._last[1] > _SAME_STEP_S:
            self._past = [*self._past, self.state][-_MOST_STEPS:]
        self._last, self._future, self.state = (key, now), [], state
        self._check(key)

    def _check(self, key: Key) -> None:
        """Check what was typed; where it is valid it comes into force."""
        try:
            config = SynthConfig.parse(self.state.data, base=self.folder)
            self.errors = dict(self._wrong_files())
            self.config = self.config if self.errors else config
        except ConfigError as error:
            cause = error.__cause__
            if isinstance(cause, ValidationError):
                self.errors = {_place(self.state.data, each["loc"]): _must(each["msg"]) for each in cause.errors()}
            else:
                self.errors = {key: error.in_one_line()}

    def _wrong_files(self) -> Iterator[tuple[Key, str]]:
        """What is wrong with the files that the configuration names: no browser leads out of the folder."""
        for key, name in _files(self.state.data):
            path = (self.folder / name).resolve()
            if name not in self._elsewhere and not path.is_relative_to(self.folder.resolve()):
                yield key, f"{name} is outside of {self.folder}"
            elif key[-1] == "cars":
                try:
                    read_car_file(path)
                except ConfigError as error:
                    yield key, error.in_one_line()

    def _default(self, key: Key) -> Any:
        """What a key that is left out stands for, of the configuration in force."""
        at: Any = self.config.model_dump(mode="json")
        for part in key:
            at = at.get(part) if isinstance(at, dict) else None
        return {} if at is None else at

    def starts(self, shown: Posed | None) -> dict[str, Any]:
        """What the fields' models start from where somebody chooses them, see `scene_form.form`."""
        own = Camera(sensor=self.config.camera.sensor_model)
        result: dict[str, Any] = {"Sensor": own.model_dump(mode="json")["sensor"]}
        if shown is not None:
            eye, target, roll = camera_of(shown)
            result["CameraPose"] = {"position_m": eye, "look_at_m": target, "roll_deg": roll}
            result["ExactCameraPose"] = {"vehicle_from_camera": shown.scene.world_from_camera.tolist()}
        return result

    def require_valid(self, words: str) -> None:
        """Raise ConfigError, which begins with some words, where the configuration in force is not what was typed."""
        if self.errors:
            raise ConfigError(f"{words}: {'; '.join(self.errors.values())}", hint="mend it, or undo")

    # --------------------------------------------------------------------------------------------------------- files

    def files(self) -> list[str]:
        """The YAML files of the folder, by name."""
        return sorted(path.name for path in self.folder.glob("*.y*ml") if path.is_file() and path.suffix in (".yaml", ".yml"))

    def car_files(self) -> list[str]:
        """Those of them that describe a car's mesh."""
        return [name for name in self.files() if _MESH_KEY.search((self.folder / name).read_text("utf-8", errors="replace"))]

    def save(self, name: str, *, overwrite: bool = False) -> Path:
        """Write the configuration to a file of the folder; `cabinpose synth --config` makes the same frames of it.

        Raises ConfigError where it is not valid, for a name that leads elsewhere, and without `overwrite` for a file that exists.
        """
        self.require_valid("what is wrong is not saved")
        path = self.place(name)
        text = f"# seed {self.state.seed}, frame {self.state.index}\n" + yaml.safe_dump(
            self.state.data, sort_keys=False, default_flow_style=None, width=130, allow_unicode=True
        )
        if path.exists() and not overwrite:
            raise ConfigError(f"{name} exists", hint="choose another name, or overwrite it")
        write_whole(path, text, kind=ConfigError)
        self.file, self.saved = path.name, self.state
        return path

    def has_comments(self, name: str) -> bool:
        """Whether there is a file of this name with comments, other than the studio's own: `save` writes none of them."""
        try:
            text = _REMEMBERED.sub("", self.place(name).read_text("utf-8"), count=1)
            marks = [mark.index for token in yaml.scan(text) for mark in (token.start_mark, token.end_mark)]
        except (OSError, UnicodeDecodeError, yaml.YAMLError, ConfigError):
            return False
        between = [0, *marks, len(text)]
        return any("#" in text[end:start] for end, start in zip(between[::2], between[1::2], strict=True))

    def load(self, name: str) -> None:
        """Read a configuration from a file of the folder. Raises ConfigError; then everything stays as it was."""
        state = read_state(self.place(name))
        SynthConfig.parse(state.data, base=self.folder)
        self._elsewhere |= {path for _, path in _files(state.data)}
        self._step(state, ())
        self.file, self.saved = name, state

    def place(self, name: str, suffixes: Sequence[str] = (".yaml", ".yml")) -> Path:
        """The path of a file of the folder. Raises ConfigError for a name that leads out of it, or has another suffix."""
        path = self.folder / name
        plain = name and name == Path(name).name and not name.startswith(".") and "\\" not in name and "\0" not in name
        if not plain or path.suffix not in suffixes or path.is_symlink():
            kind = f"a file name that ends in {' or '.join(suffixes)}" if any(suffixes) else "a plain name"
            raise ConfigError(f"'{name}' is no name in {self.folder}", hint=f"give {kind}")
        return path


def read_state(path: Path) -> State:
    """The state of a configuration file, with the seed and frame that the studio wrote into its first line."""
    data = read_yaml(path, hint="`cabinpose config init` writes a file to start from") or {}
    if not isinstance(data, dict):
        raise ConfigError(f"{path} is no configuration", hint="`cabinpose config init` writes a file to start from")
    data = {**copy.deepcopy(_EMPTY), **data}
    for name, kind in (("scene", "cabin"), ("noise", "physical")):
        if isinstance(data[name], dict):
            data[name] = {"kind": kind, **data[name]}
    _with_occupancy(data)
    remembered = _REMEMBERED.search(path.read_text(encoding="utf-8").partition("\n")[0])
    seed, index = map(int, remembered.groups()) if remembered else (0, 0)
    return State(data, seed, index)


def _given(data: Mapping[str, Any], default: Any, key: tuple[str, ...] = ()) -> Iterator[tuple[tuple[str, ...], Any]]:
    """The values of a configuration that are not as by default; of mappings that somebody fills, each entry."""
    for name, value in data.items():
        usual = default.get(name) if isinstance(default, dict) else None
        if value == usual or value is None:
            continue
        if isinstance(value, dict) and (not key or isinstance(usual, dict) or (*key, name)[:2] == ("scene", "occupants")):
            yield from _given(value, usual, (*key, name))
        else:
            yield (*key, name), value


def _at(data: Any, key: Sequence[str]) -> Any:
    for name in key:
        data = data.get(name) if isinstance(data, dict) else None
    return data


def _short(value: Any) -> str:
    words = yaml.safe_dump(value, default_flow_style=True, width=10_000).removesuffix("\n").removesuffix("\n...")
    return words if len(words) <= _SHORT else f"{words[: _SHORT - 2]} …"


def _must(words: str) -> str:
    """What pydantic says of a value, as short as a field is wide."""
    return f"must {words.removeprefix('Input should ')}" if words.startswith("Input should ") else words


def _posed(shown: Posed, slot: str) -> tuple[Person, NDArray[np.float64], Matrix]:
    who = next(person for person in shown.scene.people if person.slot == slot)
    return who.person, who.posed.q, who.posed.vehicle_from_root


def _frames(person: Person, pose: Mapping[str, Any]) -> dict[str, Matrix]:
    """Where a whole pose, as plain data, has the palms ("l", "r") and the pelvis ("lap"), in the vehicle's frame."""
    q = np.zeros(len(DOFS))
    for axis, angle in pose["angles_rad"].items():
        q[DOF_INDEX[axis]] = angle
    root = np.array(pose["vehicle_from_root"], np.float64)
    return {**person.pose(q, root).palms, "lap": root}


def _nearest_hand(frames: Mapping[str, Matrix], place: ArrayLike) -> str:
    """Of `_frames` the hand, "l" or "r", whose palm is nearest to a place (3,) m, vehicle frame."""
    return min("lr", key=lambda side: float(np.linalg.norm(frames[side][:3, 3] - np.asarray(place))))


def _files(data: Mapping[str, Any]) -> Iterator[tuple[Key, str]]:
    """The files that a configuration names, as they are written: cars and recordings, each with its key."""
    scene = data.get("scene")
    if not isinstance(scene, dict):
        return
    cars, seats = scene.get("cars"), scene.get("occupants")
    for car in cars if isinstance(cars, list) else ():
        if isinstance(car, str) and is_car_file(car):
            yield ("scene", "cars"), car
    owners: dict[Key, Any] = {("scene",): scene}
    owners |= {("scene", "occupants", slot): who for slot, who in (seats.items() if isinstance(seats, dict) else ())}
    for key, owner in owners.items():
        profile = owner.get("profile") if isinstance(owner, dict) else None
        if isinstance(profile, dict) and isinstance(profile.get("path"), str):
            yield (*key, "profile", "path"), profile["path"]


def _with_occupancy(data: dict[str, Any]) -> None:
    """Write out what `occupancy` stands for: it depends on whether others keys are there."""
    scene = data.setdefault("scene", {"kind": "cabin"})
    if isinstance(scene, dict) and scene.get("kind", "cabin") == "cabin" and "occupancy" not in scene:
        others = scene.get("occupants") or scene.get("factorial")
        scene["occupancy"] = {} if others else dict(CabinScene().occupancy)


def _place(data: Any, location: Sequence[str | int]) -> Key:
    """The key of a finding: pydantic's location without the names of the union's members."""
    key: list[str | int] = []
    at = data
    for number, part in enumerate(location):
        inside = (isinstance(at, dict) and part in at) or (isinstance(at, list) and isinstance(part, int) and part < len(at))
        if inside:
            key.append(part)
            at = at[part]
        elif number == len(location) - 1 and isinstance(at, dict) and isinstance(part, str) and part.islower():
            key.append(part)
    return tuple(key)
