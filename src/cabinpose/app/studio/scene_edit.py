"""A scene's configuration as it is edited: checked changes, undo, files, and what the scene looks like. Without any UI."""

from __future__ import annotations

import copy
import dataclasses
import math
import re
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from numpy.typing import NDArray
from pydantic import ValidationError
from threadpoolctl import threadpool_limits

from cabinpose.app.studio.scene_form import Path as Key
from cabinpose.core import CabinposeError, ConfigError, Matrix, SceneError, invert, nearest_rigid, read_yaml, write_whole
from cabinpose.scene.body import DOF_INDEX, DOFS, Person
from cabinpose.scene.cabin import SeatSetting, read_car_file
from cabinpose.synth import (
    CabinScene,
    Camera,
    CameraPose,
    Frame,
    FrameMaker,
    Scene,
    SceneSampler,
    SynthConfig,
    Verdict,
    check_seed,
    exact_scene,
    frame_rng,
    is_car_file,
    judge_place,
    noise_rng,
    without_defaults,
)
from cabinpose.synth.posture import hand_to

_SAME_STEP_S = 1.0  # changes of one key that follow so close are one step of undo, as a slider makes them
_MOST_STEPS = 200
_REMEMBERED = re.compile(r"^# seed (\d+), frame (\d+)$", re.MULTILINE)
_MESH_KEY = re.compile(r"^mesh:", re.MULTILINE)
_ROUND_M = 3  # digits of a dragged place: a millimetre
_EMPTY: dict[str, Any] = {"scene": {"kind": "cabin"}, "noise": {"kind": "physical"}}


@dataclass(frozen=True)
class State:
    """One step of the history: the configuration as plain data, and which frame of which seed is looked at."""

    data: dict[str, Any]
    seed: int = 0
    index: int = 0


@dataclass(frozen=True)
class Posed:
    """A scene as it was posed, before its camera has looked at it.

    number: tells it from every other · verdicts: why it does not hold, () where it does · error: why none was found; then it is
    the scene before · depth_m: what the middle of the image shows, as far as it is known · seconds: what that took, by stage.
    """

    number: int
    config: SynthConfig
    scene: Scene
    verdicts: tuple[Verdict, ...] = ()
    error: str = ""
    depth_m: float = 1.0
    seconds: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True, kw_only=True)
class Shown(Posed):
    """A scene as it was drawn, with the frame that its camera delivers. doubts: what speaks against the camera's place."""

    frame: Frame
    doubts: tuple[str, ...] = ()


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
        carried = [thing for thing in data["scene"].get("things") or () if thing["slot"] == slot and thing["where"] != "seat"]
        person = _posed(shown, slot)[0]
        before = _frames(person, pose)
        pose["angles_rad"] = {**pose["angles_rad"], **angles}
        pose |= others or {}
        after = _frames(person, pose)
        for thing in carried:
            held, by = np.array(thing["vehicle_from_thing"]), "lap"
            if thing["where"] == "hand":
                by = min("lr", key=lambda side: float(np.linalg.norm(before[side][:3, 3] - held[:3, 3])))
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
        if self.errors:
            raise ConfigError("what is wrong is not saved: " + "; ".join(self.errors.values()), hint="mend it, or undo")
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


