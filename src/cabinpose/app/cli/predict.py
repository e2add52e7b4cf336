"""`cabinpose predict`: what a model finds in a dataset, as a predictions file."""

from __future__ import annotations

import sys
from dataclasses import fields

import numpy as np

from cabinpose.app.cli.commands import Predict
from cabinpose.app.cli.output import print_json, progress
from cabinpose.app.cli.splits import chosen_split
from cabinpose.core.errors import PredictionsError
from cabinpose.core.ports import PoseBatch
from cabinpose.estimate.predictor import load_model
from cabinpose.evaluate.offline import BATCH, dataset_id, frame_batch
from cabinpose.store import open_dataset, read_manifest
from cabinpose.store.predictions import Predictions, write_predictions
from cabinpose.store.split import split_dataset


def run(command: Predict) -> None:
    """Run the model over the frames in their order and write what it finds."""
    if command.out.exists() and not command.overwrite:
        raise PredictionsError(f"{command.out} exists", hint="--overwrite replaces it")
    model = load_model(command.model)
    dataset = open_dataset(command.data)
    for chosen in split_dataset(dataset, chosen_split(command.splits, command.split)).values():
        dataset = chosen
    count = dataset.sizes["frame"]
    batches = []
    with progress(count, "frames") as report:
        for start in range(0, count, BATCH):
            batches.append(model.predict(frame_batch(dataset, slice(start, start + BATCH))))
            report(min(start + BATCH, count))
    found = (np.concatenate([getattr(batch, f.name) for batch in batches]) for f in fields(PoseBatch))
    numbers = dataset["frame"].values.astype(np.int64)
    predictions = Predictions(
        *found, numbers, model.persons, model.joints, model.name, model.config.skeleton, dataset_id(read_manifest(command.data))
    )
    write_predictions(command.out, predictions, overwrite=command.overwrite)
    if command.as_json:
        print_json({"predictions": str(command.out), "model": model.name, "frames": count})
    else:
        print(command.out)
        print(f"score it with: cabinpose evaluate --data {command.data} --predictions {command.out}", file=sys.stderr)
