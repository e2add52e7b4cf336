"""What can be chosen as a model in the tabs: packaged ones, and predictions files that are open."""

from __future__ import annotations

from cabinpose.app.studio.workspace import Workspace
from cabinpose.core.ports import Predictor
from cabinpose.estimate.onnx_model import packaged_models
from cabinpose.estimate.remote import open_predictor
from cabinpose.store.predictions import Predictions

_FILE = "file:"


def choices(workspace: Workspace) -> dict[str, str]:
    """Values and words of a select; "" is nothing."""
    files = {_FILE + name: f"{name} (predictions)" for name in workspace.predictions}
    return {"": "nothing", **files, **{name: name for name in detectors()}}


def first_choice(workspace: Workspace) -> str:
    """The value of `choices` that labelling begins with."""
    return _FILE + workspace.proposals if workspace.proposals else ""


def detectors() -> list[str]:
    """Names of the packaged models."""
    return list(packaged_models())


def load_choice(workspace: Workspace, value: str) -> Predictor | Predictions | None:
    """What a value of `choices` stands for. Raises ModelError."""
    if not value:
        return None
    if value.startswith(_FILE):
        return workspace.predictions[value.removeprefix(_FILE)]
    return open_predictor(value)
