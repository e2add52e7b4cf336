"""The example of an extension, installed into an environment of its own: everything it adds is used from outside, by name."""

from __future__ import annotations

import json
import re
import shutil
import subprocess
import sys
import sysconfig
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest

ROOT = Path(__file__).parents[2]
EXAMPLE = ROOT / "examples" / "extension"
SCENE = (
    "scene.cars=[suv]", "scene.occupancy={driver: 1}", "scene.motion={driver: {adjust_hair: 1}}",
    "scene.objects={front_passenger: thermos}",
)  # fmt: skip

Run = Callable[..., str]


def test_the_example_is_small() -> None:
    files = [EXAMPLE / "pyproject.toml", *(EXAMPLE / "cabinpose_example").glob("*.py")]
    assert sum(len(path.read_text("utf-8").splitlines()) for path in files) < 250


@pytest.fixture(scope="session")
def python(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The interpreter of a fresh environment that sees this one's packages, and in which the example alone is installed."""
    folder = tmp_path_factory.mktemp("extension")
    subprocess.run([sys.executable, "-m", "venv", "--without-pip", folder / "env"], check=True)
    found = folder / "env" / "bin" / "python"
    ask = [found, "-c", "import sysconfig; print(sysconfig.get_path('purelib'))"]
    site = Path(subprocess.run(ask, check=True, capture_output=True, text=True).stdout.strip())
    (site / "outer.pth").write_text(f"import site; site.addsitedir({sysconfig.get_path('purelib')!r})\n", encoding="utf-8")
    source = shutil.copytree(EXAMPLE, folder / "source")
    words = ["install", "--quiet", "--no-deps", "--no-index", "--no-build-isolation", str(source)]
    subprocess.run([sys.executable, "-m", "pip", "--python", str(found), *words], check=True)
    return found


@pytest.fixture
def run(python: Path, tmp_path: Path) -> Run:
    """`run("synth", ...)`: what a command prints in that environment, in a folder of the test's own."""

    def command(*words: object) -> str:
        done = subprocess.run(
            [python, "-m", "cabinpose", *map(str, words)], cwd=tmp_path, check=False, capture_output=True, text=True, timeout=600
        )
        assert done.returncode == 0, done.stderr
        return done.stdout

    return command


@pytest.fixture(scope="session")
def dataset(python: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Eight frames with the example's action and thing."""
    out = tmp_path_factory.mktemp("extension") / "dataset"
    subprocess.run([python, "-m", "cabinpose", "synth", "--frames", "8", "--out", out, *SCENE], check=True, capture_output=True)
    return out


@pytest.mark.slow
def test_synth_does_its_action_and_brings_its_thing(run: Run, dataset: Path) -> None:
    told = json.loads(run("info", dataset, "--json"))
    assert told["by_action"] == {"adjust_hair": 8}
    import cabinpose
    from cabinpose.scene import LABEL_ID

    seen = (cabinpose.open(dataset).labels.values == LABEL_ID["bottle"]).any(axis=(1, 2))
    assert seen.sum() >= 4


@pytest.mark.slow
def test_its_sensor_sees_and_its_effect_acts(run: Run, tmp_path: Path) -> None:
    import cabinpose

    words = ("synth", "--frames", "1", "--seed", "2", *SCENE, "camera.sensor=wide_tof")
    run(*words, "--out", "clean")
    run(*words, "noise={kind: physical, effects: [{kind: dust, share: 0.5}]}", "--out", "dusty")
    clean, dusty = (np.isfinite(cabinpose.open(tmp_path / name).depth.values[0]) for name in ("clean", "dusty"))
    assert clean.shape == (120, 160)
    assert not (dusty & ~clean).any()
    assert dusty.sum() / clean.sum() == pytest.approx(0.5, abs=0.03)


@pytest.mark.slow
def test_its_format_is_written_and_read(run: Run, dataset: Path, tmp_path: Path) -> None:
    import cabinpose

    assert "joints" in run("export", "--help")
    run("export", "joints", dataset, "--out", "table", "--digits", "3")
    run("import", "joints", "table/joints.csv", "--out", "again", "--licence", "CC0-1.0")
    before, after = cabinpose.open(dataset), cabinpose.open(tmp_path / "again")
    there = [str(name) for name in after["person"].values]
    theirs = before.joints_3d.sel(person=there).values
    np.testing.assert_allclose(after.joints_3d.values, theirs, atol=6e-4)


@pytest.mark.slow
def test_nothing_joins_the_defaults(run: Run, tmp_path: Path) -> None:
    """A dataset that names nothing of the extension's has the bytes that it has without it."""
    words = ["synth", "--frames", "3", "--seed", "4", "--workers", "1", "--out"]
    run(*words, "with")
    subprocess.run([sys.executable, "-m", "cabinpose", *words, "without"], cwd=tmp_path, check=True, capture_output=True)
    made = [
        {p.relative_to(tmp_path / name): p.read_bytes() for p in (tmp_path / name).rglob("*") if p.is_file()}
        for name in ("with", "without")
    ]
    assert made[0] == made[1] != {}


@pytest.mark.slow
def test_its_detector_is_trained_and_judged_by_its_metric(run: Run, dataset: Path, tmp_path: Path) -> None:
    (tmp_path / "run.yaml").write_text("method: mean\nsettings: {slots: [driver]}\n", encoding="utf-8")
    run("train", dataset, "--config", "run.yaml", "--out", "run")
    run("predict", dataset, "--model", "run/best.npz", "--out", "found.jsonl")
    run("evaluate", dataset, "--model", "run/best.npz", "--persons", "driver", "--resamples", "20", "--out", "report")
    told = json.loads((tmp_path / "report" / "report.json").read_text("utf-8"))
    from cabinpose.store import read_predictions

    found = read_predictions(tmp_path / "found.jsonl")
    assert np.isfinite(found.joints_3d).any()
    assert "median error of hands" in json.dumps(told)
    assert "median error of hands" in (tmp_path / "report" / "index.html").read_text("utf-8")


@pytest.mark.slow
def test_its_source_is_recorded_and_watched_live(run: Run, dataset: Path, tmp_path: Path) -> None:
    (tmp_path / "rig.yaml").write_text("sources:\n  wall: {kind: board, distance_m: 1.2}\n", encoding="utf-8")
    run("record", "--config", "rig.yaml", "--out", "take.mcap", "--duration", "0.5")
    import cabinpose

    (frame, *_) = (m for _, sample in cabinpose.open(tmp_path / "take.mcap").samples(["wall"]) for m in sample.messages)
    np.testing.assert_allclose(frame.depth_m(), 1.2, atol=1e-3)
    *_, last = run(
        "live", "--source", "board", "--set", "distance_m=0.8", "--model", "in_car", "--frames", "2", "--json"
    ).splitlines()
    assert json.loads(last)["summary"]["frames"] == 2


@pytest.mark.slow
def test_the_studio_has_all_of_it(python: Path, tmp_path: Path) -> None:
    """A scene with its action, thing, sensor and effect is shown; its camera is chosen, and a model runs on it."""
    if shutil.which("chromium") is None:
        pytest.skip("needs Chromium: apt-get install chromium")
    pytest.importorskip("nicegui", reason="needs the extra `studio`")
    pytest.importorskip("playwright.sync_api", reason="needs playwright")
    from benchmarks.studio import choose, page_of, studio

    (tmp_path / "scene.yaml").write_text(
        "scene:\n  cars: [suv]\n  occupancy: {driver: 1}\n  motion: {driver: {adjust_hair: 1}}\n"
        "  objects: {front_passenger: thermos}\n"
        "camera: {sensor: wide_tof}\nnoise: {kind: physical, effects: [{kind: dust}]}\n",
        encoding="utf-8",
    )

    def look() -> None:
        with studio(tmp_path / "scene.yaml", python=str(python)) as address, page_of(1280, 800) as page:
            page.goto(address)
            page.get_by_text("holds: nothing collides").wait_for()
            page.screenshot(path=tmp_path / "scene.png")
            page.get_by_role("tab", name="Live").click()
            choose(page, "source", "board")
            page.get_by_role("button", name="Start").click()
            page.get_by_text(re.compile(r"^in_car: [\d.]+ ms")).wait_for()
            page.screenshot(path=tmp_path / "live.png")

    with ThreadPoolExecutor(1) as thread:  # where other tests of this process have a browser open, a loop runs in its own
        thread.submit(look).result()
