"""The server of the page on algorithms: it is 25 lines, and `evaluate` judges it."""

from __future__ import annotations

import json
import re
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

import cabinpose
from cabinpose.app.cli import main
from cabinpose.estimate.remote import open_predictor

PAGE = Path(__file__).resolve().parents[2] / "docs" / "algorithms.md"
LINES = 25


@pytest.fixture(scope="module")
def address(tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    """The page's server, running on a free port."""
    code = re.search(r"```python\n# nearest\.py\n(.*?)```", PAGE.read_text("utf-8"), re.S)
    assert code is not None
    assert len([line for line in code[1].splitlines() if line.strip()]) <= LINES
    assert "cabinpose." not in code[1].replace('"cabinpose_', "")
    file = tmp_path_factory.mktemp("python") / "nearest.py"
    file.write_text(code[1].replace(":8001", ":0"), "utf-8")
    server = subprocess.Popen([sys.executable, file], stdout=subprocess.PIPE, text=True)
    assert server.stdout is not None
    port = server.stdout.readline().rpartition(" ")[2].strip()
    yield f"grpc://127.0.0.1:{port}/nearest?persons=driver&joints=lhand"
    server.kill()
    server.communicate()


def test_it_finds_the_nearest_point(address: str) -> None:
    ds = cabinpose.sample().isel(frame=slice(3))
    found = open_predictor(address).predict(
        {"depth": ds.depth.values, "camera_k": ds.camera_k.values, "camera_dist": ds.camera_dist.values}
    )
    for depth, k, place in zip(ds.depth.values, ds.camera_k.values, found.joints_3d[:, 0, 0], strict=True):
        u, v, _ = np.rint(k @ place / place[2]).astype(int)
        assert depth[v, u] == np.nanmin(depth) == place[2]
    assert found.presence.tolist() == [[[1.0]]] * 3


def test_evaluate_judges_it(address: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["evaluate", "sample", "--model", address, "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    assert (told["joints"], told["frames"]) == (["lhand"], 20)
    assert max(value["samples"] for value in told["models"][0]["values"] if value["metric"] == "PCK") > 0
