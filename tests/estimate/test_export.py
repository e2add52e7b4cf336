"""An exported model is refused where it answers anything else than the network that it was made of."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import onnx
import onnxruntime
import pytest

from cabinpose.core.errors import ModelError
from cabinpose.estimate import export


@pytest.mark.parametrize(("factor", "offset", "refused"), [(1 + 2e-5, 0.0, False), (1 + 4e-4, 0.0, True), (1.0, 2e-2, True)])
def test_large_values_are_compared_by_their_share(
    checkpoints: dict[str, Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, factor: float, offset: float, refused: bool
) -> None:
    class Drifting:
        """ONNX Runtime's answers, a little off."""

        def __init__(self, path: Path) -> None:
            self.session = open_session(path)

        def run(self, *arguments: Any) -> list[Any]:
            return [answer * factor + offset for answer in self.session.run(*arguments)]

    open_session = export.open_session
    monkeypatch.setattr(export, "open_session", Drifting)
    out = tmp_path / "model.onnx"
    if refused:
        with pytest.raises(ModelError, match="differs from torch"):
            export.export_onnx(checkpoints["compact"], out, name="drifting", card={})
        assert not out.exists()
    else:
        assert export.export_onnx(checkpoints["compact"], out, name="drifting", card={}) < export.TOLERANCE


@pytest.mark.parametrize("method", ["compact", "paf"])
def test_what_depends_on_no_input_is_worked_out_and_no_answer_changes(
    checkpoints: dict[str, Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, method: str
) -> None:
    files = tmp_path / "folded.onnx", tmp_path / "plain.onnx"
    export.export_onnx(checkpoints[method], files[0], name=method, card={})
    monkeypatch.setattr(export, "folded", lambda model: model)
    export.export_onnx(checkpoints[method], files[1], name=method, card={})
    graphs = [onnx.load(file).graph for file in files]
    assert len(graphs[0].node) <= len(graphs[1].node)
    assert {array.name for array in graphs[0].initializer} <= {array.name for array in graphs[1].initializer}
    sessions = [onnxruntime.InferenceSession(file, providers=["CPUExecutionProvider"]) for file in files]
    rng = np.random.default_rng(3)
    seen = {
        each.name: rng.uniform(0.3, 2.0, [n if isinstance(n, int) else 2 for n in each.shape]).astype(np.float32)
        for each in sessions[0].get_inputs()
    }
    for one, other in zip(*(session.run(None, seen) for session in sessions), strict=True):
        assert one.tobytes() == other.tobytes()
