"""The contact sheet and the page: right pixels in the right place, one file, no network, a script that runs."""

from __future__ import annotations

import base64
import json
import re
import shutil
import subprocess
import zlib
from collections.abc import Callable
from pathlib import Path
from types import ModuleType

import cv2
import numpy as np
import pytest

from cabinpose.app.cli import view
from cabinpose.app.view.draw import (
    INVALID,
    VISIBILITY_COLOUR,
    amplitude_image,
    colour_map,
    depth_image,
    draw_skeleton,
    orthographic,
)
from cabinpose.app.view.page import page_data, page_html
from cabinpose.app.view.sheet import contact_sheet
from cabinpose.app.view.summary import spread
from cabinpose.core.pose import Visibility
from cabinpose.store import open_dataset, read_manifest

Run = Callable[..., "tuple[int, str, str]"]


def test_an_error_leaves_no_folder(run: Run, dataset_folder: Path, tmp_path: Path) -> None:
    folder = tmp_path / "damaged"
    shutil.copytree(dataset_folder, folder)
    for chunk in folder.glob("part-*.zarr/depth/c/0/0/0"):
        data = chunk.read_bytes()
        chunk.write_bytes(data[:40] + bytes([data[40] ^ 1]) + data[41:])
    code, _, err = run("view", folder, "--out", tmp_path / "view")
    assert (code, "is damaged: cannot read depth" in err) == (2, True)
    assert not (tmp_path / "view").exists()
    (tmp_path / "view").mkdir()
    assert run("view", folder, "--out", tmp_path / "view")[0] == 2
    assert (tmp_path / "view").is_dir()


