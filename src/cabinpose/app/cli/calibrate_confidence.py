"""`cabinpose calibrate-confidence`: teach a model to say how far off each joint is likely to be."""

from __future__ import annotations

import sys
import warnings
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from cabinpose.app.cli.arguments import DatasetArgument, SelectsFrames
from cabinpose.app.cli.output import print_json, print_table, progress
from cabinpose.app.extras import require
from cabinpose.core import DatasetError, ModelError, check_output

if TYPE_CHECKING:
    from collections.abc import Callable

    import numpy as np
    import xarray as xr
    from numpy.typing import NDArray

    from cabinpose.estimate import JointPredictor
    from cabinpose.evaluate import EvaluationOptions


@dataclass(frozen=True, kw_only=True)
class CalibrateConfidence(SelectsFrames):
    """Write a copy of a model that gives each joint an expected error: the mean distance to the truth of such answers.

    It is fitted on the frames of a dataset with true joints, which must be others than the model was trained on.
    """

    dataset: DatasetArgument
    model: str
    """Name of a packaged model, or an ONNX or .npz file."""
    out: Path
    """File of the model to write, with the same ending as the model's."""
    presence: float = 0.5
    """Least probability at which a joint counts as found."""
    overwrite: bool = False
    """Replace the file."""


COMMAND = CalibrateConfidence


def run(command: CalibrateConfidence) -> None:
    """Fit the expected errors, write the model, and print what is to be expected of each joint."""
    require("train")
    import numpy as np

    from cabinpose.app.cli.selection import opened, selected
    from cabinpose.estimate import FEWEST, METADATA_KEY, fit_expected_error, load_model, write_copy
    from cabinpose.evaluate import EvaluationOptions, trained_ranges, trained_words
    from cabinpose.store import in_ranges, with_drive_side

    check_output(command.out, parents=False)
    options = EvaluationOptions(presence=command.presence)
    model = load_model(command.model)
    path = model.model.path
    if command.out.suffix != path.suffix:
        raise ModelError(f"{path} is written again as a file of its kind", hint=f"let --out end in {path.suffix}")
    if command.out.exists() and not command.overwrite:
        raise ModelError(f"{command.out} exists", hint="--overwrite replaces it, or give another file with --out")
    dataset = with_drive_side(selected(opened(command.dataset), command))  # whose seat it is, is no question of how far off
    frames = dataset.sizes["frame"]
    if learnt := int(in_ranges(trained_ranges(model, dataset), dataset["frame"].values).sum()):
        warnings.warn(f"{trained_words(learnt, frames)}, and more than it will expect", stacklevel=2)
    with progress(frames, "frames") as report:
        known, error_m, joints = _measured(dataset, model, options, report)
    table = fit_expected_error(known, error_m, joints)
    if not table:
        raise DatasetError(
            f"no joint is found {FEWEST} times or more in {frames} frames", hint="calibrate on a larger dataset of the same seats"
        )
    said = {"data": command.dataset.resolve().name, "frames": frames, "joints": table}
    write_copy(model.model, command.out, **{METADATA_KEY: said})
    found = {name: int(n) for name, n in zip(joints, np.isfinite(error_m).sum(axis=(0, 1)), strict=True)}
    left = [name for name in model.joints if name not in table]
    if command.as_json:
        print_json({"out": str(command.out), "frames": frames, "found": found, "joints": table, "left_out": left})
        return
    rows = [
        [name, f"{100 * s['error_m'][0]:.1f}", f"{100 * s['error_m'][-1]:.1f}", str(found[name])] for name, s in table.items()
    ]
    print_table([["expected error, cm", "least", "most", "found"], *rows])
    print(command.out)
    if left:
        print(f"too seldom found to say (fewer than {FEWEST} times): {', '.join(left)}", file=sys.stderr)


def _measured(
    dataset: xr.Dataset, model: JointPredictor, options: EvaluationOptions, report: Callable[[int], None]
) -> tuple[NDArray[np.float64], NDArray[np.float64], list[str]]:
    """The cues (N, P, J, C) of what a model found, and the distance (N, P, J) in m of each joint to its truth.

    NaN where `evaluate` would not count a joint, or where it was not found. J: the names returned.
    """
    import numpy as np

    from cabinpose.core import images_of
    from cabinpose.estimate import cameras_of, cues
    from cabinpose.evaluate import BATCH, common_skeleton, frame_batch, shared_places, truth_of

    skeleton, persons = common_skeleton(dataset, [model]), list(shared_places(dataset, [model]))
    joints = list(skeleton.joints)
    if not set(persons) <= set(model.persons):
        raise DatasetError(f"{model.name} looks at {', '.join(model.persons)}", hint="give a dataset of people in these places")
    rows, columns = [model.persons.index(name) for name in persons], [model.joints.index(name) for name in joints]
    truth = truth_of(dataset.sel(person=persons), skeleton)
    known, error_m = [], []
    for start in range(0, dataset.sizes["frame"], BATCH):
        which = slice(start, start + BATCH)
        frames = frame_batch(dataset, which, images_of(model))
        found = model.found(model.seen(frames, slice(None), cameras_of(frames, slice(None))), frames, slice(None))
        true = truth.isel(frame=which)
        distance = np.linalg.norm(found.joints_3d[:, rows][:, :, columns] - true["joints_3d"].values, axis=-1)
        judged = (found.presence[:, rows][:, :, columns] >= options.presence) & (
            true["visibility"].values >= options.min_visibility
        )
        known.append(cues(found)[:, rows][:, :, columns])
        error_m.append(np.where(judged, distance, np.nan))
        report(min(start + BATCH, dataset.sizes["frame"]))
    return np.concatenate(known), np.concatenate(error_m), joints
