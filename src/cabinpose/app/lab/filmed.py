"""The generator's sequences as a laboratory records them: its people in motion, their labels by suit, calibration and clocks.

The images are the generator's own, with all that its configuration asks of the sensor. What differs from a generated dataset is
where joints are said to be: a suit's chain from the head that an optical system sees, brought to the camera by a calibration.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydantic import BaseModel, ConfigDict, Field

from cabinpose.align import Board, Session, align_takes, calibrate
from cabinpose.app.lab.calibration import board_take, pendulum_take, write_board_take, write_pendulum_take
from cabinpose.app.lab.laboratory import write_session
from cabinpose.app.lab.motion import PersonMotion, Stage
from cabinpose.app.lab.optical import cap_of
from cabinpose.app.lab.plan import BOARD, PENDULUM, SESSION, head_take, pose_take
from cabinpose.app.lab.rig import VirtualRig
from cabinpose.app.lab.scene import message_of
from cabinpose.app.lab.suit import put_on
from cabinpose.app.lab.takes import Actor, optical_samples, suit_samples, write_head_take, write_pose_take
from cabinpose.app.lab.writing import samples, write_recording
from cabinpose.core import Matrix, SceneError, invert, make_folder
from cabinpose.scene.body import DOF_INDEX, LOWER, UPPER, PosedBody
from cabinpose.signals import Sample
from cabinpose.store import import_source
from cabinpose.store.recording import Participant, Take, whole_recording
from cabinpose.synth import CabinScene, Film, FrameMaker, Pose, SceneSampler, SequenceConfig, SynthConfig, Track
from cabinpose.synth.posture import draw_offset

F64 = NDArray[np.float64]
_TURNS_S, _STILL_S = 4.0, 0.4  # for which the head is turned before the first frame; and all is recorded before and after
_LEAD_S = _TURNS_S + 2 * _STILL_S  # of a take before its first frame
# Who wears a suit turns the head when a take begins, so that suit and optical system are synchronised whatever follows: about
# each axis by so much (deg) so often (Hz).
_TURNS = {"rotation": (28.0, 0.55), "flexion": (14.0, 0.8), "lateral": (10.0, 0.65)}
_OFFSET_M, _OFFSET_RAD = 0.015, 0.05  # of a pelvis in its seat while the head is calibrated, as `in_seat` has it
_LOST = 0.1  # of the frames that are asked for: so many more are recorded, since those without a pose are left out
_SAME_M = 1e-6  # by which a camera that stays where it is differs from take to take


class FilmedSubject(BaseModel):
    """Somebody who is recorded: scenes with nobody else in them, their seed, how many frames at least, the first activity."""

    model_config = ConfigDict(frozen=True)

    scenes: SynthConfig
    seed: int
    frames: int
    first: int = 0


class FilmedSession(BaseModel):
    """A session of the laboratory: who is recorded by which rig, and how it is calibrated."""

    model_config = ConfigDict(frozen=True)

    subjects: dict[str, FilmedSubject]
    rig: VirtualRig = VirtualRig()
    views: int = Field(24, ge=6)
    seed: int = 0

    def takes(self) -> list[FilmedTake]:
        """The takes of all subjects: sequences of one activity each, these one after the other, until there are enough frames."""
        result = []
        for code, who in self.subjects.items():
            sequence = _sequence(who.scenes)
            activities = sequence.activities or (None,)
            for number in range(math.ceil((1 + _LOST) * who.frames / sequence.frames)):
                k = (who.first + number) % len(activities)
                result.append(FilmedTake(code, activities[k], number // len(activities)))
        return result


class FilmedTake(NamedTuple):
    """A take: whose, of which activity (None: any), the number of its sequence."""

    subject: str
    activity: str | None
    number: int


def _sequence(config: SynthConfig) -> SequenceConfig:
    if not isinstance(config.scene, CabinScene) or config.scene.sequence is None:
        raise SceneError("the laboratory records sequences in cars", hint="give scene.sequence")
    return config.scene.sequence


@dataclass(frozen=True, eq=False)
class FilmedMotion(PersonMotion):
    """The motion of who sits in a place of a film, which begins `_LEAD_S` after the take."""

    film: Film
    slot: str

    def __post_init__(self) -> None:
        cast = self.film.cast
        for name, value in (
            ("person", cast.people[self.slot]),
            ("cabin", cast.cabin),
            ("settings", cast.settings),
            ("windows", ()),
        ):
            object.__setattr__(self, name, value)

    @property
    def duration_s(self) -> float:
        return (self.film.sequence.frames - 1) / self.film.sequence.rate_hz + _LEAD_S + _STILL_S

    def key_at(self, time_s: float) -> str:
        return self.film.tracks[self.slot].activity(time_s - _LEAD_S)

    def pose_at(self, time_s: ArrayLike) -> tuple[F64, Matrix, F64]:
        times = np.atleast_1d(np.asarray(time_s, np.float64))
        poses = [self._pose(float(time), state) for time, state in zip(times, self._track.states(times - _LEAD_S), strict=True)]
        return np.stack([p.q for p in poses]), np.stack([p.root for p in poses]), np.array([p.wheel_angle for p in poses])

    def body(self, time_s: float) -> PosedBody:
        time = time_s - _LEAD_S
        return self._track.body(self.person, self._pose(time_s, self._track.states(np.array([time]))[0]), time)

    @property
    def _track(self) -> Track:
        return self.film.tracks[self.slot]

    def _pose(self, time_s: float, state: F64) -> Pose:
        """The pose of a state of the film at a time of the take, with the head's turns before the film begins."""
        pose = self._track.pose_of(state)
        share = (time_s - _STILL_S) / _TURNS_S
        if not 0.0 < share < 1.0:
            return pose
        q = pose.q.copy()
        for axis, (degrees, hz) in _TURNS.items():
            turn = np.radians(degrees) * np.sin(np.pi * share) ** 2 * np.sin(2 * np.pi * hz * (time_s - _STILL_S))
            for joint in ("neck", "head"):
                q[DOF_INDEX[f"{joint}.{axis}"]] += 0.5 * turn
        return pose._replace(q=np.clip(q, LOWER, UPPER))