class Preview:
    """Draws scenes, with the people and cars of the scene before. Belongs to one thread at a time."""

    def __init__(self) -> None:
        self._sampler: SceneSampler | None = None
        self._written: dict[Path, int] = {}
        self.shown: Shown | None = None
        self._number, self._noise = 0, (0, 0)

    def pose(self, config: SynthConfig, seed: int, index: int) -> Posed:
        """Where everything is in a scene, before its camera looks at it. Raises CabinposeError where there is nothing to show."""
        started = time.perf_counter()
        with threadpool_limits(1):  # as in `synth`: the bytes may depend on the libraries' number of threads
            written = {car: car.stat().st_mtime_ns for car in own_cars(config) if car.exists()}  # one that changed is loaded anew
            sampler = SceneSampler(config, seed, like=self._sampler if self._written == written else None)
            self._written = written
            self._sampler, self._noise = sampler, (seed, index)
            scene, verdicts, error = self._scene(sampler, config, seed, index)
        self._number += 1
        before = self.shown
        same = before is not None and np.array_equal(before.scene.world_from_camera, scene.world_from_camera)
        depth = before.depth_m if before is not None and same else 1.0
        return Posed(self._number, config, scene, verdicts, error, depth, {"pose": time.perf_counter() - started})

    def see(self, posed: Posed) -> Shown:
        """The scene that was posed last, with what its camera delivers."""
        started = time.perf_counter()
        assert self._sampler is not None
        with threadpool_limits(1):
            maker = FrameMaker(posed.config, self._noise[0], self._sampler, pictures=False)
            frame = maker.see(posed.scene, rng=noise_rng(*self._noise))
            doubts = _place_doubts(posed.config, posed.scene)
        depth = frame["depth_clean"]
        middle = float(depth[depth.shape[0] // 2, depth.shape[1] // 2])
        told = {each.name: getattr(posed, each.name) for each in dataclasses.fields(posed)}
        told["depth_m"] = middle if 0.3 < middle < 3.0 else 1.0
        told["seconds"] = {**posed.seconds, "see": time.perf_counter() - started}
        self.shown = Shown(**told, frame=frame, doubts=doubts)
        return self.shown

    def draw(self, config: SynthConfig, seed: int, index: int) -> Shown:
        """What a configuration looks like, at once. Raises CabinposeError where there is nothing to show."""
        return self.see(self.pose(config, seed, index))

    def _scene(self, sampler: SceneSampler, config: SynthConfig, seed: int, index: int) -> tuple[Scene, tuple[Verdict, ...], str]:
        scene = config.scene
        occupants = scene.occupants.values() if isinstance(scene, CabinScene) else ()
        given = any(occupant.pose is not None for occupant in occupants)
        if given and all(o.pose for o in occupants) and isinstance(scene, CabinScene) and not any(scene.occupancy.values()):
            return *sampler.as_given(index, rng=frame_rng(seed, index)), ""
        try:
            return sampler.sample(index, rng=frame_rng(seed, index)), (), ""
        except CabinposeError as error:
            if given:
                return *sampler.as_given(index, rng=frame_rng(seed, index)), error.in_one_line()
            if self.shown is None or not isinstance(error, SceneError):
                raise
            return self.shown.scene, (), error.in_one_line()


def _place_doubts(config: SynthConfig, scene: Scene) -> tuple[str, ...]:
    """What speaks against the camera's place in a car."""
    if scene.cabin is None:
        return ()
    camera = config.camera.sensor_model
    return judge_place(scene.cabin, scene.pov, scene.world_from_camera, camera, config.noise, scene.settings).doubts


def _must(words: str) -> str:
    """What pydantic says of a value, as short as a field is wide."""
    return f"must {words.removeprefix('Input should ')}" if words.startswith("Input should ") else words


def own_cars(config: SynthConfig) -> list[Path]:
    """The YAMLs of the user's own cars."""
    cars = config.scene.cars if isinstance(config.scene, CabinScene) else ()
    return [Path(car) for car in cars if isinstance(car, str) and is_car_file(car)]


def camera_of(shown: Posed) -> tuple[list[float], list[float], float]:
    """Where the camera is, a point before it that it looks at (m), and its roll (deg)."""
    own = shown.config.camera.views.get(shown.scene.pov)
    if isinstance(own, CameraPose):
        return list(own.position_m), list(own.look_at_m), own.roll_deg
    camera = shown.scene.world_from_camera
    eye, forward, right = camera[:3, 3], camera[:3, 2], camera[:3, 0]
    target = eye + forward * shown.depth_m
    level = np.cross(forward, (0.0, 0.0, 1.0))
    roll = 0.0
    if np.linalg.norm(level) > 1e-3:
        level /= np.linalg.norm(level)
        roll = math.degrees(math.atan2(float(np.cross(level, right) @ forward), float(level @ right)))
    return eye.round(_ROUND_M).tolist(), target.round(_ROUND_M).tolist(), round(roll, 2) + 0.0


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
