"""From frames to the parts of a dataset: threads make them, one writes them in order, and what it took is counted."""

from __future__ import annotations

import ctypes
import sys
import threading
from collections import Counter, deque
from collections.abc import Callable, Generator, Iterable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import closing
from dataclasses import dataclass, field
from functools import partial
from itertools import chain, islice
from pathlib import Path
from typing import Literal, NamedTuple

from threadpoolctl import threadpool_limits

from cabinpose.store import EncodedFrame, Manifest, PartPlan, PartWriter, encode_frame
from cabinpose.synth.frame_maker import FrameMaker
from cabinpose.synth.scene import ImpossibleSceneError, Scene
from cabinpose.synth.style.settings import LEFT
from cabinpose.synth.validate import Rejection, by_cause

Content = Literal["cars", "people", "seats", "styles", "views"]
_AHEAD = 3  # frames that a thread may be ahead of what is written
# Interval (s) after which the interpreter lets another thread run. Kernels release the lock; at Python's default of 5 ms a thread
# that returns from one would wait for half of a frame's 10 ms of work.
_SWITCH_S = 0.0005


@dataclass
class FrameReport:
    """What making some frames took. frames: written, without those skipped · proposals, judged, rejections: see `Attempts` ·
    stage_seconds: CPU time of the threads that made them · content: frames by car, view and style, people by name and seat ·
    label_shift: the farthest that styling moved an edge (px) and the mean depth of a part (mm), of styled frames.
    """

    frames: int = 0
    proposals: int = 0
    judged: int = 0
    rejections: Counter[Rejection] = field(default_factory=Counter)
    stage_seconds: Counter[str] = field(default_factory=Counter)
    content: Counter[tuple[Content, str]] = field(default_factory=Counter)
    label_shift: dict[str, float] = field(default_factory=dict)

    def add(self, other: FrameReport) -> None:
        """Count another report in."""
        self.frames += other.frames
        self.proposals += other.proposals
        self.judged += other.judged
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
    manifest: Manifest,
    maker: FrameMaker,
    *,
    threads: int,
) -> Iterator[FrameReport]:
    """Make parts one after the other; each is written whole or not at all.

    Several threads make frames and share people and cars; the calling thread writes the frames in order.

    Parameters
    ----------
    folder
        Of the dataset.
    plans
        The parts.
    manifest
        What `dataset.yaml` says.
    maker
        Makes the frames of one thread; those of the others are made beside it.
    threads
        How many make frames.

    Yields
    ------
    FrameReport
        After every frame.
    """
    before = _sequences_ahead(maker, plans, threads)
    idle, local = [maker], threading.local()  # a rasteriser's memory belongs to one thread

    def make(index: int) -> _Made:
        if not hasattr(local, "maker"):
            local.maker = idle.pop() if idle else maker.beside()
        mine: FrameMaker = local.maker
        mine.seconds.clear()
        try:
            frame, scene = mine.make(index)
        except ImpossibleSceneError as error:
            if not mine.config.may_skip:
                raise
            tried = error.attempts
            return _Made(None, FrameReport(0, tried.proposals, tried.judged, tried.rejections, Counter(mine.seconds)))
        with mine.stage("write"):
            encoded = encode_frame(frame, index, manifest)
        content, shift = _content(scene), {}
        if "style" in frame:
            content["styles", frame["style"]] = 1
            shift = {name: frame[f"style_{name}"] for name in ("edge_px", "part_mm")} if frame["style"] != LEFT else {}
        seconds, rejections = Counter(mine.seconds), Counter(scene.rejections)
        return _Made(encoded, FrameReport(1, scene.proposals, scene.judged, rejections, seconds, content, shift))

    # One thread each: the libraries' results, and with them the bytes on disk, may depend on their number of threads.
    with threadpool_limits(1), closing(_in_order(make, chain.from_iterable(map(_frames, plans)), threads, before)) as results:
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
    maker: FrameMaker, plans: Sequence[PartPlan], threads: int
) -> Callable[[int], Iterator[Callable[[], object]]]:
    """What is to be done before a frame so that no thread waits: as many sequences are planned as there are threads."""
    sequence = maker.config.scene.sequence
    planned = -1

    def before(index: int) -> Iterator[Callable[[], object]]:
        nonlocal planned
        if sequence is None:
            return
        number, last = index // sequence.frames, (plans[-1].first + plans[-1].frames - 1) // sequence.frames
        for n in range(max(planned + 1, number), min(number + threads, last + 1)):
            yield partial(maker.sampler.plan_sequence, n)
            planned = n

    return before


def _in_order(
    function: Callable[[int], _Made],
    items: Iterable[int],
    threads: int,
    before: Callable[[int], Iterable[Callable[[], object]]],
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
