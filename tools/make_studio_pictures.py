"""The pictures of docs/studio.md: each tab in headless Chromium, light and dark, and what labelling a frame takes.

    python tools/make_studio_pictures.py DATASET OUT [--sizes 1280x800 1920x1080] [--labelling FRAMES]

Needs Debian's chromium and playwright. With --labelling a copy of the dataset is labelled as a person would: proposals of
`in_car`, every joint that lies more than 6 px from the truth dragged there, Enter. The interactions are counted and priced by the
keystroke-level model (Card, Moran and Newell 1980: key 0.28 s, pointing 1.1 s, button 0.1 s, thought 1.35 s).
"""

from __future__ import annotations

import argparse
import json
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from playwright.sync_api import sync_playwright

from cabinpose.app.studio.labelling import PRESENT
from cabinpose.core.skeleton import UPPER_BODY
from cabinpose.estimate.predictor import load_model
from cabinpose.evaluate.offline import frame_batch
from cabinpose.store import open_dataset
from cabinpose.store.labels import read_labels

TABS = ("Dataset", "Label", "Compare", "Live")
FAR_PX = 6.0
KEY_S, POINT_S, BUTTON_S, THOUGHT_S = 0.28, 1.1, 0.1, 1.35


@contextmanager
def studio(*arguments: object) -> Iterator[str]:
    """A studio that is serving, as its address."""
    words = [sys.executable, "-m", "cabinpose", "studio", *map(str, arguments), "--port", "0"]
    process = subprocess.Popen(words, stdout=subprocess.PIPE, text=True)
    assert process.stdout is not None
    try:
        yield process.stdout.readline().strip()
    finally:
        process.terminate()
        process.wait()


@contextmanager
def page_of(width: int, height: int, scheme: str = "light") -> Iterator[Any]:
    """A page of headless Chromium."""
    with sync_playwright() as driver:
        browser = driver.chromium.launch(
            executable_path=shutil.which("chromium"),
            args=["--no-sandbox", "--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"],
        )
        page = browser.new_page(viewport={"width": width, "height": height}, color_scheme=scheme)
        page.set_default_timeout(60_000)
        yield page
        browser.close()


def picture(dataset: Path, out: Path, size: str, scheme: str) -> None:
    """Every tab at one size."""
    width, height = map(int, size.split("x"))
    with studio(dataset) as address, page_of(width, height, scheme) as page:
        page.goto(address)
        for name in TABS:
            page.get_by_role("tab", name=name).click()
            if name == "Label":
                page.get_by_label("proposals from").click()
                page.get_by_role("option", name="in_car").click()
                page.get_by_text("proposal", exact=True).first.wait_for()
            elif name == "Compare":
                page.get_by_role("button", name="Run").click()
                page.locator("tr", has_text="in_car").wait_for()
            elif name == "Live":
                page.get_by_role("button", name="Start").click()
                page.wait_for_timeout(6000)
            page.wait_for_timeout(3000)
            page.screenshot(path=out / f"studio-{name.lower()}-{size}-{scheme}.png")


def label(dataset: Path, frames: int) -> dict[str, float]:
    """Label frames of the driver with proposals, and count what hands and head had to do."""
    truth, model = open_dataset(dataset), load_model("in_car")
    joints = [str(n) for n in truth["joint"].values]
    size = truth.sizes["x"], truth.sizes["y"]
    with tempfile.TemporaryDirectory() as folder:
        copy = Path(shutil.copytree(dataset, Path(folder) / "dataset"))
        journal = copy.with_name("dataset.labels.jsonl")
        drags, took = 0, []
        with studio(copy) as address, page_of(1280, 800) as page:
            page.goto(address)
            page.get_by_role("tab", name="Label").click()
            page.get_by_label("proposals from").click()
            page.get_by_role("option", name="in_car").click()
            page.get_by_text("proposal", exact=True).first.wait_for()
            shown = page.locator(".frame-canvas:visible").first
            shown.click(position={"x": 5, "y": 5}, modifiers=["Shift"])
            for row in range(frames):
                began = time.monotonic()
                found = model.predict(frame_batch(truth, slice(row, row + 1)))
                for name in UPPER_BODY:
                    true = truth["joints_2d"].values[row, 0, joints.index(name)]
                    j = model.joints.index(name)
                    at, sure = found.joints_2d[0, 0, j], found.presence[0, 0, j] >= PRESENT
                    inside = 0 <= true[0] < size[0] and 0 <= true[1] < size[1]
                    if not sure or not inside or np.hypot(*(at - true)) <= FAR_PX:
                        continue
                    page.mouse.move(*on_screen(shown, at, size))
                    page.mouse.down()
                    page.mouse.move(*on_screen(shown, true, size), steps=4)
                    page.mouse.up()
                    drags += 1
                    page.wait_for_timeout(50)
                page.keyboard.press("Enter")
                while len({key[0] for key in read_labels(journal)[1]} if journal.exists() else ()) <= row:
                    page.wait_for_timeout(20)
                page.wait_for_timeout(300)  # the next frame and its proposals
                took.append(time.monotonic() - began)
    per_frame = drags / frames
    return {
        "frames": frames,
        "drags_per_frame": per_frame,
        "machine_s_per_frame": float(np.median(took)),
        "keystroke_level_s_per_frame": THOUGHT_S + per_frame * (THOUGHT_S + 2 * POINT_S + 2 * BUTTON_S) + KEY_S,
    }


def on_screen(shown: Any, uv: Any, size: tuple[int, int]) -> tuple[float, float]:
    """Where a pixel of the whole image is on the screen."""
    box = shown.bounding_box()
    scale = min(box["width"] / size[0], box["height"] / size[1])
    x = box["x"] + (box["width"] - size[0] * scale) / 2 + (uv[0] + 0.5) * scale
    y = box["y"] + (box["height"] - size[1] * scale) / 2 + (uv[1] + 0.5) * scale
    return float(x), float(y)


def main() -> None:
    """Read the words behind the script and work."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("dataset", type=Path)
    parser.add_argument("out", type=Path)
    parser.add_argument("--sizes", nargs="*", default=["1280x800", "1920x1080"])
    parser.add_argument("--labelling", type=int, default=0)
    chosen = parser.parse_args()
    chosen.out.mkdir(parents=True, exist_ok=True)
    for size in chosen.sizes:
        for scheme in ("light", "dark"):
            picture(chosen.dataset, chosen.out, size, scheme)
    if chosen.labelling:
        print(json.dumps(label(chosen.dataset, chosen.labelling)))


if __name__ == "__main__":
    main()
