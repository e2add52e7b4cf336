"""The bench of the studio in headless Chromium: from a change of a scene to its pictures, what labelling a frame takes, and what
arrow keys through a dataset do.
"""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Literal

import numpy as np
import xarray as xr
from playwright.sync_api import Browser, Playwright, sync_playwright
from playwright.sync_api import TimeoutError as NotInTime

from benchmarks import Say
from cabinpose.app.label.labelling import PRESENT
from cabinpose.core.skeleton import CABINPOSE
from cabinpose.estimate.predictor import load_model
from cabinpose.evaluate.offline import frame_batch
from cabinpose.store import open_dataset
from cabinpose.store.labels import read_labels
from cabinpose.synth.config import SynthConfig
from cabinpose.synth.generate import generate

_SCENE = """# seed 5, frame 0
scene:
  cars: [suv]
  child_seats: {rear_left: infant}
  in_hand: 1.0
  occupants:
    driver: {subject: S03}
    front_passenger: {subject: S05, action: phone_text}
    rear_right: {subject: S11, action: drink}
"""
_PANES = 3  # depth, amplitude, labels
_WARM = 3
_FAR_PX = 6.0  # from the truth: a joint that a person would drag
_SEED = 11
_COUNTED = 150  # frames of which the joints to drag are counted, of a small bench fewer
KEY_S, POINT_S, BUTTON_S, THOUGHT_S = 0.28, 1.1, 0.1, 1.35  # keystroke-level model: Card, Moran and Newell 1980
_WATCH = """
window.began = 0; window.put = [];
addEventListener("keydown", () => { began = performance.now(); put = []; }, true);
const image = OffscreenCanvasRenderingContext2D.prototype.putImageData;
OffscreenCanvasRenderingContext2D.prototype.putImageData = function (...all) {
  image.apply(this, all);
  requestAnimationFrame(() => requestAnimationFrame(() => put.push(performance.now() - began)));  // once it is on the screen
};
"""


_WATCH_FRAMES = """() => {
  const canvas = document.querySelector(".frame-canvas");
  window.shown = []; window.seen = new Set(); let began = 0;
  addEventListener("keydown", () => { began = performance.now(); }, true);
  new MutationObserver(() => { seen.add(canvas.dataset.seen); shown.push(performance.now() - began); })
    .observe(canvas, { attributes: true, attributeFilter: ["data-seen"] });
}"""


@contextmanager
def studio_process(*arguments: object, python: str = sys.executable) -> Iterator[tuple[str, int]]:
    """A studio that is serving, as its address and the number of its process."""
    words = [python, "-m", "cabinpose", "studio", *map(str, arguments), "--port", "0"]
    process = subprocess.Popen(words, stdout=subprocess.PIPE, text=True)
    assert process.stdout is not None
    try:
        yield process.stdout.readline().strip(), process.pid
    finally:
        process.terminate()
        process.wait()


@contextmanager
def studio(*arguments: object, python: str = sys.executable) -> Iterator[str]:
    """A studio that is serving, as its address."""
    with studio_process(*arguments, python=python) as (address, _):
        yield address


def cpu_s(pid: int) -> float:
    """What a process of Linux has taken of its processors so far, of its own and for the system, s."""
    fields = Path(f"/proc/{pid}/stat").read_text(encoding="utf-8").rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def chromium(driver: Playwright) -> Browser:
    """Headless Chromium, which draws 3D in software."""
    return driver.chromium.launch(
        executable_path=shutil.which("chromium"),
        args=["--no-sandbox", "--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"],
    )


@contextmanager
def page_of(width: int, height: int, scheme: Literal["light", "dark"] = "light") -> Iterator[Any]:
    """A page of headless Chromium."""
    with sync_playwright() as driver:
        browser = chromium(driver)
        page = browser.new_page(viewport={"width": width, "height": height}, color_scheme=scheme)
        page.set_default_timeout(60_000)
        yield page
        browser.close()


def choose(page: Any, label: str, option: str) -> None:
    """Choose from a list.

    On a busy machine a list that is clicked as soon as it is there may count as open without being seen: then again.
    """
    wanted = page.get_by_role("option", name=option, exact=True)
    for tries_left in reversed(range(20)):
        page.get_by_label(label).click()
        try:
            wanted.click(timeout=3_000)
            return
        except NotInTime:
            if not tries_left:
                raise


