"""From scenes to parts of a dataset: place, render, simulate the sensor, look which joints are seen, write."""

from __future__ import annotations

import ctypes
import sys
import threading
import time
from collections import Counter, defaultdict, deque
from collections.abc import Callable, Generator, Iterable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import closing, contextmanager
from dataclasses import dataclass, field
from functools import partial
from itertools import chain, islice
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, NamedTuple

import numpy as np
from threadpoolctl import threadpool_limits

from cabinpose.core import CABINPOSE, apply, invert
from cabinpose.scene.body import joints_in_body
from cabinpose.scene.sensor import GeometryBuffers, PhysicalNoise, median_of_valid, sample_times, simulate
from cabinpose.scene.things import CHILD_SEAT_LABELS
from cabinpose.store import EncodedFrame, Manifest, PartPlan, PartWriter, encode_frame, joints_variable
from cabinpose.synth.config import CabinScene, SynthConfig
from cabinpose.synth.gaze import gaze_labels
from cabinpose.synth.plan import brings_things, person_slots
from cabinpose.synth.render import Rasteriser
from cabinpose.synth.sample import SceneSampler
from cabinpose.synth.scene import ImpossibleSceneError, Scene
from cabinpose.synth.streams import frame_rng, noise_rng
from cabinpose.synth.style.settings import LEFT
from cabinpose.synth.validate import Rejection, by_cause

if TYPE_CHECKING:
    from cabinpose.synth.pictures.maker import PictureMaker
    from cabinpose.synth.style.stage import FrameStyler

Frame = dict[str, Any]
Content = Literal["cars", "people", "seats", "styles", "views"]
RESTRAINTS = ("belt", "child", "child_seat", "attachment")
_AHEAD = 3  # frames that a thread may be ahead of what is written
# Interval (s) after which the interpreter lets another thread run. Kernels release the lock; at Python's default of 5 ms a thread
# that returns from one would wait for half of a frame's 10 ms of work.
_SWITCH_S = 0.0005


