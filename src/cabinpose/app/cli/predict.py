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
    """Name of a packaged model, an ONNX or .npz file, or a model on a server (grpc://HOST:PORT/MODEL)."""
    out: Path
    """Predictions file to write: JSON lines (.jsonl) or Parquet (.parquet)."""
    overwrite: bool = False
    """Replace the file."""


COMMAND = Predict


def run(command: Predict) -> None:
    """Run the model over the frames in their order and write the predictions."""
    from cabinpose.app.cli.selection import selected
    from cabinpose.estimate.remote import open_predictor
    from cabinpose.evaluate.offline import predict_dataset
    from cabinpose.store import open_dataset, read_manifest
    from cabinpose.store.predictions import check_new_predictions, write_predictions
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
    with progress(count, "frames") as report:
        name = dataset_id(read_manifest(command.dataset))
        predictions = predict_dataset(dataset, model, dataset_id=name, progress=report)
    tell_failed(model)
    write_predictions(command.out, predictions, overwrite=command.overwrite)
    if command.as_json:
        print_json({"predictions": str(command.out), "model": model.name, "frames": count})
    else:
        print(command.out)
        print(f"score it with: cabinpose evaluate {command.dataset} --predictions {command.out}", file=sys.stderr)
