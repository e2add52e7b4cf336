"""What everybody needs to read and reach the studio: contrast in both themes, the keyboard alone, nothing from the network."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

TABS = ("Scene", "Dataset", "Label", "Compare", "Live")

_CONTRAST = Path(__file__).with_name("contrast.js").read_text()  # how many were looked at, and those that are too faint
_UNDIMMED = """() => [...document.querySelectorAll(".frame-canvas")].every((e) => {
  for (; e; e = e.parentElement) if (+getComputedStyle(e).opacity < 1) return false;
  return true;
})"""  # pictures of Scene are dimmed while they are not yet those of the scene
_FOCUS = """() => {
  const e = document.activeElement;
  if (!e || e === document.body) return null;
  const field = e.closest(".q-field__control"), style = getComputedStyle(e);
  const edge = field ? parseFloat(getComputedStyle(field, "::after").borderTopWidth) : 0;
  const ring = style.outlineStyle === "none" ? 0 : parseFloat(style.outlineWidth);
  return { name: e.outerHTML.slice(0, 140), ring: Math.max(ring, edge) >= 2, image: e.matches(".frame-canvas") };
}"""
_WANTED = """() => [...document.querySelectorAll("button, a[href], input:not([type=file]), textarea, [tabindex='0']")]
  .filter((e) => e.offsetParent && e.checkVisibility() && !e.closest("[disabled], .disabled, [aria-hidden=true], [role=tablist]"))
  .map((e, i) => { e.dataset.wanted = i; return e.outerHTML.slice(0, 140); })"""
_WITHIN = """() => {
  const e = document.activeElement, whole = e.closest(".q-field, .q-checkbox, .q-slider, .q-item, .q-uploader") || e;
  return [e.closest("[data-wanted]"), ...whole.querySelectorAll("[data-wanted]")].filter(Boolean).map((x) => +x.dataset.wanted);
}"""


def shown(page: Any, name: str) -> None:
    page.get_by_role("tab", name=name, exact=True).first.click()
    page.get_by_role("tab", name=name, selected=True).first.wait_for()
    page.wait_for_timeout(1500)


@pytest.fixture(scope="module")
def address(
    start_for_module: Callable[..., Any], generated: Path, predicted: Path, tmp_path_factory: pytest.TempPathFactory
) -> str:
    """Of a studio over a dataset and predictions, in which nothing is changed."""
    folder = shutil.copytree(generated, tmp_path_factory.mktemp("contrast") / "dataset")
    return str(start_for_module(folder, "--predictions", predicted).address)


@pytest.mark.slow
@pytest.mark.parametrize("theme", ["light", "dark"])
def test_all_words_and_controls_have_the_contrast_of_wcag_aa(
    browser: Any, start: Callable[..., Any], address: str, tmp_path: Path, theme: str
) -> None:
    """And no request leaves this machine, and the console stays empty."""
    asked: list[str] = []
    said: list[str] = []
    context = browser.new_context(viewport={"width": 1280, "height": 800}, color_scheme=theme)
    page = context.new_page()
    page.set_default_timeout(60_000)
    page.on("request", lambda request: asked.append(request.url))
    page.on("websocket", lambda socket: asked.append(socket.url))
    page.on("console", lambda message: said.append(message.text) if message.type in ("error", "warning") else None)
    page.on("pageerror", lambda error: said.append(str(error)))
    page.goto(address)
    page.get_by_text("6 of 6 frames").wait_for()
    wrong = {}
    for name in TABS:
        shown(page, name)
        count, wrong[name] = page.evaluate(_CONTRAST)
        assert count > 10, name
    page.keyboard.press("?")
    page.get_by_text("through the page", exact=True).wait_for()
    page.wait_for_timeout(500)
    _, wrong["?"] = page.evaluate(_CONTRAST)
    scene = tmp_path / "scene.yaml"
    scene.write_text("scene:\n  cars: [suv]\n")
    of_scene = start(scene).address
    page.goto(of_scene)
    page.get_by_role("button", name="Accept").click()
    page.wait_for_timeout(3000)
    for name in ("Keys", "People"):
        page.get_by_role("tab", name=name).click()
        page.wait_for_timeout(1000)
        page.wait_for_function(_UNDIMMED)
        count, wrong[name] = page.evaluate(_CONTRAST)
        assert count > 30, name
    context.close()
    assert {name: each for name, each in wrong.items() if each} == {}
    here = {each.split("/")[2] for each in (address, of_scene)}
    assert [url for url in asked if url.split("/")[2] not in here and not url.startswith(("data:", "blob:"))] == []
    assert said == []


@pytest.mark.slow
@pytest.mark.parametrize("name", TABS)
def test_tab_alone_reaches_everything_and_is_seen(page: Any, address: str, name: str) -> None:
    """All that the mouse can press, with a ring around what has the keyboard; joints of Label: by Tab in the image."""
    page.goto(address)
    page.get_by_text("6 of 6 frames").wait_for()
    shown(page, name)
    page.keyboard.press("Escape")  # out of the image of Label, which has its own use of Tab
    page.evaluate("document.activeElement.blur()")
    wanted = page.evaluate(_WANTED)
    reached: set[int] = set()
    unseen = []
    for _ in range(4 * len(wanted) + 40):
        page.keyboard.press("Tab")
        now = page.evaluate(_FOCUS)
        if now is None:
            continue
        reached |= set(page.evaluate(_WITHIN))
        if now["image"]:
            page.keyboard.press("Escape")
        elif not now["ring"]:
            unseen.append(now["name"])
        if len(reached) == len(wanted):
            break
    assert [words for i, words in enumerate(wanted) if i not in reached] == []
    assert unseen == []
