"""`cabinpose studio`: configure, look, label, compare and run detectors live, in the browser."""

from __future__ import annotations

import gc
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from tyro.conf import Positional

from cabinpose.app.api import SAMPLE
from cabinpose.app.cli.arguments import DatasetPath, Maybe, several
from cabinpose.core import ConfigError


@dataclass(frozen=True, kw_only=True)
class Studio:
    """Configure scenes, look at data, label, compare models and run them live, in the browser.

    Serves on this machine alone, unless --host and --token say otherwise. Ctrl-C ends it.
    """

    thing: Annotated[Positional[DatasetPath | None], several("[DATASET|RECORDING|SCENE.yaml]")] = None
    """What to open: the folder of a dataset, a recording (.mcap) or a scene (.yaml)."""
    predictions: Annotated[tuple[Path, ...], several("FILE [FILE ...]")] = ()
    """Predictions files of the dataset to compare."""
    labels: Maybe[Path] = None
    """Journal of the labels; default: DATASET.labels.jsonl beside the dataset, of `sample` in the current folder."""
    role: str = "annotator"
    """Who labels, as the journal shall say: annotator, reviewer, or any other word."""
    host: str = "127.0.0.1"
    """Address to serve on; another than this machine's own needs --token."""
    port: int = 8570
    """Port to serve on; 0 takes a free one."""
    token: Maybe[str] = None
    """Word that a browser has to bring; needed for --host beyond this machine."""


COMMAND = Studio


def run(command: Studio) -> None:
    """Open what was named and serve until Ctrl-C."""
    from cabinpose.app.extras import require

    require("studio", "record")
    gc.disable()  # imports and datasets stay: searching them for garbage is a fifth of the time until a page can be opened
    from cabinpose.app.studio.serve import serve
    from cabinpose.app.studio.workspace import open_workspace

    labels = command.labels
    if labels is None and command.thing == SAMPLE:
        labels = Path("sample.labels.jsonl")  # the package itself is not written to
    workspace = open_workspace(command.thing, labels=labels, role=command.role)
    for flag, given in (("--predictions", command.predictions), ("--labels", command.labels)):
        if given and workspace.dataset is None:
            raise ConfigError(f"{flag} is of a dataset, and none is opened", hint=f"name the dataset, or leave out {flag}")
    for path in command.predictions:
        workspace.add_predictions(path)
    gc.freeze()
    gc.enable()
    serve(workspace, host=command.host, port=command.port, token=command.token, ready=_ready)


def _ready(address: str) -> None:
    print(address)
    print("open it in a browser; Ctrl-C ends the studio", file=sys.stderr)