@pytest.fixture
def pages(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> list[str]:
    """The addresses that the browser is asked to open; temporary folders are made in one of the test's own."""
    opened: list[str] = []
    monkeypatch.setattr(view.webbrowser, "open", lambda address: opened.append(address) or True)
    monkeypatch.setenv("DISPLAY", ":0")
    monkeypatch.setattr(view.tempfile, "tempdir", str(tmp_path))
    return opened


def test_without_a_folder_the_page_is_opened(
    run: Run, dataset_folder: Path, pages: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    few = ("--frames", "1", "--rows", "1")
    code, out, err = run("view", dataset_folder, *few)
    sheet, page = map(Path, out.split())
    assert (code, pages, err) == (0, [page.as_uri()], "")
    assert "<html" in page.read_text("utf-8")
    assert sheet.read_bytes()[1:4] == b"PNG"
    for flags in ("--no-open", "--json"):
        assert run("view", dataset_folder, *few, flags)[0] == 0
    monkeypatch.delenv("DISPLAY")
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    monkeypatch.setattr(view.sys, "platform", "linux")
    assert "no browser was found here" in run("view", dataset_folder, *few)[2]
    assert len(pages) == 1


def test_an_error_without_a_folder_leaves_none(run: Run, tmp_path: Path, pages: list[str]) -> None:
    assert run("view", tmp_path / "nothing")[0] == 2
    assert (list(tmp_path.glob("cabinpose-view-*")), pages) == ([], [])


def test_depth_colours_grow_darker_with_distance() -> None:
    depth = np.array([[0.5, 1.0, 1.5, np.nan, 9.0, 0.1]], np.float32)
    image = depth_image(depth, 0.5, 1.5)
    assert image[0, 3].tolist() == list(INVALID)
    lightness = cv2.cvtColor(image, cv2.COLOR_RGB2LAB)[0, :3, 0].astype(int)
    assert lightness[0] > lightness[1] > lightness[2]
    assert image[0, 4].tolist() == image[0, 2].tolist()
    assert image[0, 5].tolist() == image[0, 0].tolist()
    steps = np.diff(cv2.cvtColor(colour_map()[None], cv2.COLOR_RGB2LAB)[0, ::16, 0].astype(int))
    assert (steps < 0).all()  # monotonic in lightness: reads in grey as well


def test_amplitude_gamma() -> None:
    image = amplitude_image(np.array([[0, 250, 1000, 4000]], np.uint16), 1000)
    assert image[0, :, 0].tolist() == [0, 127, 255, 255]


def test_skeleton_joints_lie_on_their_pixels() -> None:
    image = np.zeros((60, 80, 3), np.uint8)
    uv = np.full((20, 2), np.nan, np.float32)
    uv[0], uv[5], uv[7] = (10, 12), (40.0, 30.0), (70, 50)
    visibility = np.zeros(20, np.uint8)
    visibility[[0, 5, 7]] = Visibility.VISIBLE, Visibility.OCCLUDED, Visibility.SELF_OCCLUDED
    draw_skeleton(image, uv, visibility)
    assert tuple(image[12, 10]) == VISIBILITY_COLOUR[Visibility.VISIBLE]
    assert tuple(image[30, 40]) == VISIBILITY_COLOUR[Visibility.OCCLUDED]
    assert tuple(image[50, 70]) == VISIBILITY_COLOUR[Visibility.SELF_OCCLUDED]
    assert image[40, 55].max() > 150  # the forearm between elbow and wrist
    assert image[20:25, 60:].max() == 0


def test_orthographic_puts_the_nearest_on_top() -> None:
    points = np.array([[0.0, 0, 0], [0, 0, 1], [0.5, 0, 0]])
    colours = np.array([[255, 0, 0], [0, 255, 0], [0, 0, 255]], np.uint8)
    box = (np.full(3, -1.0), np.full(3, 1.0))
    image = orthographic(points, colours, np.eye(3), box, (100, 100))
    assert image[50, 50].tolist() == [0, 255, 0]
    assert image[50, 75].tolist() == [0, 0, 255]
    assert image[50, 25].tolist() == [24, 26, 31]


def test_spread() -> None:
    assert spread(5, 9).tolist() == [0, 1, 2, 3, 4]
    assert spread(1000, 3).tolist() == [0, 500, 999]
    assert spread(1, 4).tolist() == [0]


def test_contact_sheet_shows_labels_in_their_colours(spheres: ModuleType, dataset_folder: Path) -> None:
    dataset = open_dataset(dataset_folder)
    sheet = contact_sheet(dataset, np.array([1, 3]), "two frames", lambda _: None)
    labels = spheres.frame(3, spheres.manifest())["labels"]
    colours = np.zeros((256, 3), np.uint8)
    for row in spheres.LABELS:
        colours[row["id"]] = [row["rgb"] >> 16, row["rgb"] >> 8 & 255, row["rgb"] & 255]
    panel = colours[labels].repeat(4, axis=0).repeat(4, axis=1)
    # the second row's label panel is somewhere in the sheet, pixel by pixel
    _, _, (x, y), _ = cv2.minMaxLoc(cv2.matchTemplate(sheet, panel, cv2.TM_SQDIFF))
    np.testing.assert_array_equal(sheet[y : y + panel.shape[0], x : x + panel.shape[1]], panel)


def unpack(text: str) -> np.ndarray:
    return np.frombuffer(zlib.decompress(base64.b64decode(text)), np.uint8)


def test_page_holds_the_frames(spheres: ModuleType, dataset_folder: Path) -> None:
    dataset, manifest = open_dataset(dataset_folder), read_manifest(dataset_folder)
    data = page_data(dataset, manifest, dataset_folder, np.array([0, 4]), lambda _: None)
    html = page_html(data)
    embedded = json.loads(re.search(r'<script id="data" type="application/json">(.*?)</script>', html, re.S).group(1))  # type: ignore[union-attr]
    assert [f["index"] for f in embedded["frames"]] == [0, 4]
    record, want = embedded["frames"][1], spheres.frame(4, spheres.manifest())
    planes = unpack(record["depth"]).reshape(2, 48, 64).astype(int)
    millimetres = planes[0] << 8 | planes[1]
    np.testing.assert_array_equal(millimetres == 0, np.isnan(want["depth"]))
    np.testing.assert_allclose(millimetres / 1000, np.nan_to_num(want["depth"]), atol=0.00056)
    np.testing.assert_array_equal(unpack(record["labels"]).reshape(48, 64), want["labels"])
    np.testing.assert_array_equal(unpack(record["instance"]).reshape(48, 64), want["instance"])
    assert [p["subject"] for p in record["people"]] == [s for s in want["subject"] if s]
    assert embedded["summary"]["frames"] == 5
    rays = np.array(embedded["cameras"][0]["rays"]).reshape(len(embedded["cameras"][0]["vs"]), -1, 2)
    k = spheres.camera_k(64, 48)
    assert rays[0, -1] == pytest.approx([(63 - k[0, 2]) / k[0, 0], -k[1, 2] / k[1, 1]], abs=1e-6)


def test_page_is_one_file_and_fetches_nothing(run: Run, dataset_folder: Path, tmp_path: Path) -> None:
    code, out, _ = run("view", dataset_folder, "--out", tmp_path / "view", "--frames", "3", "--rows", "2", "--json")
    assert code == 0
    paths = json.loads(out)
    assert sorted(p.name for p in (tmp_path / "view").iterdir()) == ["contact_sheet.png", "index.html"]
    assert cv2.imread(paths["contact_sheet"]).shape[0] > 2 * 48
    html = Path(paths["page"]).read_text()
    assert set(re.findall(r"https?://[^\s\"'`]+", html)) == {"http://www.w3.org/2000/svg"}  # a name, not an address
    assert not re.search(
        r"<(link|iframe|object|embed)\b|\bsrc=[\"'](?!data:)|@import|url\(|\bfetch\(|XMLHttpRequest|WebSocket", html
    )
    code, _, err = run("view", dataset_folder, "--out", tmp_path / "view")
    assert code == 2
    assert "already has contact_sheet.png and index.html" in err
    assert run("view", dataset_folder, "--out", tmp_path / "view", "--overwrite", "--frames", "2")[0] == 0


def test_names_cannot_break_out_of_the_page(spheres: ModuleType, tmp_path: Path) -> None:
    hostile = "</script><script>document.title='broken'</script>"
    manifest = spheres.manifest(frames=1)
    with spheres.create_dataset(tmp_path, manifest), spheres.PartWriter(tmp_path, manifest.parts[0], manifest) as part:
        part.append(spheres.frame(0, manifest) | {"car": hostile})
    html = page_html(page_data(open_dataset(tmp_path), manifest, tmp_path, np.array([0]), lambda _: None))
    assert html.count("</script>") == 2
    assert "innerHTML" not in html


@pytest.mark.slow
def test_page_runs_in_a_browser(run: Run, dataset_folder: Path, tmp_path: Path) -> None:
    browser = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
    if browser is None:
        pytest.skip("needs a Chromium to open the page with")
    run("view", dataset_folder, "--out", tmp_path / "view")
    flags = [
        "--headless", "--no-sandbox", "--disable-gpu", "--no-first-run", "--disable-background-networking", "--disable-sync",
        "--disable-component-update", "--disable-quic", f"--user-data-dir={tmp_path / 'profile'}", "--virtual-time-budget=20000",
    ]  # fmt: skip
    page = (tmp_path / "view" / "index.html").as_uri()
    done = subprocess.run([browser, *flags, "--dump-dom", page], check=True, capture_output=True, text=True, timeout=120)
    assert 'data-ready="true"' in done.stdout
    assert "Frame 0" in done.stdout
    assert done.stdout.count('alt="frame ') == 5
