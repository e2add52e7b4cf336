"""Seconds a frame that labelling takes with a person's pace, with proposals and without: measured in headless Chromium.

    python -m tools.label_pace [--with 6] [--without 3] [--seed 11]

Keys and the mouse are played as slowly as a practised person is by the keystroke-level model (Card, Moran and Newell 1980):
thought 1.35 s before each joint and before the frame is accepted, pointing 1.1 s, a button of the mouse down or up 0.1 s, a key
0.28 s; the studio's own time comes on top. That this person sees at once which joints are wrong and hits them to the pixel is
assumed. Of generated frames, whose joints are known, the driver's 14 joints of the upper body are labelled: with proposals of
`in_car` those that lie more than 6 px from the truth are dragged; without, on the same frames as a dataset without joints, each
that lies in the image is clicked, one that is hidden marked so, one outside marked outside.
Needs Debian's chromium and playwright.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.studio import BUTTON_S, KEY_S, POINT_S, THOUGHT_S, choose, far_joints, on_screen, page_of, studio
from cabinpose.app.live.feed import DatasetFeed
from cabinpose.app.studio.live_keep import write_kept
from cabinpose.app.studio.live_session import Shown
from cabinpose.core import CABINPOSE, Visibility
from cabinpose.estimate import load_model
from cabinpose.store import open_dataset
from cabinpose.synth import SynthConfig, generate

_HIDDEN = {Visibility.OCCLUDED: "h", Visibility.SELF_OCCLUDED: "s"}


class Person:
    """Hands on mouse and keyboard."""

    def __init__(self, page: Any) -> None:
        self._page = page

    def _wait(self, seconds: float) -> None:
        self._page.wait_for_timeout(1000 * seconds)

    def think(self) -> None:
        """Look and decide."""
        self._wait(THOUGHT_S)

    def point(self, at: tuple[float, float]) -> None:
        """Bring the pointer somewhere."""
        self._wait(POINT_S)
        self._page.mouse.move(*at, steps=4)

    def press(self) -> None:
        """The button of the mouse goes down."""
        self._wait(BUTTON_S)
        self._page.mouse.down()

    def release(self) -> None:
        """And up."""
        self._wait(BUTTON_S)
        self._page.mouse.up()

    def key(self, key: str) -> None:
        """Press a key, or several at once."""
        self._wait(KEY_S * len(key.split("+")))
        self._page.keyboard.press(key)


def timed(folder: Path, frames: int, model: str, label: Callable[[Person, Any, int], None]) -> list[float]:
    """Seconds that each of so many frames takes, until the next one is on the screen. label: does it, with the image of a row."""
    with studio(folder) as address, page_of(1280, 800) as page:
        page.goto(address)
        page.get_by_role("tab", name="Label").click()
        if model:
            choose(page, "proposals from", model)
            page.get_by_text("proposal", exact=True).first.wait_for()
        shown = page.locator(".frame-canvas:visible").first
        page.wait_for_function("document.activeElement.className.includes('frame-canvas')")
        person, took = Person(page), []
        for row in range(frames):
            began = time.monotonic()
            label(person, shown, row)
            person.think()
            person.key("Enter")
            page.locator(f".frame-canvas[data-seen$='/{row + 1}/depth']:visible").wait_for()
            took.append(time.monotonic() - began)
            print(f"{model or 'no proposals'}: frame {row + 1} of {frames}, {took[-1]:.1f} s", file=sys.stderr)
    return took


def main() -> None:
    """Read the words behind the script and measure."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--with", type=int, default=6, dest="proposed", help="frames that are labelled with proposals")
    parser.add_argument("--without", type=int, default=3, help="and without")
    parser.add_argument("--seed", type=int, default=11)
    chosen = parser.parse_args()
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary) / "generated"
        generate(SynthConfig(), max(chosen.proposed, chosen.without) + 1, folder, seed=chosen.seed)
        truth = open_dataset(folder)
        size = truth.sizes["x"], truth.sizes["y"]
        names = [str(name) for name in truth["joint"].values]
        blank, _ = write_kept([Shown(frame, ()) for frame in DatasetFeed(folder).frames() if frame is not None], Path(temporary))
        wrong = [far_joints(truth, load_model("in_car"), row) for row in range(chosen.proposed)]

        def correct(person: Person, shown: Any, row: int) -> None:
            for proposed, true in wrong[row]:
                person.think()
                person.point(on_screen(shown, proposed, size))
                person.press()
                person.point(on_screen(shown, true, size))
                person.release()

        def place(person: Person, shown: Any, row: int) -> None:
            for name in CABINPOSE.sets["upper body"]:
                uv, seen = (
                    truth["joints_2d"].values[row, 0, names.index(name)],
                    truth["visibility"].values[row, 0, names.index(name)],
                )
                person.think()
                if seen <= Visibility.OUTSIDE_IMAGE or not (0 <= uv[0] < size[0] and 0 <= uv[1] < size[1]):
                    person.key("o")
                    continue
                person.point(on_screen(shown, uv, size))
                person.press()
                person.release()
                if seen in _HIDDEN:
                    person.key("Shift+Tab")
                    person.key(_HIDDEN[Visibility(int(seen))])

        for words, took in (
            (
                f"with proposals ({np.mean([len(each) for each in wrong]):.1f} joints dragged a frame)",
                timed(folder, chosen.proposed, "in_car", correct),
            ),
            ("without", timed(blank, chosen.without, "", place)),
        ):
            print(f"{words}: {np.mean(took):.1f} s a frame, {min(took):.1f} to {max(took):.1f}, {len(took)} frames")


if __name__ == "__main__":
    main()
