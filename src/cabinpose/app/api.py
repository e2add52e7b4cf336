"""Functions for scripts: generated frames, data on disk, a model on plain arrays, a report.

These are the names that `import cabinpose` offers; each loads what it needs when it is called.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from cabinpose.core import ConfigError

if TYPE_CHECKING:
    import xarray as xr

    from cabinpose.core import Predictor
    from cabinpose.estimate import JointPredictor
    from cabinpose.evaluate import EvaluationOptions, Report
    from cabinpose.store import Predictions
    from cabinpose.store.recording import Recording
    from cabinpose.synth import Frame, SynthConfig

SAMPLE = Path(__file__).parent / "sample"  # the dataset of the package, made by tools/make_sample.py


def load_model(model: str | Path, *, threads: int | None = None) -> JointPredictor:
    """A trained model that is called with plain arrays.

    Parameters
    ----------
    model
        The name of a model of the package ("in_car", "five_seats", "room", "room_top", "paf"), an ONNX file that
        `cabinpose export onnx` wrote, or an .npz file that `cabinpose train` wrote.
    threads
        Threads of a network; default: ONNX Runtime's.

    Returns
    -------
    JointPredictor
        `model(depth_m, camera_k, amplitude)` gives the joints of one frame or of many; see `JointPredictor.__call__`.

    Raises
    ------
    ModelError
        For a file that is missing, truncated or not a model of this package.
    """
    from cabinpose.estimate import load_model as load  # noqa: PLC0415 - ONNX Runtime

    return load(model, threads=threads)


def open(path: Path | str) -> xr.Dataset | Recording | Predictions:  # noqa: A001 - `cabinpose.open`, as in h5py or xarray
    """Open what cabinpose has written, by what it is; `open_dataset`, `open_recording` and `open_predictions` give one type each.

    Parameters
    ----------
    path
        The folder of a dataset, a recording (.mcap, or a folder with the files of one take), or a predictions file (.jsonl,
        .parquet).

    Returns
    -------
    xarray.Dataset, Recording or Predictions
        A dataset is lazy: nothing of an image is read before it is asked for.

    Raises
    ------
    ConfigError
        For what is none of these; and what the readers raise for damaged files.
    """
    place = Path(path)
    of_takes = place.is_dir() and not (place / "dataset.yaml").exists() and any(place.glob("*.mcap"))
    if place.is_dir() and not of_takes:
        return open_dataset(place)
    if place.suffix == ".mcap" or of_takes:
        return open_recording(place)
    if place.suffix in (".jsonl", ".parquet"):
        return open_predictions(place)
    raise ConfigError(
        f"{place} is nothing that cabinpose writes" if place.exists() else f"{place} does not exist",
        hint="give the folder of a dataset, a recording (.mcap) or a predictions file (.jsonl, .parquet)",
    )


def open_dataset(folder: Path | str) -> xr.Dataset:
    """The dataset of a folder, lazily. Raises DatasetError for a folder without one, or with a damaged one."""
    from cabinpose.store import open_dataset as opened  # noqa: PLC0415 - xarray

    return opened(folder)


def open_recording(path: Path | str) -> Recording:
    """A recording: an .mcap file, or a folder with the files of one take. Raises RecordingError for what is none."""
    from cabinpose.store.recording import Recording  # noqa: PLC0415 - the extra `record`

    return Recording(Path(path))


def open_predictions(file: Path | str) -> Predictions:
    """A predictions file (.jsonl, .parquet). Raises PredictionsError for what is none."""
    from cabinpose.store import read_predictions  # noqa: PLC0415

    return read_predictions(file)


def sample() -> xr.Dataset:
    """The dataset that comes with the package, to try things on: 20 frames of a driver and a front passenger, 176 x 143 px.

    Returns
    -------
    xarray.Dataset
        As `open` gives one. People in two cars that the packaged models were not trained on; on the command line it is called
        `sample`: `cabinpose view sample --out my-view`.
    """
    return open_dataset(SAMPLE)


def generate(
    *overrides: str,
    frames: int | None = None,
    seed: int = 0,
    config: SynthConfig | Mapping[str, Any] | Path | str | None = None,
    first: int = 0,
) -> Iterator[Frame]:
    """Generated frames one by one, without a disk: the same as `cabinpose synth` writes.

    Parameters
    ----------
    *overrides
        What differs from the configuration, such as "scene.cars=[suv]"; the value is YAML.
    frames, first
        How many frames, from which number on; default: all, of a configuration with a number of combinations.
    seed
        Seed of all randomness.
    config
        A `SynthConfig`, its keys and values as plain data, or a YAML file; default: people in all seven cars.

    Yields
    ------
    dict
        Every variable of the dataset standard by name, for one frame: `depth` (H, W) float32 m, `joints_3d` (P, J, 3) m in the
        camera frame, `camera_k` (3, 3) px, ... (see docs/dataset.md).

    Raises
    ------
    ConfigError
        For a configuration that is wrong, before the first frame.
    SceneError
        Where no valid scene is found.
    """
    from cabinpose.synth import FrameMaker, SynthConfig, check_seed, preflight  # noqa: PLC0415 - trimesh, pydantic

    if not all(isinstance(override, str) for override in overrides):
        raise ConfigError("overrides are texts, such as 'scene.cars=[suv]'", hint="give a whole configuration as config=...")
    if isinstance(config, SynthConfig | Mapping):
        if overrides:
            raise ConfigError("overrides change files and defaults", hint="write them into the configuration")
        chosen = config if isinstance(config, SynthConfig) else SynthConfig.parse(dict(config))
    else:
        chosen = SynthConfig.load(None if config is None else Path(config), overrides)
    end = first + frames if frames is not None else chosen.frames_or_all(None)
    if not 0 <= first < end:
        raise ConfigError(f"cannot generate {end - first} frames from number {first} on", hint="ask for at least 1 frame")
    check_seed(seed)
    preflight(chosen, frames=end)
    maker = FrameMaker(chosen, seed)
    return (maker.make(index)[0] for index in range(first, end))


def evaluate_predictions(
    data: Path | str | xr.Dataset, model: Path | str | Predictions | Predictor, *, persons: Iterable[str] | str | None = None,
    options: EvaluationOptions | None = None,
) -> Report:  # fmt: skip
    """How good predictions are on a dataset, by the metrics of `cabinpose evaluate`.

    Parameters
    ----------
    data
        The folder of a dataset, or an open one (a selection of it as well).
    model
        A predictions file, predictions, the name of a model of the package, the address of one on a server
        (grpc://HOST:PORT/MODEL), or any detector that fulfils `cabinpose.core.ports.Predictor`.
    persons
        Slots that are evaluated, or one of them; default: those that the model answers for.
    options
        What counts, thresholds (`hit_px`, `hit_m`) and intervals, as `cabinpose evaluate` has them by default.

    Returns
    -------
    Report
        Its fields hold every metric with unit, threshold and count; `to_dict()` gives plain data.

    Raises
    ------
    DatasetError, ModelError, PredictionsError
        For what is missing, damaged or of another dataset.
    """
    from cabinpose.core import Predictor  # noqa: PLC0415 - the package imports in no time
    from cabinpose.estimate.remote import open_predictor  # noqa: PLC0415
    from cabinpose.evaluate import (  # noqa: PLC0415
        EvaluationOptions,
        check_predictions,
        evaluate,
        shared_places,
    )
    from cabinpose.store import Predictions  # noqa: PLC0415

    name = Path(data).resolve().name if isinstance(data, Path | str) else ""
    dataset = open_dataset(data) if isinstance(data, Path | str) else data
    if isinstance(model, Path | str):
        model = open_predictions(model) if Path(model).suffix in (".jsonl", ".parquet") else open_predictor(model)
    if isinstance(model, Predictions):
        check_predictions(model, dataset, (name,) if name else ())
    elif not isinstance(model, Predictor):
        raise ConfigError(
            f"a {type(model).__name__} is no detector",
            hint="it needs name, joints, persons and predict; see core.ports.Predictor",
        )
    places = [persons] if isinstance(persons, str) else list(() if persons is None else persons)
    return evaluate(dataset, model, options or EvaluationOptions(), persons=places or shared_places(dataset, [model]), name=name)
