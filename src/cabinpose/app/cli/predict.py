"""`cabinpose predict`: run a model over a dataset and write a predictions file."""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path

from cabinpose.app.cli.arguments import DatasetArgument, SelectsFrames
from cabinpose.app.cli.output import print_json, printable, progress, tell_failed


@dataclass(frozen=True, kw_only=True)
class Predict(SelectsFrames):
    """Run a model over a dataset and write the joints that it finds as a predictions file."""

    dataset: DatasetArgument
    model: str
    """Name of a packaged model, an ONNX file, or a model on a server (grpc://HOST:PORT/MODEL)."""
    out: Path
    """Predictions file to write: JSON lines (.jsonl) or Parquet (.parquet)."""
    overwrite: bool = False
    """Replace the file."""


COMMAND = Predict


def run(command: Predict) -> None:
    """Run the model over the frames in their order and write the predictions."""
    import numpy as np

    from cabinpose.app.cli.selection import selected
    from cabinpose.core.ports import joined
    from cabinpose.estimate.remote import open_predictor
    from cabinpose.evaluate.offline import BATCH, frame_batch
    from cabinpose.store import open_dataset, read_manifest
    from cabinpose.store.predictions import Predictions, check_new_predictions, write_predictions
    from cabinpose.store.schema import dataset_id

    check_new_predictions(command.out, overwrite=command.overwrite)  # before the work, not at its end
    model = open_predictor(command.model)
    dataset = selected(open_dataset(command.dataset), command)
    places = [str(name) for name in dataset["person"].values]
    if not set(places) & set(model.persons):
        print(
            f"the model {model.name} looks at {', '.join(model.persons)}, and the dataset has {printable(', '.join(places))}: "
            "`evaluate` cannot score what it finds",
            file=sys.stderr,
        )
    count = dataset.sizes["frame"]
    batches = []
    with progress(count, "frames") as report:
        for start in range(0, count, BATCH):
            batches.append(model.predict(frame_batch(dataset, slice(start, start + BATCH))))
            report(min(start + BATCH, count))
    tell_failed(model)
    found = joined(batches)
    predictions = Predictions(
        found.joints_2d, found.joints_3d, found.score, found.presence, frame=dataset["frame"].values.astype(np.int64),
        persons=model.persons, joints=model.joints, model=model.name, skeleton=model.skeleton,
        dataset=dataset_id(read_manifest(command.dataset)),
    )  # fmt: skip
    write_predictions(command.out, predictions, overwrite=command.overwrite)
    if command.as_json:
        print_json({"predictions": str(command.out), "model": model.name, "frames": count})
    else:
        print(command.out)
        print(f"score it with: cabinpose evaluate {command.dataset} --predictions {command.out}", file=sys.stderr)
