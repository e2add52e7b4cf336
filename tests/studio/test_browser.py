"""The studio in a browser, done as a person does it: clicks, drags, keys."""

from __future__ import annotations

import logging
import os
import re
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cabinpose.store import open_dataset
from cabinpose.store.labels import read_labels

JOINTS = 14  # of the upper body, which labels are of


def tab(page: Any, name: str) -> None:
    page.get_by_role("tab", name=name).click()
    page.get_by_role("tab", name=name, selected=True).wait_for()


def canvas(page: Any) -> Any:
    """The only canvas that is to be seen, once the tab before has gone and its image is there."""
    page.wait_for_function(
        "(all => all.length === 1 && !all[0].innerText.includes('loading'))"
        "([...document.querySelectorAll('.frame-canvas')].filter(e => e.offsetParent))"
    )
    return page.locator(".frame-canvas:visible")


def routed(page: Any, pattern: str, answer: Callable[[Any], Any]) -> list[Callable[[Any], Any]]:
    """What is done with requests of a page that is not there yet: the last of these holds, and more can be added at any time.

    Over a page that is shown, Chromium takes requests some time after `page.route` has returned: a key that is pressed meanwhile
    reaches the server.
    """
    answers = [answer]
    page.route(pattern, lambda route: answers[-1](route))  # noqa: PLW0108 - the last one at that time
    return answers


def until(what: Callable[[], Any], seconds: float = 20.0) -> Any:
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        if value := what():
            return value
        time.sleep(0.1)
    raise AssertionError("it did not happen")


def labels_beside(dataset: Path) -> dict[Any, Any]:
    path = dataset.with_name(dataset.name + ".labels.jsonl")
    return read_labels(path)[1] if path.exists() and path.stat().st_size else {}


@pytest.mark.slow
def test_label_drag_kill_and_go_on(page: Any, start: Callable[..., Any], dataset_folder: Path) -> None:
    """Accept a frame, drag a wrist in the next one, kill the server in the middle: everything is there again."""
    from benchmarks.studio import on_screen

    server = start(dataset_folder)
    page.goto(server.address)
    tab(page, "Label")
    shown = canvas(page)
    page.get_by_text("0 of 6 frames done").wait_for()
    shown.click(position={"x": 5, "y": 5}, modifiers=["Shift"])  # only the keyboard's focus
    page.keyboard.press("Enter")
    page.get_by_text("1 of 6 frames done").wait_for()
    page.locator(".frame-canvas[data-seen$='/1/depth']:visible").wait_for()
    dataset = open_dataset(dataset_folder)
    joints = [str(name) for name in dataset["joint"].values]
    size = dataset.sizes["x"], dataset.sizes["y"]
    neck = dataset["joints_2d"].values[1, 0, joints.index("neck")]
    here, there = on_screen(shown, neck, size), on_screen(shown, neck + (12, -7), size)
    page.mouse.move(*here)
    page.mouse.down()
    page.mouse.move((here[0] + there[0]) / 2, (here[1] + there[1]) / 2, steps=3)
    page.mouse.move(*there, steps=3)
    page.mouse.up()
    held = until(lambda: labels_beside(dataset_folder).get((1, "driver", "neck")))
    np.testing.assert_allclose(held.uv, neck + (12, -7), atol=0.6)  # less than a pixel of the screen
    server.kill()
    assert len(labels_beside(dataset_folder)) == JOINTS + 1
    again = start(dataset_folder)
    page.goto(again.address)
    tab(page, "Label")
    page.get_by_text("1 of 6 frames done").wait_for()
    assert labels_beside(dataset_folder)[1, "driver", "neck"].uv == held.uv
    assert again.stop() in (0, 130)


@pytest.mark.slow
def test_labelling_a_frame_takes_few_seconds(page: Any, start: Callable[..., Any], dataset_folder: Path) -> None:
    """With proposals: look, drag two joints, accept. What a person's hands have to do is counted, see docs/benchmarks.md."""
    page.goto(start(dataset_folder).address)
    tab(page, "Label")
    shown = canvas(page)
    page.get_by_label("proposals from").click()
    page.get_by_role("option", name="in_car").click()
    page.get_by_text("proposal", exact=True).first.wait_for()
    shown.click(position={"x": 5, "y": 5}, modifiers=["Shift"])
    page.keyboard.press("Enter")
    until(lambda: len(labels_beside(dataset_folder)) == JOINTS)


