"""The thesis' Table 6.1 on one's own data: methods trained alike, run on the same frames, judged by the same equations.

What a step leaves in the folder is not made again: a model of the same recipe and training data, and what a model file found
in a test.
"""

from __future__ import annotations

import hashlib
import json
import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from cabinpose.app.report.raster import write_curves
from cabinpose.app.training import stored_frames
from cabinpose.app.training_split import training_split
from cabinpose.core import (
    ITOP,
    ConfigError,
    DatasetError,
    FrameBatch,
    make_folder,
    read_arrays,
    whole_file,
    write_whole,
)
from cabinpose.estimate import METHODS, as_configured, load_model, read_train_config
from cabinpose.evaluate import BATCH, EvaluationOptions, Report, evaluate_itop, frame_batch
from cabinpose.store import (
    MANIFEST_NAME,
    ItopReference,
    as_labelled,
    dataset_id,
    import_source,
    open_dataset,
    read_itop_frames,
    read_itop_reference,
    read_manifest,
)
from cabinpose.store.convert import open_source

if TYPE_CHECKING:
    from cabinpose.estimate import TrainConfig

# The settings of every method that has them: a person in a room as the packaged model `room` sees it. See `Method.room`.
_ROOM = MappingProxyType(
    {
        "width": 96, "height": 96, "focal": 114.3, "max_depth_m": 6.0, "slots": ["standing"], "skeleton": "itop", "body": "itop",
        "amplitude": False,
    }
)  # fmt: skip
_RUN = MappingProxyType(
    {
        "augment": {"shift": 0.6, "shift_m": 0.15, "rotate_deg": 4.0, "noise_m": 0.012, "lost": 0.04, "occluder": 0.1},
        "epochs": 20, "average": 0.99,  # shorter than that of long runs
    }
)  # fmt: skip
_TIMED = 64  # frames that the speed is measured on


@dataclass(frozen=True)
class Test:
    """Frames with ITOP's joints: either a folder's dataset or frames in memory.

    reference: joints outside of the image are NaN · labelled: whether the joints are where ITOP's annotators put them ·
    batch: gives some of the frames · key: changes with the frames.
    """

    name: str
    reference: ItopReference
    labelled: bool
    batch: Callable[[slice], FrameBatch]
    key: str


@dataclass(frozen=True)
class Answers:
    """joints_3d: (F, 15, 3) m, NaN = not found · cpu_s: for a frame, on one thread."""

    joints_3d: NDArray[np.float64]
    cpu_s: float


def of_joints(*, own: bool = False) -> list[str]:
    """Names of the methods that find joints in images; `own`: the package's alone."""
    ours = METHODS.names(own=True)
    return [name for name, method in METHODS.items() if method.task == "joints" and (name in ours or not own)]


def recipe(method: str, path: Path | None, epochs: int | None) -> TrainConfig:
    """The run of a method: from a YAML file, or the small one that this module states, in either case with `epochs` if given."""
    from cabinpose.estimate import TrainConfig  # noqa: PLC0415 - torch, which models that are given do without

    chosen = METHODS[method]
    if chosen.task != "joints":
        raise ConfigError(f"{method} does not find joints in images", hint=f"compare some of: {', '.join(of_joints())}")
    if path is not None:
        config = read_train_config(path, method)
    else:
        fields = chosen.settings_type.model_fields
        settings = {name: value for name, value in _ROOM.items() if name in fields} | dict(chosen.room)
        config = TrainConfig.model_validate({"method": method, "settings": settings, **_RUN})
    return config.model_copy(update={"epochs": epochs}) if epochs else config


def train_model(
    config: TrainConfig, data: Sequence[Path], out: Path, progress: Callable[[int, int, str], None] | None = None
) -> Path:
    """The model file of a method, trained on datasets into the folder `out` unless it is there; an interrupted run goes on.

    Raises
    ------
    ConfigError
        Where the folder holds a model of another recipe or of other data.
    """
    from cabinpose.estimate import Observers, Start, export_onnx, fit, frame_spec  # noqa: PLC0415 - torch

    facts = {"recipe": config.model_dump(mode="json"), "data": [dataset_id(read_manifest(folder)) for folder in data]}
    record, text = out / "recipe.json", json.dumps(facts, indent=1) + "\n"
    if record.exists() and record.read_text("utf-8") != text:
        raise ConfigError(f"{out} was trained by another recipe or on other data", hint="give another folder with --out")
    known = [path for path in (out / "model.onnx", out / "best.npz") if path.exists()]
    if known:
        return known[0]
    make_folder(out)
    write_whole(record, text)
    datasets = as_configured(config, {str(folder): open_dataset(folder) for folder in data})
    training, validation = stored_frames(training_split(datasets, None, "train", "validate"), frame_spec(config))
    start, observers = Start(resume=(out / "last.ckpt").exists()), Observers(progress, partial(write_curves, out / "curves.png"))
    best = fit(config, training, validation, out, start=start, observers=observers)
    if best.suffix == ".ckpt":
        model = out / "model.onnx"
        export_onnx(best, model, name=config.method, card={})
        return model
    return best