class _Films:
    """The films of a session's subjects, and the frames of each; one configuration after the other is at hand."""

    def __init__(self, session: FilmedSession) -> None:
        self._session = session
        self._maker: FrameMaker | None = None
        self._of: tuple[str, str | None] = ("", None)

    def film(self, take: FilmedTake) -> Film:
        """The film of a take, of one person who is as the rig's camera needs it."""
        film = self._of_take(take).sampler.plan_sequence(take.number)
        if len(film.tracks) != 1:
            raise SceneError(
                f"{len(film.tracks)} people are in a take of {take.subject}", hint="give one place in scene.occupancy"
            )
        return film

    def images(self, take: FilmedTake) -> Callable[[int], dict[str, np.ndarray]]:
        """What the camera delivers as frame k of a take."""
        first = take.number * _sequence(self._session.subjects[take.subject].scenes).frames
        return lambda k: self._of_take(take).make(first + k)[0]

    def _of_take(self, take: FilmedTake) -> FrameMaker:
        key = take.subject, take.activity
        if self._maker is None or self._of != key:
            who = self._session.subjects[take.subject]
            scenes = who.scenes
            if take.activity is not None:
                sequence = _sequence(scenes).model_copy(update={"activities": (take.activity,)})
                scenes = scenes.model_copy(update={"scene": scenes.scene.model_copy(update={"sequence": sequence})})
            like = None if self._maker is None else self._maker.sampler
            self._maker, self._of = FrameMaker(scenes, who.seed, SceneSampler(scenes, who.seed, like=like)), key
        return self._maker


def record_films(session: FilmedSession, recordings: Path, dataset: Path) -> tuple[str, ...]:
    """Record a session, calibrate its rig, and align its takes to a dataset; takes that are there are not recorded again.

    Parameters
    ----------
    session
        Who is recorded by which rig. The camera is where the first scene has it, and the world is the car's frame.
    recordings
        Folder of the recordings.
    dataset
        Folder of the dataset, which appears when it is whole.

    Returns
    -------
    tuple of str
        What speaks against the calibration of a take.

    Raises
    ------
    SceneError
        Where the camera moves from scene to scene, or somebody else is in one.
    AlignmentError
        Where the rig cannot be calibrated, or a take not be aligned.
    """
    make_folder(recordings)
    takes, films = session.takes(), _Films(session)
    rig = _rig_about(session, films.film(takes[0]))
    actors = {code: _dressed(films.film(next(t for t in takes if t.subject == code)), code, _rng(session, 1, n))
              for n, code in enumerate(session.subjects)}  # fmt: skip
    _calibration_takes(session, recordings, rig, list(actors.values()))
    paths = []
    for number, take in enumerate(takes):
        path = _file_of(recordings, number, take)
        if not path.exists():
            film = films.film(take)
            if np.abs(film.viewpoint.vehicle_from_camera - invert(rig.camera_from_world)).max() > _SAME_M:
                raise SceneError(
                    "the camera of a rig stays where it is", hint="give one car, one view and camera.jitter_m, jitter_deg: 0"
                )
            _write_take(path, rig, actors[take.subject], film, take, films.images(take), rng=_rng(session, 2, number))
        paths.append(path)
    calibrated = calibrate(Session.load(recordings / SESSION))
    aligned = align_takes(paths, calibrated.calibration)
    import_source(aligned.source, dataset)
    return tuple(aligned.warnings)