@pytest.mark.slow
def test_frame_is_not_accepted_before_it_is_seen(page: Any, start: Callable[..., Any], dataset_folder: Path) -> None:
    """Enter twice, while the second frame's image is still on its way: that frame is not labelled, until Enter comes again."""
    answers = routed(page, "**/frames/*/1/depth", lambda route: route.continue_())
    page.goto(start(dataset_folder).address)
    tab(page, "Label")
    shown = canvas(page)
    shown.click(position={"x": 5, "y": 5}, modifiers=["Shift"])
    held: list[Any] = []
    answers.append(held.append)
    page.keyboard.press("Enter")
    page.get_by_text("1 of 6 frames done").wait_for()
    page.wait_for_timeout(300)  # the image of the second frame is asked for
    page.keyboard.press("Enter")
    page.wait_for_timeout(1000)
    assert {key[0] for key in labels_beside(dataset_folder)} == {0}
    (waiting,) = held
    waiting.continue_()
    page.locator(".frame-canvas[data-seen$='/1/depth']:visible").wait_for()
    page.keyboard.press("Enter")
    page.get_by_text("2 of 6 frames done").wait_for()


@pytest.mark.slow
def test_a_drag_ends_with_the_frame_that_it_is_of(page: Any, start: Callable[..., Any], dataset_folder: Path) -> None:
    """A key goes to the next frame while a joint is held, and a button is let go where the page is not told."""
    from benchmarks.studio import on_screen

    page.goto(start(dataset_folder).address)
    tab(page, "Label")
    shown, dataset = canvas(page), open_dataset(dataset_folder)
    size, neck = (dataset.sizes["x"], dataset.sizes["y"]), dataset["joints_2d"].sel(person="driver", joint="neck").values
    at = on_screen(shown, neck[0], size)
    drawn = "() => { const all = [...document.querySelectorAll('.frame-canvas')], box = all.find((e) => e.offsetParent);"
    drawn += " return getElement(+box.id.slice(1)).shown[0].joints.find((joint) => joint.name === 'neck'); }"

    def drag() -> None:
        page.mouse.move(*at)
        page.mouse.down()
        page.mouse.move(at[0] + 40, at[1] + 20, steps=3)

    drag()
    page.keyboard.press("f")
    page.locator(".frame-canvas[data-seen$='/1/depth']:visible").wait_for()
    page.mouse.up()
    page.get_by_text("1 input not taken").wait_for()
    assert page.evaluate(drawn)["u"] == pytest.approx(neck[1, 0], abs=1e-3)
    page.keyboard.press("b")
    page.locator(".frame-canvas[data-seen$='/0/depth']:visible").wait_for()
    drag()
    shown.locator("canvas").dispatch_event("pointermove", {"buttons": 0, "clientX": at[0], "clientY": at[1]})
    assert page.evaluate(drawn)["u"] == pytest.approx(neck[0, 0], abs=1e-3)
    page.mouse.up()
    page.wait_for_timeout(500)
    assert labels_beside(dataset_folder) == {}


KEYS = """([count, rate]) => new Promise(done => {
  const box = [...document.querySelectorAll('.frame-canvas')].find(e => e.offsetParent), begin = performance.now();
  let states = 'vhs', sent = 0;
  const clock = setInterval(() => {
    for (; sent < count && sent < (performance.now() - begin) / 1000 * rate; sent++)
      box.dispatchEvent(new KeyboardEvent('keydown', { key: states[Math.floor(sent / 14) % 3], bubbles: true }));
    if (sent === count) { clearInterval(clock); done(); }
  }, 5);
})"""  # a state for each of 14 joints in turn, so many, so many a second


