"""The studio in a browser by keys alone, over reloads: no click but to begin."""

from __future__ import annotations

import io
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from cabinpose.store.labels import read_labels

HAS_IT = "document.activeElement.className.includes('frame-canvas')"
JOINTS = 14


def labelled(dataset: Path) -> set[tuple[int, str]]:
    return {(frame, person) for frame, person, _ in read_labels(dataset.with_name(dataset.name + ".labels.jsonl"))[1]}


def open_label(page: Any, address: str) -> None:
    """With keys: the bar's first tab, then to the right."""
    page.goto(address)
    page.get_by_role("tab", name="Dataset").wait_for()
    page.get_by_role("tab", name="Dataset").focus()
    page.keyboard.press("ArrowRight")
    page.keyboard.press("Enter")
    seen(page, 0)


def seen(page: Any, frame: int) -> None:
    page.locator(f".frame-canvas[data-seen$='/{frame}/depth']:visible").wait_for()
    page.wait_for_function(HAS_IT)


def picture(page: Any) -> Any:
    page.mouse.move(0, 0)  # the pixel under the pointer is told in the picture
    page.wait_for_timeout(300)
    shot = page.locator(".frame-canvas:visible canvas").screenshot()
    return np.asarray(Image.open(io.BytesIO(shot)).convert("RGB"), float)


@pytest.mark.slow
def test_label_has_the_keyboard_when_it_opens_and_after_each_choice(
    page: Any, start: Callable[..., Any], dataset_folder: Path
) -> None:
    open_label(page, start(dataset_folder).address)
    page.keyboard.press("Enter")
    page.get_by_text("1 of 6 frames done").wait_for()
    seen(page, 1)
    for name, option in (("proposals from", "in_car"), ("joints", "all joints"), ("joints", "upper body")):
        page.get_by_label(name).click()
        page.get_by_role("option", name=option).click()
        page.get_by_role("option").first.wait_for(state="hidden")
        seen(page, 1)  # the frame stays, and the image has the keyboard
    page.keyboard.press("Enter")
    page.get_by_text("2 of 6 frames done").wait_for()
    assert labelled(dataset_folder) == {(0, "driver"), (1, "driver")}


@pytest.mark.slow
def test_a_reload_goes_on_where_it_was(page: Any, start: Callable[..., Any], dataset_folder: Path) -> None:
    open_label(page, start(dataset_folder).address)
    page.get_by_label("proposals from").click()
    page.get_by_role("option", name="in_car").click()
    page.get_by_text("proposal", exact=True).first.wait_for()
    seen(page, 0)
    for frame in (1, 2, 3):
        page.keyboard.press("f")
        seen(page, frame)
    whole = picture(page)
    box = page.locator(".frame-canvas:visible").bounding_box()
    page.mouse.move(box["x"] + box["width"] / 2, box["y"] + box["height"] / 2)
    page.mouse.wheel(0, -400)
    page.wait_for_url(re.compile(r"label\.zoom=2\.718"))
    zoomed = picture(page)
    assert np.abs(zoomed - whole).mean() > 5
    page.reload()
    seen(page, 3)
    page.get_by_text("proposal", exact=True).first.wait_for()
    assert page.get_by_role("tab", name="Label").get_attribute("aria-selected") == "true"
    assert np.abs(picture(page) - zoomed).mean() < 0.5  # of 255; the place has three decimals in the address
    page.keyboard.press("Enter")
    page.get_by_text("1 of 6 frames done").wait_for()
    assert labelled(dataset_folder) == {(3, "driver")}
    page.reload()
    page.locator(".frame-canvas[data-seen]:visible").wait_for()
    page.wait_for_function(HAS_IT)
    page.keyboard.press("z")  # what this window did before
    page.get_by_text("0 of 6 frames done").wait_for()
    assert labelled(dataset_folder) == set()


@pytest.mark.slow
def test_a_click_that_brings_the_keyboard_places_nothing(page: Any, start: Callable[..., Any], dataset_folder: Path) -> None:
    open_label(page, start(dataset_folder).address)
    page.keyboard.press("Escape")
    page.locator(".frame-canvas:visible").click(position={"x": 200, "y": 60})
    page.wait_for_function(HAS_IT)
    page.locator(".frame-canvas:visible").click(position={"x": 260, "y": 60})
    page.get_by_text("1 changes in").wait_for()
    page.keyboard.press("Escape")
    page.keyboard.press("Tab")  # out of the image, to what comes after it
    assert page.evaluate("document.activeElement.className").find("frame-canvas") < 0


@pytest.mark.slow
def test_ten_frames_and_two_models_by_keys_alone(
    page: Any, start: Callable[..., Any], tmp_path: Path, run: Callable[..., Any]
) -> None:
    """Five frames, a reload, a kill -9, a new studio, five more: none is lost; then two models are compared."""
    dataset = tmp_path / "ten"
    run("synth", "--out", dataset, "--frames", 10, "--seed", 4, "scene.cars=[suv]")
    files = [tmp_path / f"{model}.jsonl" for model in ("in_car", "five_seats")]
    for file in files:
        run("predict", dataset, "--model", file.stem, "--out", file)
    server = start(dataset, "--predictions", *files)
    open_label(page, server.address)
    for frame in range(5):
        seen(page, frame)
        page.keyboard.press("h" if frame % 2 else "s")  # the head's state, by hand
        page.keyboard.press("Enter")
    seen(page, 5)
    page.reload()
    seen(page, 5)
    address = page.url.partition("?")[2]
    server.kill()
    assert labelled(dataset) == {(frame, "driver") for frame in range(5)}
    again = start(dataset, "--predictions", *files)
    page.goto(f"{again.address}?{address}")
    for frame in range(5, 10):
        seen(page, frame)
        page.keyboard.press("Enter")
    page.get_by_text("10 of 10 frames done").wait_for()
    assert labelled(dataset) == {(frame, "driver") for frame in range(10)}
    page.keyboard.press("Escape")
    page.get_by_role("tab", name="Label").focus()
    page.keyboard.press("ArrowRight")
    page.keyboard.press("Enter")
    page.locator("tr", has_text="in_car").wait_for()
    worst = page.get_by_text(re.compile(r"^frame \d+: in_car .* cm, five_seats .* cm$"))
    worst.first.wait_for()
    for _ in range(40):
        page.keyboard.press("Tab")
        if page.evaluate("document.activeElement.innerText").startswith("frame"):
            break
    second = str(worst.nth(1).inner_text())
    page.keyboard.press("Tab")
    page.keyboard.press("Enter")
    page.get_by_text(second.partition(":")[0], exact=True).wait_for()  # the frame that is shown
