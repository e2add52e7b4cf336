"""An exported model is refused where it answers anything else than the network that it was made of."""

from __future__ import annotations

from pathlib import Path
from typing import Any

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
