"""The Dataset tab in a browser, by keys alone."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from benchmarks.studio import on_screen
from cabinpose.store import open_dataset


def seen(page: Any, frame: int) -> None:
    page.locator(f".frame-canvas[data-seen$='/{frame}/depth']:visible").wait_for()


@pytest.mark.slow
def test_arrows_show_every_frame_and_fetch_it_once(page: Any, start: Callable[..., Any], dataset_folder: Path) -> None:
    fetched: Counter[str] = Counter()
    page.on("request", lambda request: fetched.update([request.url.split("/")[-2]]) if "/frames/" in request.url else None)
    page.goto(start(dataset_folder).address)
    seen(page, 0)
    page.evaluate(
        """() => { window.shown = []; const canvas = document.querySelector(".frame-canvas");
        new MutationObserver(() => shown.push(+canvas.dataset.seen.split("/").at(-2))).observe(canvas, { attributes: true }); }"""
    )
    for frame in (1, 2, 3, 4, 5):
        page.keyboard.press("ArrowRight")
        seen(page, frame)
    assert page.evaluate("shown") == [1, 2, 3, 4, 5]
    assert fetched == {str(frame): 1 for frame in range(6)}
    page.keyboard.press("Home")
    seen(page, 0)
    for _ in range(40):
        page.keyboard.down("ArrowRight")  # held: as fast as they come
    page.keyboard.up("ArrowRight")
    seen(page, 5)
    page.get_by_text("frame 5", exact=True).wait_for()
    depth = open_dataset(dataset_folder)["depth"][5].values
    valid = np.argwhere(np.isfinite(depth))
    v, u = valid[len(valid) // 2].tolist()
    canvas = page.locator(".frame-canvas:visible")
    page.mouse.move(*on_screen(canvas, (u, v), (depth.shape[1], depth.shape[0])))
    millimetres = "|".join({f"{depth[v, u] + off:.3f}" for off in (-1e-4, 1e-4)})  # the page rounds tenths of them
    page.get_by_text(re.compile(rf"^{u}, {v}: ({millimetres}) m$")).wait_for()
    page.keyboard.press("ArrowLeft")  # the pointer rests, and is over another frame
    seen(page, 4)
    before = open_dataset(dataset_folder)["depth"][4].values[v, u]
    millimetres = "|".join({f"{before + off:.3f} m" for off in (-1e-4, 1e-4)}) if np.isfinite(before) else "invalid"
    page.get_by_text(re.compile(rf"^{u}, {v}: ({millimetres})$")).wait_for()


@pytest.mark.slow
def test_arrows_are_of_the_tab_in_front_and_of_what_has_the_keyboard(
    page: Any, start: Callable[..., Any], dataset_folder: Path
) -> None:
    page.goto(start(dataset_folder).address)
    seen(page, 0)
    page.get_by_label("frames where").focus()
    page.keyboard.press("ArrowRight")
    page.get_by_role("tab", name="Dataset").focus()
    page.keyboard.press("ArrowRight")
    page.keyboard.press("Enter")
    page.locator(".frame-canvas[data-seen$='/0/depth']:visible").wait_for()
    page.wait_for_function("document.activeElement.className.includes('frame-canvas')")  # of Label
    page.keyboard.press("Escape")
    page.keyboard.press("ArrowRight")
    page.get_by_role("tab", name="Dataset").click()
    page.get_by_text("frame 0", exact=True).wait_for()
    page.locator("body").press("ArrowRight")
    page.get_by_text("frame 0", exact=True).wait_for()  # the bar of tabs has the keyboard
    page.evaluate("document.activeElement.blur()")
    page.keyboard.press("ArrowRight")
    seen(page, 1)


@pytest.mark.slow
def test_query_grid_histogram_and_export_by_keys(page: Any, start: Callable[..., Any], dataset_folder: Path) -> None:
    """To a dataset of the frames of one view, found by a condition, seen in the grid, and narrowed by a bar."""
    errors: list[str] = []
    page.on("console", lambda message: errors.append(message.text) if message.type == "error" else None)
    page.goto(start(dataset_folder).address)
    seen(page, 0)
    page.keyboard.press("/")
    page.wait_for_function("document.activeElement.tagName === 'INPUT'")
    page.keyboard.type("frame >= 2")
    page.keyboard.press("Enter")
    page.get_by_text("4 of 6 frames").wait_for()
    page.keyboard.press("Escape")
    page.keyboard.press("g")
    page.wait_for_function("document.activeElement.className.includes('frame-grid')")
    page.locator(".frame-thumb").nth(3).wait_for()  # the grid has the keyboard before it has all its frames
    assert page.locator(".frame-thumb").count() == 4
    page.wait_for_function("[...document.querySelectorAll('.frame-thumb img')].every((image) => image.naturalWidth > 0)")
    page.keyboard.press("ArrowRight")
    page.keyboard.press("End")
    page.get_by_text("frame 5", exact=True).wait_for()
    page.keyboard.press("ArrowLeft")
    page.get_by_text("frame 4", exact=True).wait_for()
    page.keyboard.press("Enter")
    seen(page, 4)
    page.wait_for_url(re.compile(r"dataset\.frame=4"))  # it is written a moment later
    page.reload()
    seen(page, 4)  # condition, frame and view stand in the address
    page.get_by_text("4 of 6 frames").wait_for()
    page.keyboard.press("h")
    page.get_by_role("option", name="frame", exact=True).wait_for()
    page.keyboard.type("frame")
    while page.locator(".q-item.q-manual-focusable--focused").text_content() != "frame":
        page.keyboard.press("ArrowDown")
    page.keyboard.press("Enter")
    bar = page.locator(".studio-bars .q-item")
    bar.first.wait_for()
    assert bar.count() == 4
    while not page.evaluate("document.activeElement.closest('.studio-bars')"):
        page.keyboard.press("Tab")
    page.keyboard.press("Tab")
    page.keyboard.press("Enter")
    page.get_by_text("1 of 6 frames").wait_for()
    assert page.get_by_label("frames where").input_value() == "frame >= 2 and frame == 3"
    page.keyboard.press("e")
    page.get_by_text("Chosen frames: 1").wait_for()
    page.wait_for_function("document.activeElement.value === 'dataset-chosen'")
    page.keyboard.press("Enter")
    page.get_by_text("cabinpose studio dataset-chosen opens it").wait_for()
    made, whole = open_dataset(dataset_folder.with_name("dataset-chosen")), open_dataset(dataset_folder)
    np.testing.assert_array_equal(made["depth"].values, whole["depth"].values[3:4])
    page.get_by_text("Chosen frames: 1").wait_for(state="hidden")
    page.keyboard.press("e")
    page.get_by_text("Chosen frames: 1").wait_for()
    page.wait_for_function("document.activeElement.value === 'dataset-chosen'")
    page.keyboard.press("Enter")
    page.get_by_text("dataset-chosen is there already").wait_for()
    assert errors == []