def open_test(path: Path, out: Path, correct: Any) -> Test:
    """The frames of a test: a dataset with ITOP's joints, ITOP's own files, which are imported into `out`, or frames in a .npz.

    Raises DatasetError for a dataset without ITOP's joints.
    """
    if path.suffix == ".npz":
        frames, reference = read_itop_frames(path), read_itop_reference(path)

        def some(which: slice) -> FrameBatch:
            return {**frames, "depth": frames["depth"][which]}

        return Test(path.stem, reference, True, some, hashlib.sha256(path.read_bytes()).hexdigest())
    folder = path
    if not (path / MANIFEST_NAME).exists():
        folder = out / "data" / f"{path.stem}{f'-{correct}' if correct else ''}"
        if not (folder / MANIFEST_NAME).exists():
            import_source(open_source(path, "itop", correct=correct), folder)
    manifest, dataset = read_manifest(folder), open_dataset(folder)
    if "itop_joints_3d" not in dataset:
        raise DatasetError(f"{path} has no joints of ITOP", hint="test on scenes in a room, or on ITOP's files")
    labelled = manifest.generator == "import itop"
    joints = dataset["itop_joints_3d"].values[:, 0].astype(np.float64)
    if not labelled:  # ITOP's protocol counts every joint; in generated frames one outside of the image is absent
        width, height = manifest.width, manifest.height
        uv = np.einsum("fij,fkj->fki", dataset["camera_k"].values, joints / joints[..., 2:])[..., :2]
        inside = ((uv > -0.5) & (uv < (width - 0.5, height - 0.5))).all(axis=-1)
        joints = np.where(inside[..., None], joints, np.nan)
    reference = ItopReference(dataset["frame"].values.astype(np.int64), joints, np.asarray(np.isfinite(joints).any(axis=(1, 2))))
    return Test(folder.name, reference, labelled, lambda which: frame_batch(dataset, which), dataset_id(manifest))


def answers(model_file: Path, test: Test, file: Path, progress: Callable[[int], None]) -> Answers:
    """What the model in a file finds in a test, from `file` where it holds just this; written there otherwise.

    The time is that of the process over at most 64 frames in memory, after a batch to warm up. Raises ConfigError for a model of
    other joints.
    """
    model = load_model(model_file, threads=1)
    if model.joints != ITOP.joints or len(model.persons) != 1:
        raise ConfigError(f"{model_file} does not find ITOP's joints of one person", hint="train it with skeleton or body: itop")
    key = f"{hashlib.sha256(model_file.read_bytes()).hexdigest()} {test.key}"
    with suppress(OSError, KeyError, ValueError):  # none yet, or a damaged one, which is made again
        known = read_arrays(file)
        if str(known["key"]) == key:
            return Answers(known["joints_3d"], float(known["cpu_s"]))
    count, found = len(test.reference.frame), []
    for start in range(0, count, BATCH):
        poses = model.predict(test.batch(slice(start, start + BATCH)))
        sure = test.labelled | (poses.presence[:, 0] >= EvaluationOptions.presence)
        found.append(np.where(sure[..., None], poses.joints_3d[:, 0], np.nan))
        progress(min(start + BATCH, count))
    timed = test.batch(slice(0, min(count, _TIMED)))
    began = time.process_time()
    model.predict(timed)
    cpu_s = (time.process_time() - began) / len(timed["depth"])
    make_folder(file.parent)
    result = Answers(np.concatenate(found).astype(np.float64), cpu_s)
    with whole_file(file) as partial:
        np.savez_compressed(partial, key=np.array(key), joints_3d=result.joints_3d, cpu_s=np.array(cpu_s))
    return result


def judged(test: Test, found: Answers, method: str, options: EvaluationOptions) -> tuple[Report, float | None]:
    """The report of a method on a test; where joints are moved to where ITOP's labels lie also the share within 10 cm without."""
    note = replace(options, resamples=0)
    if not test.labelled:
        return evaluate_itop(test.reference, found.joints_3d, options, model=method, name=test.name), None
    plain = evaluate_itop(test.reference, found.joints_3d, note).value("PCK", "3d", threshold=10.0)
    report = evaluate_itop(test.reference, as_labelled(found.joints_3d), options, model=method, name=test.name)
    return report, plain.value if plain is not None else None
