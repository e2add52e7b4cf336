"""A live run in the background, for browsers to look at."""

from __future__ import annotations

import json
import threading
from collections import deque
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple, TextIO

from fastapi import APIRouter, HTTPException, Response
from numpy.typing import NDArray

from cabinpose.app.finite import finite
from cabinpose.app.live.choose import open_feed
from cabinpose.app.live.feed import LiveFrame
from cabinpose.app.live.run import Found, Live, LiveStatus, found_record
from cabinpose.app.studio.pictures import picture
from cabinpose.core import CabinposeError, Predictor
from cabinpose.evaluate import EvaluationOptions

PRESENT = EvaluationOptions().presence
_RECENT = 64  # frames kept for browsers that have been told of them and come for their images
_TRAIL = 900  # frames whose joints are kept, without their images: 20 s at 45 a second


class Shown(NamedTuple):
    """A frame, and each detector with what it found in it."""

    frame: LiveFrame
    found: tuple[tuple[Predictor, Found], ...]


class LiveSession:
    """Detectors on a source, on a thread of its own; `latest` is what browsers show."""

    def __init__(
        self, source: str, settings: dict[str, Any], models: Sequence[Predictor], *, within: Path, record: Path | None = None
    ) -> None:
        """record: what is seen is written there, without its ending: joints (.jsonl), and of a camera all that it says (.mcap).

        Raises ConfigError for a source that is not there or outside of `within`; the thread connects, see `error`.
        """
        out = None if record is None or _recorded(source) else record.with_name(f"{record.name}.mcap")
        self.records = [record.with_name(f"{record.name}.jsonl"), *([out] if out else [])] if record is not None else []
        self.source = source
        self._live = Live(open_feed(source, settings, realtime=True, out=out, within=within), models, skip_errors=True)
        self.models = tuple(models)
        self.latest: Shown | None = None
        self.recent: deque[LiveFrame] = deque(maxlen=_RECENT)
        self.trail: deque[tuple[int, tuple[Found, ...]]] = deque(maxlen=_TRAIL)  # when each frame came, ns, and what was found
        self.error = ""
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, name="live", daemon=True)
        self._thread.start()

    @property
    def running(self) -> bool:
        """Whether it still looks."""
        return self._thread.is_alive()

    def status(self) -> LiveStatus:
        """Rates, latencies and what the source says."""
        return self._live.status()

    def stop(self) -> None:
        """End the run and what is recorded."""
        self._stop.set()
        self._thread.join(10.0)

    def _run(self) -> None:
        try:
            with self._written() as lines:
                self._live.feed.start()
                try:
                    for frame, found in self._live.run(lambda: not self._stop.is_set()):
                        self.recent.append(frame)
                        self.trail.append((frame.host_ns, found))
                        self.latest = Shown(frame, tuple(zip(self.models, found, strict=True)))
                        if lines is not None:
                            lines.write(json.dumps(finite(found_record(frame, found, self.models)), allow_nan=False) + "\n")
                finally:
                    self._live.feed.stop()
        except CabinposeError as error:
            self.error = error.in_one_line()
        except OSError as error:
            self.error = f"{self.records[0] if self.records else self.source}: {error.strerror}"
        except Exception as error:  # noqa: BLE001 - a thread's end would otherwise be seen by nobody
            self.error = f"the run failed: {error!r}"

    @contextmanager
    def _written(self) -> Iterator[TextIO | None]:
        """The new file of what is found; None where nothing is recorded. Each line is with the system once it is whole."""
        if not self.records:
            yield None
            return
        with self.records[0].open("x", buffering=1) as lines:
            yield lines


def _recorded(source: str) -> bool:
    """Whether a source is recorded already, so that only what is found in it is new."""
    path = Path(source.rpartition(":")[0] or source) if not Path(source).exists() else Path(source)
    return path.is_dir() or (path.is_file() and path.suffix not in (".yaml", ".yml"))


def image_of(frame: LiveFrame, name: str) -> NDArray[Any]:
    """The depth or amplitude of a live frame; KeyError where the camera gives none."""
    image: NDArray[Any] = frame.batch[name][0]  # type: ignore[literal-required]
    return image


class LiveRoom:
    """The one live run of a studio, the frame that a browser froze, and those that are kept to be labelled."""

    def __init__(self) -> None:
        self.session: LiveSession | None = None
        self.frozen: Shown | None = None
        self.kept: list[Shown] = []
        self.trouble = ""  # why there is no run

    def shown(self) -> Shown | None:
        """The frozen frame, else the newest."""
        if self.frozen is not None:
            return self.frozen
        return self.session.latest if self.session is not None else None

    def routes(self) -> APIRouter:
        """`/live/{host_ns}/{variable}`: an image of the frame that came then, if it is one of the last ones or frozen."""
        router = APIRouter()

        @router.get("/live/{host_ns}/{name}")
        def image(host_ns: int, name: str) -> Response:
            frames = [*(self.session.recent if self.session is not None else ()), *(self.frozen or ())[:1]]
            frame = next((f for f in frames if f.host_ns == host_ns), None)
            if frame is None or name not in ("depth", "amplitude") or name not in frame.batch:
                raise HTTPException(404, "there is no such image")
            return picture(name, image_of(frame, name)).response(keep=False)

        return router

    def stop(self) -> None:
        """End what runs."""
        if self.session is not None:
            self.session.stop()
            self.session = None
        self.frozen, self.trouble = None, ""