@pytest.mark.slow
def test_a_burst_in_two_windows_is_on_the_disk(page: Any, start: Callable[..., Any], dataset_folder: Path) -> None:
    """However fast changes come: each is in the journal once, and both pages show what is there."""
    count = int(os.environ.get("CABINPOSE_BURST", "100"))
    address = start(dataset_folder).address
    windows = [page, page.context.new_page()]
    for window in windows:
        window.goto(address)
        tab(window, "Label")
        canvas(window).wait_for()
    began = time.monotonic()
    for window in windows:
        window.evaluate(f"() => {{ window.burst = ({KEYS})([{count}, 30]) }}")
    for window in windows:
        window.evaluate("() => window.burst")
    sent_s = time.monotonic() - began
    journal = dataset_folder.with_name(dataset_folder.name + ".labels.jsonl")
    waiting = [window.locator(".frame-canvas-inputs").all_inner_texts() for window in windows]
    until(lambda: len(journal.read_text().splitlines()) == 2 * count + 1, 60)
    last_s = time.monotonic() - began - sent_s
    logging.getLogger(__name__).info("%d keys in %.2f s, on the disk %.2f s later; told %s", 2 * count, sent_s, last_s, waiting)
    for window in windows:
        window.get_by_text(f"{2 * count} changes in").wait_for()
        assert window.locator(".frame-canvas-inputs").count() == 0
    windows[1].close()


@pytest.mark.slow
def test_what_is_not_written_is_told(page: Any, start: Callable[..., Any], dataset_folder: Path) -> None:
    """While the studio does not answer, and when the page is no longer its own."""
    answers = routed(page, "**/inputs/*", lambda route: route.abort())
    page.goto(start(dataset_folder).address)
    tab(page, "Label")
    shown = canvas(page)
    shown.click(position={"x": 5, "y": 5}, modifiers=["Shift"])
    page.keyboard.press("v")
    page.keyboard.press("h")
    page.get_by_text("the studio does not answer: 2 inputs not yet written").wait_for()
    assert labels_beside(dataset_folder) == {}
    answers.append(lambda route: route.continue_())
    page.get_by_text("not yet written").wait_for(state="detached")
    assert len(labels_beside(dataset_folder)) == 2
    answers.append(lambda route: route.fulfill(status=404, body="gone"))
    page.keyboard.press("v")
    page.get_by_text("this page is not the studio's any more: 1 input not written").wait_for()
    assert len(labels_beside(dataset_folder)) == 2


@pytest.mark.slow
def test_dataset_is_filtered_and_browsed(page: Any, start: Callable[..., Any], dataset_folder: Path) -> None:
    page.goto(start(dataset_folder).address)
    page.get_by_text("6 of 6 frames").wait_for()
    canvas(page)
    action = str(open_dataset(dataset_folder)["action"].values[2, 0])
    page.get_by_label("action").click()
    page.get_by_role("option", name=action, exact=True).click()
    count = int((open_dataset(dataset_folder)["action"].values == action).any(axis=1).sum())
    page.get_by_text(f"{count} of 6 frames").wait_for()
    page.keyboard.press("Escape")
    page.get_by_role("button", name="Statistics").click()
    page.get_by_text(re.compile(rf"^{count} of 6 frames$")).last.wait_for()


@pytest.mark.slow
def test_model_is_run_and_compared(page: Any, start: Callable[..., Any], dataset_folder: Path, run: Callable[..., Any]) -> None:
    """The numbers are those of `evaluate`."""
    clouds: list[str] = []
    page.on("response", lambda answer: clouds.append(answer.url) if answer.ok and "/clouds/" in answer.url else None)
    page.goto(start(dataset_folder).address)
    tab(page, "Compare")
    page.get_by_role("button", name="Run").click()
    row = page.locator("tr", has_text="in_car")
    row.wait_for()
    told = row.locator("td").all_inner_texts()
    report = run("evaluate", dataset_folder, "--model", "in_car", "--resamples", 0, "--all").out
    for value, name in ((told[1], "mAD 3D"), (told[3], "mAP@10 cm (literal) 3D"), (told[5], "PCKh@0.5 3D")):
        line = next(line for line in report.splitlines() if line.startswith(name))
        assert line.removeprefix(name).split()[0] == value
    page.wait_for_timeout(1000)
    assert clouds  # the worst frame is shown in 3D


@pytest.mark.slow
def test_second_studio_says_who_has_the_labels(page: Any, start: Callable[..., Any], dataset_folder: Path) -> None:
    first = start(dataset_folder)
    page.goto(first.address)
    tab(page, "Label")
    page.get_by_text("0 of 6 frames done").wait_for()
    page.goto(start(dataset_folder).address)
    tab(page, "Label")
    page.get_by_text("is open in another studio").wait_for()


@pytest.mark.slow
def test_nothing_open_says_what_to_do(page: Any, start: Callable[..., Any]) -> None:
    page.goto(start().address)
    page.get_by_text("cabinpose studio DATASET").first.wait_for()
