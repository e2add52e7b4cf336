"""Simulated frames beside those of real ToF cameras: the table of docs/real-cameras.md."""

from __future__ import annotations

import importlib.util
from collections.abc import Callable
from pathlib import Path
from types import ModuleType

import pytest

ROOT = Path(__file__).resolve().parents[2]
PAGE = ROOT / "docs" / "real-cameras.md"


@pytest.fixture(scope="module")
def tool() -> ModuleType:
    spec = importlib.util.spec_from_file_location("real_tof", ROOT / "tools" / "real_tof.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def explained() -> set[str]:
    """The statistics that the page explains: those below its heading of what differs, in bold."""
    text = PAGE.read_text(encoding="utf-8").partition("## What differs")[2]
    return {" ".join(part.split()) for part in text.split("**")[1::2]}


@pytest.mark.real_data
@pytest.mark.parametrize(
    ("camera", "file"),
    [
        ("raw_continuous_wave", "tof/raw_cw_60mhz.npz"),
        ("kinect_v2", "tof/kinect_v2_panoptic.npz"),
        ("azure_kinect", "tof/azure_kinect.mkv"),
    ],
)
def test_within_a_quarter_or_explained(camera: str, file: str, tool: ModuleType, real_data: Callable[[str], Path]) -> None:
    if camera == "azure_kinect":
        pytest.importorskip("av")
    found = getattr(tool, camera)(real_data(file).parents[1])
    rows = found[0] if isinstance(found, tuple) else list(found)
    assert len(rows) > 3
    page = PAGE.read_text(encoding="utf-8")
    beyond = {what for what, theirs, ours in rows if not 0.75 <= ours / theirs <= 1.25}
    assert beyond <= explained(), "these differ by more than 25 % and the page does not explain them"
    table = {cells[1].strip(): cells[2:4] for line in page.splitlines() if len(cells := line.split("|")) == 6}
    for what, theirs, ours in rows:
        assert [float(cell) for cell in table[what]] == pytest.approx([theirs, ours], rel=0.03), what


@pytest.mark.real_data
def test_the_four_phases_decode_to_the_cameras_own_distance(
    tool: ModuleType, real_data: Callable[[str], Path], capsys: pytest.CaptureFixture[str]
) -> None:
    """Tap order C90 - C270: what is left is wiggling. The other order is wrong by the depth of the scene."""
    list(tool.raw_continuous_wave(real_data("tof/raw_cw_60mhz.npz").parents[1]))
    words = capsys.readouterr().out.replace(",", "").split()
    right, wrong = (float(words[i - 1]) for i, word in enumerate(words) if word == "mm")
    assert right < 12 < 100 < wrong
    assert float(words[words.index("correlation") + 1]) > 0.95