class FrameMaker:
    """Makes any frame of a dataset from its number, in one thread."""

    def __init__(self, config: SynthConfig, seed: int, sampler: SceneSampler | None = None, *, pictures: bool = True) -> None:
        """sampler: of the same configuration and seed, to share people and cars with; its own by default · pictures: False
        leaves out those that the configuration asks for, and styled depth, which nobody looks at.
        """
        self.seconds: defaultdict[str, float] = defaultdict(float)
        self._config = config
        self._seed = seed
        self._sampler = sampler or SceneSampler(config, seed)
        self._sensor = config.camera.sensor_model
        self._rasteriser = Rasteriser(self._sensor.camera, supersample=config.camera.supersample)
        self._sequence = config.scene.sequence if isinstance(config.scene, CabinScene) else None
        moving = self._sequence is not None and self._sequence.exposure_motion
        physical = config.noise if isinstance(config.noise, PhysicalNoise) else None
        self._sample_times = sample_times(self._sensor, physical) if moving and physical else np.zeros(0)
        self._delivered: dict[int, np.ndarray] = {}  # depths of the frames before, where they are filtered over time
        self._pictures: PictureMaker | None = None
        if pictures and config.images is not None:
            from cabinpose.synth.pictures.maker import PictureMaker  # noqa: PLC0415 - loaded where there are pictures

            self._pictures = PictureMaker(config.images, self._sensor, seed)
        self._styler: FrameStyler | None = None
        if pictures and config.style is not None:
            from cabinpose.synth.style.stage import FrameStyler  # noqa: PLC0415 - loaded where depth is styled

            self._styler = FrameStyler(config.style)
        self._slots = person_slots(config)
        self._tells_restraints = isinstance(config.scene, CabinScene) and config.scene.tells_restraints
        self._instances = np.arange(1, len(self._slots) + 1, dtype=np.uint8)

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        """Counts this thread's CPU time spent inside under `name`."""
        start = time.thread_time()
        yield
        self.seconds[name] += time.thread_time() - start

    def make(self, index: int) -> tuple[Frame, Scene]:
        """Frame `index`: every variable of the dataset standard, and the scene it shows."""
        frame, scene = self._make_alone(index)
        if self._sensor.temporal_median > 1:
            self._delivered[index] = frame["depth"]
            frame["depth"] = self._over_time(index)
        return frame, scene

    def _make_alone(self, index: int) -> tuple[Frame, Scene]:
        """A frame as it is before a filter over time."""
        rng = frame_rng(self._seed, index)
        with self.stage("sample_and_validate"):
            scene = self._sampler.sample(index, rng=rng)
            exposures = self._sampler.exposed(index, scene, self._sample_times) if self._sample_times.size else []
        return self.see(scene, rng=noise_rng(self._seed, index), exposures=exposures), scene

    def _over_time(self, index: int) -> np.ndarray:
        """The median depth (H, W) m of a frame and those before it in its sequence; what other threads made is made again."""
        assert self._sequence is not None
        first = max(index - self._sensor.temporal_median + 1, index // self._sequence.frames * self._sequence.frames)
        self._delivered = {
            i: self._delivered[i] if i in self._delivered else self._make_alone(i)[0]["depth"] for i in range(first, index + 1)
        }
        return median_of_valid(np.stack(list(self._delivered.values())))

    def see(self, scene: Scene, *, rng: np.random.Generator, exposures: Sequence[Scene] = ()) -> Frame:
        """A scene as the camera delivers it: every variable of the dataset standard.

        exposures: what there is to see at each of the sensor's samples, where people move in between.
        """
        with self.stage("render"):
            views = {id(moment): self._view(moment) for moment in {id(m): m for m in exposures if m is not scene}.values()}
        with self.stage("assemble"):
            surface = scene.surface()
        camera_from_world = invert(scene.world_from_camera)
        with self.stage("render"):
            joints = self._joints(scene, camera_from_world)
            rendered = self._rasteriser.render(
                surface, camera_from_world, closed=scene.closed, joints=joints["joints_3d"], instances=self._instances
            )
        with self.stage("sensor"):
            taken = [views.get(id(moment), rendered.buffers) for moment in exposures]
            seen = simulate(rendered.buffers, self._sensor, self._config.noise, rng=rng, exposures=taken)
        pictures: Frame = {}
        if self._pictures is not None:
            with self.stage("pictures"):
                pictures = self._pictures.take(scene, surface, rng=rng)
        styled: Frame = {}
        if self._styler is not None:
            with self.stage("style"):
                styled = self._styler.take(seen.depth_m, rendered.depth_clean, rendered.labels, rendered.instance, rng=rng)
        camera = self._sensor.camera
        return {
            **pictures,
            **styled,
            "depth": seen.depth_m,
            "depth_clean": rendered.depth_clean,
            "amplitude": seen.amplitude,
            "confidence": seen.confidence,
            "labels": rendered.labels,
            "instance": rendered.instance,
            **joints,
            "visibility": rendered.visibility,
            "camera_k": camera.k,
            "camera_dist": np.array(camera.dist),
            "vehicle_from_camera": scene.world_from_camera,
            "sync_ns": scene.sync_ns,
            "sequence": scene.sequence,
            "seed": self._seed,
            "subject": self._per_slot(scene, "subject"),
            "action": self._per_slot(scene, "action"),
            "car": scene.place,
            "pov": scene.pov,
            **({"things": self._things(scene)} if brings_things(self._config) else {}),
            **({"noise": _micrometres(seen.noise_m)} if self._config.output.noise else {}),
            **(self._restraints(scene) if self._tells_restraints else {}),
            **(gaze_labels(scene, self._slots) if self._config.output.gaze else {}),
        }

    def _view(self, scene: Scene) -> GeometryBuffers:
        """What the camera sees of a scene."""
        rendered = self._rasteriser.render(scene.surface(), invert(scene.world_from_camera), closed=scene.closed)
        return rendered.buffers.copy()

    def _things(self, scene: Scene) -> list[str]:
        """What is in each place, kinds divided by commas."""
        kinds = [(thing.slot, thing.thing.kind.removesuffix("_in_use")) for thing in scene.things]
        return [",".join(sorted(kind for at, kind in kinds if at == slot)) for slot in self._slots]

    def _restraints(self, scene: Scene) -> Frame:
        """What holds people and child seats, and who is a child: `RESTRAINTS`."""
        seats = {thing.slot: thing for thing in scene.things if thing.at == "seat" and thing.thing.label in CHILD_SEAT_LABELS}
        people = {person.slot: person for person in scene.people}
        states = {slot: "taken" if slot in people else "empty" for slot in seats}
        return {
            "belt": self._per_slot(scene, "belt"),
            "child": np.array([slot in people and people[slot].child for slot in self._slots], np.uint8),
            "child_seat": [states.get(slot, "") for slot in self._slots],
            "attachment": [(seats[slot].attachment or "") if slot in seats else "" for slot in self._slots],
        }

    def _per_slot(self, scene: Scene, attribute: str) -> list[str]:
        names = {person.slot: getattr(person, attribute) for person in scene.people}
        return [names.get(slot, "") for slot in self._slots]

    def _joints(self, scene: Scene, camera_from_world: np.ndarray) -> Frame:
        """The joints (P, J, 3) m of every set that is written, and joints_2d (P, 20, 2) px; NaN for empty slots."""
        result: Frame = {}
        for skeleton in (CABINPOSE, *self._config.skeletons):
            joints = result[joints_variable(skeleton.name)] = np.full((len(self._slots), len(skeleton.joints), 3), np.nan)
            for person in scene.people:
                joints[self._slots.index(person.slot)] = apply(camera_from_world, joints_in_body(skeleton, person.posed))
        return result | {"joints_2d": self._sensor.camera.project(result["joints_3d"])}


def _micrometres(noise_m: np.ndarray) -> np.ndarray:
    """Sigma (H, W) m, NaN or infinite where there is none, as 16 bits of micrometres; 0 is unknown."""
    return np.minimum(np.nan_to_num(np.rint(noise_m * 1e6), posinf=0.0), 65535.0).astype(np.uint16)


@dataclass
class FrameReport:
    """What making some frames took. frames: written, without those skipped · proposals, rejections: poses of people ·
    stage_seconds: CPU time of the threads that made them · content: frames by car, view and style, people by name and seat ·
    label_shift: the farthest that styling moved an edge (px) and the mean depth of a part (mm), of styled frames.
    """

    frames: int = 0
    proposals: int = 0
    rejections: Counter[Rejection] = field(default_factory=Counter)
    stage_seconds: Counter[str] = field(default_factory=Counter)
    content: Counter[tuple[Content, str]] = field(default_factory=Counter)
    label_shift: dict[str, float] = field(default_factory=dict)

    def add(self, other: FrameReport) -> None:
        """Count another report in."""
        self.frames += other.frames
        self.proposals += other.proposals
        self.rejections.update(other.rejections)
        self.stage_seconds.update(other.stage_seconds)
        self.content.update(other.content)
        for name, most in other.label_shift.items():
            self.label_shift[name] = max(most, self.label_shift.get(name, 0.0))


class _Made(NamedTuple):
    frame: EncodedFrame | None  # None: of a combination that no scene allows
    report: FrameReport


def make_frames(
    folder: Path,
    plans: Sequence[PartPlan],
    config: SynthConfig,
    manifest: Manifest,
    *,
    threads: int,
    sampler: SceneSampler | None = None,
) -> Iterator[FrameReport]:
    """Make parts one after the other; each is written whole or not at all.

    Several threads make frames and share people and cars; the calling thread writes the frames in order.

    Parameters
    ----------
    folder
        Of the dataset.
    plans
        The parts.
    config, manifest
        What the frames show, and what `dataset.yaml` says.
    threads
        How many make frames.
    sampler
        A sampler of the same configuration and seed whose people and cars are used; its own by default.

    Yields
    ------
    FrameReport
        After every frame.
    """
    may_skip = any(profile.may_skip for profile in config.profiles)
    shared = sampler or SceneSampler(config, manifest.seed)
    local = threading.local()  # a rasteriser's memory belongs to one thread

    def make(index: int) -> _Made:
        if not hasattr(local, "maker"):
            local.maker = FrameMaker(config, manifest.seed, shared)
        maker: FrameMaker = local.maker
        maker.seconds.clear()
        try:
            frame, scene = maker.make(index)
        except ImpossibleSceneError as error:
            if not may_skip:
                raise
            return _Made(None, FrameReport(0, error.proposals, error.rejections, Counter(maker.seconds)))
        with maker.stage("write"):
            encoded = encode_frame(frame, index, manifest)
        content, shift = _content(scene), {}
        if "style" in frame:
            content["styles", frame["style"]] = 1
            shift = {name: frame[f"style_{name}"] for name in ("edge_px", "part_mm")} if frame["style"] != LEFT else {}
        return _Made(encoded, FrameReport(1, scene.proposals, Counter(scene.rejections), Counter(maker.seconds), content, shift))

    # One thread each: the libraries' results, and with them the bytes on disk, may depend on their number of threads.
    indices, before = chain.from_iterable(map(_frames, plans)), _sequences_ahead(shared, config, plans, threads)
    with threadpool_limits(1), closing(_in_order(make, indices, threads, before)) as results:
        for plan in plans:
            with PartWriter(folder, plan, manifest) as part:
                total = FrameReport()
                for made in islice(results, plan.frames):
                    if made.frame is None:
                        part.skip()
                    else:
                        part.append_encoded(made.frame)
                    total.add(made.report)
                    if part.missing:
                        yield made.report
                part.attrs["proposals"] = total.proposals
                part.attrs["rejections"] = by_cause(total.rejections)
            _give_memory_back()
            yield made.report  # of the last frame, once its part is whole


def _content(scene: Scene) -> Counter[tuple[Content, str]]:
    result: Counter[tuple[Content, str]] = Counter({("cars", scene.place): 1, ("views", scene.pov): 1})
    for person in scene.people:
        result["people", person.subject] += 1
        result["seats", person.slot] += 1
    return result


def _give_memory_back() -> None:
    """Hands freed memory back to the system: what the building of cars leaves behind in each thread's heap is a third of all."""
    trim = getattr(ctypes.CDLL(None), "malloc_trim", None)  # of glibc
    if trim is not None:
        trim(0)


def _frames(plan: PartPlan) -> range:
    return range(plan.first, plan.first + plan.frames)


def _sequences_ahead(
    sampler: SceneSampler, config: SynthConfig, plans: Sequence[PartPlan], threads: int
) -> Callable[[int], Iterator[Callable[[], None]]]:
    """What is to be done before a frame so that no thread waits: as many sequences are planned as there are threads."""
    sequence = config.scene.sequence if isinstance(config.scene, CabinScene) else None
    planned = -1

    def before(index: int) -> Iterator[Callable[[], None]]:
        nonlocal planned
        if sequence is None:
            return
        number, last = index // sequence.frames, (plans[-1].first + plans[-1].frames - 1) // sequence.frames
        for n in range(max(planned + 1, number), min(number + threads, last + 1)):
            yield partial(sampler.plan_sequence, n)
            planned = n

    return before


def _in_order(
    function: Callable[[int], _Made],
    items: Iterable[int],
    threads: int,
    before: Callable[[int], Iterable[Callable[[], None]]],
) -> Generator[_Made]:
    """Results in the order of the items, worked out by threads at most a few items ahead; `before` an item, more to do."""
    if threads == 1:
        yield from map(function, items)
        return
    coming = iter(items)
    interval = sys.getswitchinterval()
    sys.setswitchinterval(_SWITCH_S)
    with ThreadPoolExecutor(threads, "frames") as pool:

        def submit(item: int) -> Future[_Made]:
            for job in before(item):
                pool.submit(job)  # what it raises is raised again where its result is needed
            return pool.submit(function, item)

        try:
            waiting = deque(map(submit, islice(coming, _AHEAD * threads)))
            while waiting:
                yield waiting.popleft().result()
                waiting.extend(map(submit, islice(coming, 1)))
        finally:
            pool.shutdown(wait=False, cancel_futures=True)
            sys.setswitchinterval(interval)
