"""The Scene tab in a browser, done as a person does it."""

from __future__ import annotations

import json
import re
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from cabinpose.store import open_dataset
from cabinpose.synth import SceneSampler, SynthConfig, frame_rng

_RECORDER = """
window.drawn = [];
const put = OffscreenCanvasRenderingContext2D.prototype.putImageData;
OffscreenCanvasRenderingContext2D.prototype.putImageData = function (image, ...rest) {
  put.call(this, image, ...rest);
  let sum = 0;
  for (let i = 0; i < image.data.length; i += 4) sum = (sum * 31 + image.data[i]) % 1000000007;
  window.drawn.push(sum);
};
"""  # what the canvases show, as check sums
PANES = 3


@pytest.fixture
def scene(tmp_path: Path) -> Path:
    path = tmp_path / "mine.yaml"
    path.write_text("scene:\n  cars: [suv]\n  occupants: {driver: {subject: S03}}\n")
    return path


@pytest.fixture
def studio(page: Any, start: Callable[..., Any], scene: Path) -> Any:
    """The page of a studio that shows the scene."""
    page.add_init_script(_RECORDER)
    page.goto(start(scene).address)
    page.get_by_text("holds: nothing collides").wait_for()
    page.wait_for_function(f"drawn.length >= {PANES}")
    return page


def last_images(page: Any) -> list[int]:
    """The check sums of what the panes show, once nothing more is drawn."""
    count = -1
    while count != (count := page.evaluate("drawn.length")):
        page.wait_for_timeout(700)
    return sorted(page.evaluate(f"drawn.slice(-{PANES})"))


def after(page: Any, act: Callable[[], Any]) -> list[int]:
    """What the panes show once something that was done has been drawn."""
    count = page.evaluate("drawn.length")
    act()
    page.wait_for_function(f"drawn.length >= {count + PANES}")
    return last_images(page)


def press(page: Any, name: str) -> Callable[[], Any]:
    return lambda: page.get_by_role("button", name=name).click()


def find(page: Any, words: str) -> Any:
    page.get_by_placeholder("find a key").fill(words)
    field = page.get_by_label(re.compile(rf"^{re.escape(words)}( ·|$)"))
    field.wait_for()
    return field


@pytest.mark.slow
def test_change_undo_save_and_open(studio: Any, scene: Path) -> None:
    before = last_images(studio)
    field = find(studio, "noise.blur")
    field.fill("")
    changed = after(studio, lambda: field.press_sequentially("0,25"))
    assert field.input_value() == "0.25"
    assert changed != before
    studio.wait_for_timeout(1200)  # what follows is another step of undo
    assert after(studio, lambda: field.fill("3")) == changed  # the last valid one stays
    studio.get_by_role("status").get_by_text("noise.blur: must be less than or equal to 0.25").wait_for()
    assert after(studio, press(studio, "Undo")) == changed
    studio.get_by_text("holds: nothing collides").wait_for()
    assert after(studio, press(studio, "Undo")) == before
    assert after(studio, press(studio, "Redo")) == changed
    kept = after(studio, lambda: find(studio, "noise.blur").fill("0.2"))
    studio.get_by_role("button", name="Save").click()
    name_field = studio.get_by_label("file name")
    name_field.fill("../other.yaml")
    studio.get_by_role("button", name="Save it").click()
    studio.get_by_text("is no name in").wait_for()
    name_field.fill("mine.yaml")
    studio.get_by_role("button", name="Save it").click()
    studio.get_by_text("mine.yaml exists").wait_for()
    studio.get_by_text("overwrite it", exact=True).click()
    (scene.parent / "taken.yaml").write_text("scene: {}\n")
    name_field.fill("taken.yaml")  # which nobody said to overwrite
    studio.get_by_role("button", name="Save it").click()
    studio.get_by_text("taken.yaml exists").wait_for()
    assert (scene.parent / "taken.yaml").read_text() == "scene: {}\n"
    name_field.fill("other.yaml")
    studio.get_by_role("button", name="Save it").click()
    studio.get_by_text("saved other.yaml").wait_for()
    saved = yaml.safe_load((scene.parent / "other.yaml").read_text())
    assert saved["noise"]["blur"] == 0.2
    for name, expected in (("mine.yaml", before), ("other.yaml", kept)):
        studio.get_by_role("button", name="Open").click()
        assert after(studio, press(studio, name)) == expected