def recorded_share(session: FilmedSession, recordings: Path) -> float:
    """How many of the takes of a session are recorded, 0 to 1."""
    there = [_file_of(recordings, number, take).exists() for number, take in enumerate(session.takes())]
    return sum(there) / len(there)


def _file_of(recordings: Path, number: int, take: FilmedTake) -> Path:
    return recordings / f"take-{number:04d}-{take.subject}.mcap"


def _rng(session: FilmedSession, *what: int) -> np.random.Generator:
    return np.random.Generator(np.random.Philox(np.random.SeedSequence((session.seed, *what))))


def _rig_about(session: FilmedSession, film: Film) -> VirtualRig:
    """The rig with its camera where a film has it, which is that of the scenes."""
    sensor = next(iter(session.subjects.values())).scenes.camera.sensor_model
    tof = session.rig.tof.model_copy(update={"rate_hz": min(session.rig.tof.rate_hz, sensor.fps)})
    placed = {"sensor": sensor.name, "tof": tof.model_dump(), "extrinsics": invert(film.viewpoint.vehicle_from_camera)}
    return VirtualRig.model_validate(session.rig.model_dump() | placed)


def _dressed(film: Film, code: str, rng: np.random.Generator) -> Actor:
    """Who is in a film, in suit and cap, in the same seat."""
    (slot,), cast = film.tracks, film.cast
    offset = draw_offset(_OFFSET_M, _OFFSET_RAD, rng=rng)
    stage = Stage(cast.car, cast.cabin, cast.validator, cast.people[slot], slot, cast.settings, offset)
    return Actor(stage, put_on(rng=rng), cap_of(stage.person), code)


def _calibration_takes(session: FilmedSession, folder: Path, rig: VirtualRig, actors: Sequence[Actor]) -> None:
    """Board, pendulum, everybody's head and initial pose, and the file that names them; once."""
    if (folder / SESSION).exists():
        return
    for path in folder.glob("*.mcap"):  # of a session that was interrupted here
        path.unlink()
    board = Board()
    write_board_take(
        folder / BOARD, rig, board_take(rig, views=session.views, board=board, rng=_rng(session, 3)), rng=_rng(session, 4)
    )
    write_pendulum_take(folder / PENDULUM, rig, pendulum_take(rig, rng=_rng(session, 5)), rng=_rng(session, 6))
    for number, actor in enumerate(actors):
        write_head_take(folder / head_take(actor.code), rig, actor, rng=_rng(session, 7, number))
        write_pose_take(folder / pose_take(actor.code), rig, actor, rng=_rng(session, 8, number))
    write_session(folder, rig, board, actors, np.eye(4))


def _write_take(
    path: Path, rig: VirtualRig, actor: Actor, film: Film, take: FilmedTake, images: Callable[[int], dict[str, np.ndarray]], *,
    rng: np.random.Generator,
) -> None:  # fmt: skip
    motion, world = FilmedMotion(film, actor.stage.slot), np.eye(4)
    shown_s = _LEAD_S + np.arange(film.sequence.frames) / film.sequence.rate_hz
    shown_ns = rig.start_ns + np.rint(1e9 * shown_s).astype(np.int64)
    clock = rig.clock("tof")
    streams: dict[str, Iterator[Sample]] = {
        actor.suit: suit_samples(rig, actor, motion, world, motion.duration_s, {}, rng=rng),
        "optical": optical_samples(rig, [(actor, motion)], world, motion.duration_s, [{}], rng=rng),
        "tof": samples(clock, shown_ns, clock.arrivals(shown_ns, rng=rng), lambda k: (message_of(images(k)),)),
    }
    who = Participant(code=actor.code, seat=motion.slot)
    with whole_recording(path) as partial:
        write_recording(partial, rig, Take(action=take.activity or "any", car=film.cast.car, subjects=(who,)), streams)
