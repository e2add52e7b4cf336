"""Detectors in other processes, asked by the Open Inference Protocol v2 over gRPC. Needs the extra `remote`."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from cabinpose.core import optional_module
from cabinpose.estimate.joint_predictor import JointPredictor
from cabinpose.estimate.predictor import load_model

if TYPE_CHECKING:
    from cabinpose.estimate.remote.client import RemotePredictor

SCHEME = "grpc://"


def open_predictor(model: str | Path, images: Sequence[str] = ()) -> JointPredictor | RemotePredictor:
    """What `--model` names: a packaged model, the model in an ONNX or .npz file, or one on a server (grpc://HOST:PORT/MODEL).

    Parameters
    ----------
    model
        A name, a file, or an address.
    images
        The images that a model on a server is given; our own models read what they were made for.

    Raises
    ------
    ModelError
        For a file that is no model.
    ConfigError, RemoteError
        For an address that is none, and a server that has no such model.
    DependencyError
        For a server, without the extra `remote`.
    """
    if not str(model).startswith(SCHEME):
        return load_model(model)
    need_protocol()
    from cabinpose.estimate.remote.client import RemotePredictor  # noqa: PLC0415 - an extra

    return RemotePredictor(str(model), images)


def need_protocol() -> None:
    """Raises DependencyError where the extra `remote` is not installed."""
    optional_module("tritonclient.grpc", purpose="a model on a server", hint="pip install 'cabinpose[remote]'")