@pytest.mark.slow
def test_dimensions_of_a_preset_are_changed(studio: Any, scene: Path) -> None:
    """A preset is made a car of one's own, which is the same; one that is wider is not; the cross makes it the same again."""
    before = last_images(studio)
    studio.get_by_label("change the dimensions of").click()
    assert after(studio, studio.get_by_role("option", name="suv").click) == before
    studio.get_by_text("my_suv · dimensions").wait_for()
    field = find(studio, "scene.cars.0.w3_mm")
    assert field.input_value() == "1490"
    assert after(studio, lambda: field.fill("1700")) != before
    studio.get_by_placeholder("find a key").fill("shoulder room door")
    assert after(studio, studio.get_by_role("button", name="as in the preset").click) == before
    scene.write_text("# a note\n" + scene.read_text())
    studio.get_by_role("button", name="Save").click()
    studio.get_by_role("button", name="Save it").click()
    studio.get_by_text("mine.yaml exists").wait_for()
    studio.get_by_text("Its comments, and the order").wait_for()


@pytest.mark.slow
def test_accept_and_move_a_joint_until_it_collides(studio: Any) -> None:
    before = last_images(studio)
    drawn = after(studio, press(studio, "Sample"))
    assert drawn != before
    assert after(studio, press(studio, "Accept")) == drawn
    studio.get_by_role("tab", name="People").click()
    studio.get_by_text("driver: S03").click()
    row = studio.get_by_text("right elbow flexion", exact=True).locator("xpath=..")
    slider = row.locator(".q-slider")
    slider.scroll_into_view_if_needed()
    box = slider.bounding_box()
    slider.click(position={"x": box["width"] - 1, "y": box["height"] / 2})  # once it stands still
    row.get_by_text(re.compile(r"1(4[5-9]|50)\.\d °")).wait_for()
    studio.get_by_role("status").get_by_text(re.compile(r"driver: .* in .* mm deep at")).wait_for()
    studio.get_by_role("button", name="Undo").click()
    studio.get_by_text("holds: nothing collides").wait_for()


@pytest.mark.slow
def test_work_is_there_after_a_reload(studio: Any) -> None:
    field = find(studio, "noise.blur")
    changed = after(studio, lambda: field.fill("0.25"))
    studio.reload()
    studio.get_by_text("holds: nothing collides").wait_for()
    studio.wait_for_function(f"drawn.length >= {PANES}")
    assert last_images(studio) == changed
    assert find(studio, "noise.blur").input_value() == "0.25"


@pytest.mark.slow
def test_camera_is_dragged(studio: Any) -> None:
    """The camera's sphere is taken where it is on the screen, and let go elsewhere."""
    before = after(studio, press(studio, "Accept"))
    place = studio.evaluate("""() => {
      const element = [...document.querySelectorAll('.nicegui-scene')][0];
      const view = getElement(element.id.slice(1));
      const mesh = [...view.objects.values()].map((o) => o.mesh || o).find((m) => m.name === 'camera');
      const at = mesh.position.clone().project(view.camera), box = element.querySelector('canvas').getBoundingClientRect();
      return [box.left + (at.x + 1) / 2 * box.width, box.top + (1 - at.y) / 2 * box.height];
    }""")
    studio.mouse.move(*place)
    studio.wait_for_timeout(300)
    studio.mouse.down()
    studio.mouse.move(place[0] + 30, place[1] - 10, steps=6)
    assert after(studio, studio.mouse.up) != before
    assert find(studio, "camera.jitter_m").input_value() == "0"


@pytest.mark.slow
def test_3d_view_is_drawn_only_when_it_changes(studio: Any) -> None:
    studio.evaluate("""() => {
      window.views = 0;
      const draw = WebGL2RenderingContext.prototype.drawElements;
      WebGL2RenderingContext.prototype.drawElements = function (...all) { views++; draw.apply(this, all); };
    }""")
    after(studio, press(studio, "Sample"))
    studio.wait_for_function("views > 0")
    counts = []
    for _ in range(10):  # until all that follows the change is there
        counts.append(studio.evaluate("views"))
        studio.wait_for_timeout(1000)
    count = counts[-1]
    assert studio.evaluate("views") == count == counts[-2]
    box = studio.locator(".nicegui-scene canvas").first.bounding_box()
    studio.mouse.move(box["x"] + box["width"] / 4, box["y"] + box["height"] / 8)
    studio.mouse.wheel(0, 200)
    studio.wait_for_function(f"views > {count}")
    studio.wait_for_timeout(1000)
    count = studio.evaluate("views")
    studio.evaluate("""() => {  // other points of the same shape, as those of a live cloud
      const scene = getElement(document.querySelector('.nicegui-scene').id.slice(1)).scene, meshes = [];
      scene.traverse((o) => o.isMesh && meshes.push(o));
      const { geometry } = meshes[0];
      geometry.setAttribute("position", geometry.attributes.position.clone());
    }""")
    studio.wait_for_function(f"views > {count}")