def run(*, changes: int, frames: int, scrolled: int, say: Say) -> dict[str, Any]:
    """Move a joint of one of three people in an SUV with a child seat by keys at 1280x800, label frames, go through them.

    Parameters
    ----------
    changes
        Changes of the scene that are timed.
    frames
        Frames that are labelled in the browser.
    scrolled
        Frames that are gone through.
    say
        Called with what is being measured.

    Returns
    -------
    dict
        preview: server_ms, that the server took to draw, and pictures_ms, from the key to all three pictures on the screen, as
        median and p95; server_cpu_ms, all that the server's process took of its processors for a change, as mean · labelling:
        drags_per_frame of 150 frames, machine_s_per_frame (the studio's own time, the script's moves of the mouse included),
        keystroke_level_s_per_frame (what a person takes by the keystroke-level model) · scrolling: server_cpu_ms and kilobytes of
        a frame, with its cloud; shown_ms, from the key to the image; skipped, frames that were not shown.
    """
    return {"preview": _preview(changes, say), "labelling": _labelling(frames, say), "scrolling": _scrolling(scrolled, say)}


def _preview(changes: int, say: Say) -> dict[str, Any]:
    server, pictures = [], []
    with tempfile.TemporaryDirectory() as folder:
        scene = Path(folder) / "scene.yaml"
        scene.write_text(_SCENE)
        with studio_process(scene) as (address, pid), page_of(1280, 800) as page:
            page.add_init_script(_WATCH)
            page.goto(address)
            page.wait_for_function(f"put.length >= {_PANES}")
            page.get_by_role("button", name="Accept").click()
            page.get_by_role("button", name="Accept it").click()
            page.get_by_role("tab", name="People").click()
            page.get_by_text("driver: S03").click()
            page.wait_for_timeout(3000)
            slider = page.get_by_text("right elbow flexion", exact=True).locator("xpath=..").locator(".q-slider")
            slider.scroll_into_view_if_needed()
            slider.locator("[tabindex='0']").focus()
            began = cpu_s(pid)
            for number in range(_WARM + changes):
                say(f"change {number + 1} of {_WARM + changes}")
                began = cpu_s(pid) if number == _WARM else began
                page.keyboard.press("ArrowRight" if number // 4 % 2 else "ArrowLeft")
                page.wait_for_function(f"put.length >= {_PANES}")
                page.wait_for_timeout(1500)  # the 3D view follows
                if number >= _WARM:
                    pictures.append(max(page.evaluate("put")[:_PANES]))
                    facts = str(page.get_by_text(re.compile(r"\d+ ms$")).last.text_content())
                    server.append(float(facts.split(";")[-1].removesuffix(" ms")))
            mean = 1000 * (cpu_s(pid) - began) / changes
    return {"server_ms": _spread(server), "pictures_ms": _spread(pictures), "server_cpu_ms": mean}


def _spread(values: Sequence[float]) -> dict[str, float]:
    return dict(zip(("median", "p95"), np.percentile(values, (50, 95)).tolist(), strict=True))


def _scrolling(frames: int, say: Say) -> dict[str, Any]:
    """Go through generated frames by the right arrow, one key once the frame before is shown."""
    with tempfile.TemporaryDirectory() as folder:
        dataset = Path(folder) / "dataset"
        say(f"generating {frames + 1} frames")
        generate(SynthConfig(), frames + 1, dataset, seed=_SEED)
        sent: list[float] = []
        with studio_process(dataset) as (address, pid), page_of(1280, 800) as page:
            page.goto(address)
            page.locator(".frame-canvas[data-seen$='/0/depth']").wait_for()
            page.wait_for_timeout(3000)
            page.evaluate(_WATCH_FRAMES)
            watch = page.context.new_cdp_session(page)
            watch.send("Network.enable")
            watch.on("Network.loadingFinished", lambda event: sent.append(event["encodedDataLength"]))
            watch.on("Network.webSocketFrameReceived", lambda event: sent.append(len(event["response"]["payloadData"])))
            began = cpu_s(pid)
            for number in range(1, frames + 1):
                say(f"frame {number} of {frames}")
                page.keyboard.press("ArrowRight")
                page.wait_for_function(f"shown.length >= {number}", polling=10)
            page.wait_for_timeout(2000)  # the cloud follows
            used = cpu_s(pid) - began
            shown, seen = page.evaluate("[shown, seen.size]")
    figures = {"server_cpu_ms": 1000 * used / frames, "kilobytes": sum(sent) / frames / 1000}
    return {**figures, "shown_ms": _spread(shown), "skipped": frames - seen}


def _labelling(frames: int, say: Say) -> dict[str, float]:
    """Label as a person would: drag each proposed joint that lies far from the truth, then Enter."""
    model = load_model("in_car")
    with tempfile.TemporaryDirectory() as folder:
        dataset = Path(folder) / "dataset"
        journal = dataset.with_name("dataset.labels.jsonl")
        counted = max(frames, min(_COUNTED, 13 * frames))
        say(f"generating {counted} frames")
        generate(SynthConfig(), counted, dataset, seed=_SEED)
        truth = open_dataset(dataset)
        wrong = [far_joints(truth, model, row) for row in range(truth.sizes["frame"])]
        size = truth.sizes["x"], truth.sizes["y"]
        took = []
        with studio(dataset) as address, page_of(1280, 800) as page:
            page.goto(address)
            page.get_by_role("tab", name="Label").click()
            choose(page, "proposals from", "in_car")
            page.get_by_text("proposal", exact=True).first.wait_for()
            shown = page.locator(".frame-canvas:visible").first
            shown.click(position={"x": 5, "y": 5}, modifiers=["Shift"])
            for row in range(frames):
                say(f"frame {row + 1} of {frames}")
                began = time.monotonic()
                for proposed, true in wrong[row]:
                    page.mouse.move(*on_screen(shown, proposed, size))
                    page.mouse.down()
                    page.mouse.move(*on_screen(shown, true, size), steps=4)
                    page.mouse.up()
                    page.wait_for_timeout(50)
                page.keyboard.press("Enter")
                while len({key[0] for key in read_labels(journal)[1]} if journal.exists() else ()) <= row:
                    page.wait_for_timeout(20)
                page.locator(f".frame-canvas[data-seen$='/{min(row + 1, truth.sizes['frame'] - 1)}/depth']:visible").wait_for()
                page.wait_for_timeout(300)  # the proposals of the next frame
                took.append(time.monotonic() - began)
    drags = float(np.mean([len(joints) for joints in wrong]))
    return {
        "drags_per_frame": drags,
        "machine_s_per_frame": float(np.median(took)),
        "keystroke_level_s_per_frame": THOUGHT_S + drags * (THOUGHT_S + 2 * POINT_S + 2 * BUTTON_S) + KEY_S,
    }


def far_joints(truth: xr.Dataset, model: Any, row: int) -> list[tuple[Any, Any]]:
    """Where the driver's joints were proposed and where they are (u, v) px, of those inside that lie too far from the truth."""
    joints = [str(name) for name in truth["joint"].values]
    found = model.predict(frame_batch(truth, slice(row, row + 1)))
    far = []
    for name in CABINPOSE.sets["upper body"]:
        true = truth["joints_2d"].values[row, 0, joints.index(name)]
        j = model.joints.index(name)
        proposed, sure = found.joints_2d[0, 0, j], found.presence[0, 0, j] >= PRESENT
        inside = 0 <= true[0] < truth.sizes["x"] and 0 <= true[1] < truth.sizes["y"]
        if sure and inside and np.hypot(*(proposed - true)) > _FAR_PX:
            far.append((proposed, true))
    return far


def on_screen(shown: Any, uv: Any, size: tuple[int, int]) -> tuple[float, float]:
    """Where a pixel of the whole image is on the screen."""
    box = shown.bounding_box()
    scale = min(box["width"] / size[0], box["height"] / size[1])
    x = box["x"] + (box["width"] - size[0] * scale) / 2 + (uv[0] + 0.5) * scale
    y = box["y"] + (box["height"] - size[1] * scale) / 2 + (uv[1] + 0.5) * scale
    return float(x), float(y)