@pytest.mark.slow
def test_small_bench_has_every_figure(browser: Any) -> None:
    assert browser.is_connected()
    flags = ["--changes", "2", "--frames", "1", "--scrolled", "5", "--json"]
    command = [sys.executable, "-m", "cabinpose", "bench", "studio", *flags]
    done = subprocess.run(command, check=False, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    figures = json.loads(done.stdout)
    preview, labelling = figures["preview"], figures["labelling"]
    assert 0 < preview["server_ms"]["median"] < preview["pictures_ms"]["median"] <= preview["pictures_ms"]["p95"]
    assert 0 < labelling["drags_per_frame"] < 14
    assert labelling["keystroke_level_s_per_frame"] == pytest.approx(1.63 + 3.75 * labelling["drags_per_frame"])
    scrolling = figures["scrolling"]
    assert scrolling["skipped"] == 0
    assert 0 < scrolling["shown_ms"]["median"] <= scrolling["shown_ms"]["p95"]
    assert 100 < scrolling["kilobytes"] < 1000


@pytest.mark.slow
def test_generate_and_cancel(studio: Any, scene: Path) -> None:
    def generate(folder: str, frames: int) -> None:
        studio.get_by_role("button", name="Generate").click()
        studio.get_by_label("folder").fill(folder)
        studio.get_by_label("frames").fill(str(frames))
        studio.get_by_role("button", name="Start").click()

    generate("three", 3)
    studio.get_by_text("3 frames in three").wait_for()
    assert open_dataset(scene.parent / "three").sizes["frame"] == 3
    generate("many", 5000)
    studio.get_by_text(re.compile(r"posing: [1-9]\d* of 5000")).wait_for()
    studio.get_by_role("button", name="Cancel").click()
    studio.get_by_text("cancelled").wait_for()
    time.sleep(0.5)
    assert not list((scene.parent / "many").glob("part-00049*"))


@pytest.mark.slow
def test_new_scene_is_begun(page: Any, start: Callable[..., Any]) -> None:
    page.goto(start().address)
    page.get_by_role("tab", name="Scene").click()
    page.get_by_role("button", name="Begin a new one here").click()
    page.get_by_text("holds: nothing collides").wait_for()


# ----------------------------------------------------------------------------------------------------- by keys alone


@pytest.fixture
def three(page: Any, start: Callable[..., Any], tmp_path: Path) -> Iterator[Any]:
    """The page of a studio with three people, a child seat and things in hands; what the console says fails the test."""
    path = tmp_path / "three.yaml"
    path.write_text(
        "# seed 5, frame 0\nscene:\n  cars: [{preset: suv, name: mine}]\n  occupancy: {}\n  child_seats: {rear_left: infant}\n"
        "  in_hand: 1.0\n  occupants:\n    driver: {subject: S03}\n    front_passenger: {subject: S05, action: phone_text}\n"
        "    rear_right: {subject: S11, action: drink}\n"
    )
    said: list[str] = []
    page.on("console", lambda message: said.append(message.text) if message.type in ("error", "warning") else None)
    page.on("request", lambda asked: said.append(asked.url) if "127.0.0.1" not in asked.url and "http" in asked.url else None)
    page.on("response", lambda answer: said.append(f"{answer.status} {answer.url}") if answer.status >= 400 else None)
    page.add_init_script(_RECORDER)
    page.goto(start(path).address)
    page.get_by_text("holds: nothing collides").wait_for()
    page.wait_for_function(f"drawn.length >= {PANES}")
    yield page
    assert [words for words in said if "GPU stall" not in words] == []


def tab_to(page: Any, what: str, *, back: bool = False) -> None:
    """Press Tab until what has the keyboard is, or is in, what a selector finds."""
    for _ in range(150):
        page.keyboard.press("Shift+Tab" if back else "Tab")
        if page.evaluate("what => !!document.activeElement.closest(what)", what):
            return
    pytest.fail(f"Tab does not reach {what}")


def bodies(page: Any) -> dict[str, Any]:
    """What the 3D view shows: the scene's number, and by name the corners of triangles of each body, as its shader takes them."""
    return page.evaluate("""() => {
      const view = getElement(document.querySelector('.nicegui-scene').id.slice(1));
      const shown = [...view.objects.values()].map((o) => o.component).find((c) => c?.bodies);
      const result = {};
      for (const [name, { object, geometries: [fine] }] of shown.bodies) {
        object.updateMatrixWorld();
        const at = fine.attributes.position, corner = object.position.clone(), sum = [0, 0, 0], index = fine.index;
        for (let i = 0; i < index.count; i++)
          object.localToWorld(corner.fromBufferAttribute(at, index.getX(i))).toArray().forEach((x, k) => { sum[k] += x; });
        result[name] = [index.count, ...sum.map((x) => x / index.count)];
      }
      return { number: shown.mesh.userData.number, bodies: result };
    }""")


def expected(path: Path, seed: int = 5) -> dict[str, list[float]]:
    """The same of what the generator makes of a file."""
    scene = SceneSampler(SynthConfig.load(path), seed).sample(0, rng=frame_rng(seed, 0))
    parts = {"cabin": [scene.backdrop], **{person.slot: person.surfaces for person in scene.people}}
    parts |= {f"{thing.thing.kind}:{thing.slot}:{i}": [thing.surface(0)] for i, thing in enumerate(scene.things)}
    corners = {name: np.concatenate([s.vertices[s.faces.ravel()] for s in surfaces]) for name, surfaces in parts.items()}
    return {name: [len(each), *each.mean(axis=0, dtype=np.float64).tolist()] for name, each in corners.items()}


@pytest.mark.slow
def test_child_seat_is_changed_saved_and_opened_by_keys_alone(three: Any, tmp_path: Path) -> None:
    before = last_images(three)
    shown = bodies(three)["bodies"]
    assert {name: pytest.approx(body, abs=1e-4) for name, body in expected(tmp_path / "three.yaml").items()} == shown
    three.keyboard.press("/")
    three.keyboard.type("child_seats.rear_left")
    three.wait_for_timeout(800)
    tab_to(three, "[data-key='scene.child_seats.rear_left']")
    three.keyboard.press("Enter")  # opens the group
    tab_to(three, "[data-key='scene.child_seats.rear_left'] [role=combobox][aria-label='rear left']")
    changed = after(
        three, lambda: [three.keyboard.press("Control+a"), three.keyboard.type("booster"), three.keyboard.press("Enter")]
    )
    assert changed != before
    now = bodies(three)["bodies"]
    assert "booster:rear_left:0" in now
    three.keyboard.press("Control+s")
    three.get_by_label("file name").wait_for()
    three.wait_for_timeout(300)
    three.keyboard.press("Control+a")
    three.keyboard.type("four.yaml")
    three.keyboard.press("Enter")
    three.get_by_text("saved four.yaml").wait_for()
    three.keyboard.press("Control+o")  # at once: the dialog still fades
    three.get_by_text("Configurations in").wait_for()
    three.keyboard.press("Escape")
    three.get_by_text("Configurations in").wait_for(state="hidden")
    assert yaml.safe_load((tmp_path / "four.yaml").read_text())["scene"]["child_seats"] == {"rear_left": "booster"}
    assert {name: pytest.approx(body, abs=1e-4) for name, body in expected(tmp_path / "four.yaml").items()} == now
    for name, images in (("three.yaml", before), ("four.yaml", changed)):
        three.keyboard.press("Control+o")
        three.get_by_text("Configurations in").wait_for()
        three.wait_for_timeout(500)
        for _ in range(3):
            if three.evaluate("document.activeElement.innerText.trim()") == name:
                break
            three.keyboard.press("Tab")
        assert after(three, lambda: three.keyboard.press("Enter")) == images


@pytest.mark.slow
def test_joint_is_moved_and_undone_by_keys_alone(three: Any) -> None:
    """Accept says what it lets go; sliders go to their ends; undo leaves groups, place and keyboard where they are."""
    three.keyboard.press("a")
    three.get_by_text("scene.in_hand: 1.0").wait_for()
    three.wait_for_timeout(400)
    three.keyboard.press("Enter")
    three.get_by_text("Accept writes").wait_for(state="hidden")
    three.wait_for_timeout(1000)
    tab_to(three, ".studio-side [role=tab]")
    three.keyboard.press("ArrowRight")
    three.keyboard.press("Enter")
    three.get_by_text("driver: S03").wait_for()
    three.wait_for_timeout(500)  # the panel has slid in
    tab_to(three, ".studio-group .q-item")
    three.keyboard.press("Enter")
    three.locator("[data-axis='driver relbow.flexion']").wait_for()
    tab_to(three, "[data-axis='driver relbow.flexion']")
    words = three.get_by_text("right elbow flexion", exact=True).locator("xpath=..")
    start = words.inner_text()
    at = last_images(three)
    moved = after(three, lambda: three.keyboard.press("Shift+ArrowRight"))
    assert moved != at
    assert after(three, lambda: three.keyboard.press("End")) != moved
    words.get_by_text("150.0 °").wait_for()
    three.locator(".studio-conflicts button").first.wait_for()
    for images in (moved, at):
        assert after(three, lambda: three.keyboard.press("Control+z")) == images
    assert words.inner_text() == start
    assert three.evaluate("!!document.activeElement.closest(\"[data-axis='driver relbow.flexion']\")")
    assert three.locator(".studio-conflicts button").count() == 0
