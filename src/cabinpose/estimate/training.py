"""Training of any method with Lightning: resumable, best epoch by validation, the same curve after an interruption.

What an epoch sees depends on the seed and the epoch's number alone: the order of the frames, and the augmentation of each batch.
A run that was killed goes on from its last whole epoch with the numbers that it would have had.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Mapping, Sequence, Sized
from itertools import islice
from pathlib import Path
from typing import Any, cast
from zipfile import is_zipfile

import lightning
import numpy as np
import torch
from lightning.pytorch.callbacks import Callback, WeightAveraging
from pydantic import ValidationError
from torch import Tensor, nn
from torch.utils.data import DataLoader

from cabinpose.core import ANATOMY, ConfigError, DatasetError, ModelError, check_archive, make_folder, output_errors
from cabinpose.estimate.array_model import write_arrays
from cabinpose.estimate.augment import Mirror
from cabinpose.estimate.batch import Batch, ray_tensor
from cabinpose.estimate.checkpoints import MovedCheckpoint, WholeCheckpoints
from cabinpose.estimate.curves import Curves
from cabinpose.estimate.data import Frames, FrameSpec, GeneratedFrames, collate, epoch_order, mirrored_labels, trained_on
from cabinpose.estimate.found import mirrored_slots
from cabinpose.estimate.guards import alone, interruptible, quiet, too_little_memory
from cabinpose.estimate.inputs import MOST_M, Kept
from cabinpose.estimate.loggers import check_loggers, open_loggers
from cabinpose.estimate.methods import ARRAYS_SUFFIX, METHODS, ArrayMethod, NetworkMethod, Progress, method_of
from cabinpose.estimate.onnx_model import JOINT_DEFINITION, TRAINED_ON, packaged_models
from cabinpose.estimate.tasks import TASKS, Setting, Task
from cabinpose.estimate.train_config import Machines, Observers, Start, usable_precision, with_old_keywords
from cabinpose.estimate.train_config import TrainConfig as TrainConfig
from cabinpose.estimate.weights import measure_norms, read_weights, take_weights
from cabinpose.store import merged_ranges

_MEASURED = 500  # training frames that open settings are measured on
_SEEDS = 0x7FFFFFFFFFFFFFFF
_BY_NAME = ("slots", "skeleton", "body")  # settings in which a network to begin with may differ
_FRAMES = "training_frames"  # in a checkpoint, see `_told`
_NETWORK = "network."  # how the names of the network's tensors begin in a checkpoint


def _network_method(name: str) -> NetworkMethod[Any]:
    """The method of this name, of which a network is trained. Raises ConfigError for one without."""
    method = METHODS[name]
    if not isinstance(method, NetworkMethod):
        raise ConfigError(f"{name} has no network", hint="its run writes best.npz, which is the model")
    return method


class Detector(lightning.LightningModule):
    """A network in training, with its loss, optimiser and validation figures."""

    rays: Tensor
    mirror_labels: Tensor

    def __init__(self, config: TrainConfig) -> None:
        super().__init__()
        self.settings = config
        self.method = _network_method(config.method)
        self.task: Task = TASKS[self.method.task]
        self.method_config = self.method.settings(config.settings)
        self.network: nn.Module = self.method.network(self.method_config)
        slots = self.method_config.slots
        joints = self.method_config.joint_set.mirror
        self._mirrors = joints, mirrored_slots(slots)
        self.register_buffer("rays", ray_tensor(self.method_config.view), persistent=False)
        self.register_buffer("mirror_labels", torch.from_numpy(mirrored_labels()), persistent=False)
        self._errors: list[np.ndarray] = []
        self.joint_definition = ANATOMY  # of joints of ours; frames of older datasets are told so before they are learnt
        self.trained_on: dict[str, str] = {}  # see `data.trained_on`; of what the run began with, once it is saved of the run too
        self.learns_from: Frames | Sequence[Kept] = ()
        self.save_hyperparameters({"config": config.model_dump(mode="json")})

    def training_step(self, batch: Batch, index: int) -> Tensor:
        """The loss of an augmented batch."""
        generator = torch.Generator(device=batch.joints.device)
        where = (self.settings.seed, self.current_epoch, index, self.global_rank)
        generator.manual_seed(hash(where) & _SEEDS)
        torch.manual_seed(hash((*where, 1)) & _SEEDS)  # what a network draws for itself: dropout
        setting = Setting(self.rays, self.method_config.view.focal, Mirror(*self._mirrors, self.mirror_labels))
        with torch.no_grad():
            varied = self.task.vary(batch, self.settings.augment, self.method_config, setting, generator)
        terms: dict[str, Tensor] = self.method.loss(self.network, varied)
        self.log_dict({f"train_{name}": value.detach() for name, value in terms.items()}, on_epoch=True, on_step=False,
                      batch_size=len(batch.joints), sync_dist=True)  # fmt: skip
        self.log("loss", terms["loss"].detach(), prog_bar=True, on_step=True, on_epoch=False)
        return terms["loss"]

    def validation_step(self, batch: Batch, index: int) -> None:  # noqa: ARG002 - the signature is Lightning's
        """Logs the loss of a batch that is not augmented, and collects what the method's task judges it by."""
        terms: dict[str, Tensor] = self.method.loss(self.network, self.task.plain(batch, self.method_config))
        self.log_dict({f"val_{name}": value for name, value in terms.items()}, batch_size=len(batch.joints), sync_dist=True)
        seen = self.task.inputs(batch, self.method_config)
        values = self.network(*(seen[name] for name in self.method_config.inputs))
        outputs = {name: getattr(values, name).float().cpu().numpy() for name in self.method.outputs}
        arrays = {name: value.cpu().numpy() for name, value in seen.items()}
        decoded = self.method.decode(outputs, self.method_config, arrays)
        self._errors.append(self.task.errors(decoded, batch, self.method_config))

    def on_validation_epoch_end(self) -> None:
        """The validation figures of the task; with several processes the mean of theirs."""
        figures, self._errors = self.task.figures(self._errors), []
        self.log_dict(figures, prog_bar=True, sync_dist=True)

    def on_save_checkpoint(self, checkpoint: dict[str, Any]) -> None:
        """Adds the frames that the weights have learnt from so far."""
        learnt = trained_on(self.learns_from, self.current_epoch + 1)
        checkpoint |= {TRAINED_ON: merged_ranges(self.trained_on, learnt), JOINT_DEFINITION: self.joint_definition}
        checkpoint[_FRAMES] = _told(self.learns_from)

    def on_load_checkpoint(self, checkpoint: dict[str, Any]) -> None:
        """Takes over what a run that goes on has learnt from. Raises ModelError for one of other joints or other frames."""
        if checkpoint.get(JOINT_DEFINITION) != self.joint_definition:
            raise ModelError(
                "the run was begun by a version up to 0.2, whose joints lie elsewhere (docs/joints.md)",
                hint="begin anew with --init and the run's best.ckpt",
            )
        if checkpoint.get(_FRAMES, told := _told(self.learns_from)) != told:  # of a run of before nobody knows
            raise ModelError("the run was begun with other training frames", hint="resume with the frames of that run")
        self.trained_on = dict(checkpoint.get(TRAINED_ON, {}))

    def configure_optimizers(self) -> Any:
        """AdamW or Adam, under one cycle (Smith and Topin 2018) or at a constant rate; norms and biases do not decay."""
        named = list(self.network.named_parameters())
        decayed = [p for name, p in named if p.ndim > 1 and not name.endswith("bias")]
        others = [p for name, p in named if p.ndim <= 1 or name.endswith("bias")]
        groups = [{"params": decayed, "weight_decay": self.settings.weight_decay}, {"params": others, "weight_decay": 0.0}]
        rate = self.settings.learning_rate
        optimiser = (torch.optim.Adam if self.settings.optimiser == "adam" else torch.optim.AdamW)(groups, lr=rate)
        if self.settings.schedule == "constant":
            return optimiser
        steps = int(self.trainer.estimated_stepping_batches)
        schedule = torch.optim.lr_scheduler.OneCycleLR(optimiser, rate, total_steps=steps, pct_start=0.15)
        return {"optimizer": optimiser, "lr_scheduler": {"scheduler": schedule, "interval": "step"}}


class _Frames(lightning.LightningDataModule):
    """The loaders of a run: each epoch in a new order (or of new frames), known from the seed and the epoch's number."""

    def __init__(self, config: TrainConfig, training: Frames, validation: Frames) -> None:
        super().__init__()
        self._config, self._training, self._validation = config, training, validation

    def train_dataloader(self) -> DataLoader[Kept]:
        """Called by Lightning at the start of each epoch."""
        trainer = cast(lightning.Trainer, self.trainer)
        if isinstance(self._training, GeneratedFrames):
            self._training.epoch = trainer.current_epoch
            self._training.rank, self._training.ranks = trainer.global_rank, trainer.world_size
            return self._loader(self._training)
        config, frames = self._config, len(cast(Sized, self._training))
        count = frames if config.epoch_steps is None else config.epoch_steps * config.batch
        order = epoch_order(frames, count, trainer.current_epoch, config.seed)
        return self._loader(self._training, sampler=order, drop_last=count >= config.batch * trainer.world_size)

    def val_dataloader(self) -> DataLoader[Kept]:
        """The validation frames in their order."""
        return self._loader(self._validation)

    def _loader(self, frames: Frames, **how: Any) -> DataLoader[Kept]:
        return DataLoader(frames, self._config.batch, num_workers=self._config.workers, collate_fn=collate, **how)


class _BatchReport(Callback):
    """Reports every batch: epoch, loss, and the deciding figure of the last validation; and when validation begins."""

    def __init__(self, progress: Progress, monitor: str) -> None:
        self._progress, self._monitor = progress, monitor

    def on_train_start(self, trainer: lightning.Trainer, *_: Any) -> None:
        self._tell(trainer)

    def on_train_batch_end(self, trainer: lightning.Trainer, *_: Any) -> None:
        metrics = trainer.callback_metrics
        self._tell(trainer, *(f"{name} {float(metrics[name]):.4g}" for name in ("loss", self._monitor) if name in metrics))

    def on_validation_start(self, trainer: lightning.Trainer, *_: Any) -> None:
        self._tell(trainer, "validating")

    def _tell(self, trainer: lightning.Trainer, *words: str) -> None:
        if trainer.is_global_zero:
            note = ", ".join([f"epoch {trainer.current_epoch + 1} of {trainer.max_epochs}", *words])
            self._progress(trainer.global_step, int(trainer.estimated_stepping_batches), note)


def fit(
    config: TrainConfig, training: Frames, validation: Frames, out: Path, *,
    start: Start | None = None, machines: Machines | None = None, observers: Observers | None = None, **old: Any,
) -> Path:  # fmt: skip
    """Train into the folder `out`: last.ckpt, best.ckpt, log/metrics.csv.

    Parameters
    ----------
    config
        Method, settings, augmentation, optimiser.
    training, validation
        Frames to learn from, and frames that decide on the best epoch.
    out
        The folder of the run.
    start
        What the run begins with; default: fresh weights.
    machines
        Where it computes; default: on all devices of this machine.
    observers
        Who is told how it goes; default: nobody.
    old
        Keywords of before, which go with the next release: `resume` and `init` of `start`, `devices` and `nodes` of `machines`,
        `progress`, `draw` and `callbacks` of `observers`.

    Returns
    -------
    Path
        The checkpoint of the best epoch; of a method that is fitted to arrays the model itself, best.npz.

    Raises
    ------
    ConfigError
        Where `out` holds another run and `resume` is not asked for, or where there is too little memory for a batch.
    DatasetError
        Where no validation frame shows what the deciding figure is of.
    DependencyError
        Where a logger is not installed.
    ModelError
        Where the run to resume, or to begin with, is of another network, or the former of other frames.
    """
    start, machines, observers = with_old_keywords(start or Start(), machines or Machines(), observers or Observers(), old)
    check_loggers(observers.loggers)
    if machines.threads is not None:
        torch.set_num_threads(machines.threads)
    if isinstance(METHODS[config.method], ArrayMethod):
        if observers.loggers:
            raise ConfigError(f"{config.method} has no epochs to log", hint="leave --logger out")
        if start.resume or start.init is not None:
            raise ConfigError(
                f"{config.method} is fitted in one go, from nothing", hint="leave --resume and --init out, and train it anew"
            )
        return _fit_arrays(config, training, validation, out, observers.progress)
    last = out / "last.ckpt"
    if last.exists() and not start.resume:
        raise ConfigError(
            f"{out} already holds a training run", hint="--resume goes on with it, or give another folder with --out"
        )
    if observers.progress is not None:
        observers.progress(0, 0, "reading frames")
    if config.epoch_steps is not None and isinstance(training, GeneratedFrames):
        raise ConfigError(
            "epoch_steps counts batches of stored frames", hint="leave it out: --frames says how many are made an epoch"
        )
    config = complete(config, training)  # reads frames where settings are measured: not before a run that is refused
    resumed = last if start.resume and last.exists() else None
    if resumed is not None:
        check_same(resumed, config)
    _check_judged(config, validation)
    lightning.seed_everything(config.seed, workers=True, verbose=False)
    make_folder(out)
    frames = _Frames(config, training, validation)
    figure = TASKS[METHODS[config.method].task].best
    monitor, mode = ("val_loss", "min") if config.best_by == "loss" else (figure, "max")
    best = MovedCheckpoint(out, "best", monitor=monitor, mode=mode, enable_version_counter=False)
    newest = MovedCheckpoint(out, "last", save_on_train_epoch_end=True, enable_version_counter=False)
    average = [WeightAveraging(multi_avg_fn=_moving_average(config.average))] if config.average else []
    curves = Curves(out, monitor, mode, config.patience, observers.draw)
    reports = [_BatchReport(observers.progress, figure)] if observers.progress is not None else []
    with quiet(), too_little_memory(config.batch, last), open_loggers(observers.loggers, out / "log") as loggers:
        trainer = lightning.Trainer(
            default_root_dir=out, max_epochs=config.epochs, precision=usable_precision(config.precision),
            devices=machines.devices, num_nodes=machines.nodes,
            callbacks=[*average, best, newest, curves, *reports, *observers.callbacks], logger=loggers,
            num_sanity_val_steps=0, log_every_n_steps=10, enable_model_summary=False,
            enable_progress_bar=False, reload_dataloaders_every_n_epochs=1,
            plugins=[WholeCheckpoints()],
        )  # fmt: skip
        detector = Detector(config)
        detector.learns_from = training
        if start.init is not None and not last.exists():
            begin_with(detector, start.init, training)
        if detector.method.channels_last:
            detector.network.to(memory_format=torch.channels_last)
        with output_errors(out), alone(out, trainer), interruptible():
            trainer.fit(detector, datamodule=frames, ckpt_path=resumed, weights_only=True)
    return out / "best.ckpt"


def _check_judged(config: TrainConfig, validation: Frames | Sequence[Kept]) -> None:
    """Raise DatasetError where no validation frame shows what the figure that decides is of; most often the first one does."""
    method = METHODS[config.method]
    task, settings = TASKS[method.task], method.settings(config.settings)
    stored = not isinstance(validation, GeneratedFrames)
    held = (validation[i] for i in range(len(cast(Sized, validation)))) if stored else iter(validation)
    if config.best_by == "figure" and not any(task.judges(collate([frame]), settings) for frame in held):
        raise DatasetError(
            f"no validation frame shows what {task.best} is of: the people of {', '.join(settings.slots)}",
            hint="choose others to validate on (--splits, --val), other slots, or best_by: loss",
        )


def _fit_arrays(config: TrainConfig, training: Frames, validation: Frames, out: Path, progress: Progress | None) -> Path:
    """Fit a method without a network; the model is `best.npz`, whose card has the validation figures of the task."""
    best = out / f"best{ARRAYS_SUFFIX}"
    if best.exists():
        raise ConfigError(f"{out} already holds a trained model", hint="give another folder with --out")
    config = complete(config, training)
    method: ArrayMethod[Any] = METHODS[config.method]  # type: ignore[assignment]
    settings = method.settings(config.settings)
    frames, held = (list(f) if isinstance(f, GeneratedFrames) else cast(Sequence[Kept], f) for f in (training, validation))
    arrays = method.fit(settings, frames, config.augment, progress or (lambda *_: None), seed=config.seed)
    task = TASKS[method.task]
    errors = []
    for first in range(0, len(held), config.batch):
        batch = collate([held[i] for i in range(first, min(first + config.batch, len(held)))])
        seen = {name: value.numpy() for name, value in task.inputs(batch, settings).items()}
        errors.append(task.errors(method.find(arrays, settings, seen), batch, settings))
    card = {"frames": len(frames), "seed": config.seed} | {n: round(value, 2) for n, value in task.figures(errors).items()}
    make_folder(out)
    learnt = trained_on(training, 1)
    known: dict[str, Any] = {TRAINED_ON: learnt} if learnt else {}
    known[JOINT_DEFINITION] = ANATOMY
    write_arrays(best, method.name, settings, arrays, name=out.resolve().name, card=card, **known)
    return best


def _moving_average(decay: float) -> Callable[[list[Tensor], list[Tensor], Tensor], None]:
    """The update of an exponential moving average, whose decay grows from 0.1 to its value over the first steps.

    With the whole decay from the start, a short run would be judged by weights that are still close to the random ones.
    All tensors of a kind come at once, which takes a fifth of the time of one by one; counters are those of the newest weights.
    """

    def update(means: list[Tensor], values: list[Tensor], count: Tensor) -> None:
        if means[0].is_floating_point():
            torch._foreach_lerp_(means, values, 1 - min((1 + int(count)) / (10 + int(count)), decay))
        else:
            torch._foreach_copy_(means, values)

    return update


def check_same(checkpoint: Path, config: TrainConfig) -> None:
    """Raises ModelError where a checkpoint was trained with another configuration."""
    before = _configuration(checkpoint, read_checkpoint(checkpoint))
    differing = [name for name in TrainConfig.model_fields if getattr(before, name) != getattr(config, name)]
    if differing:
        raise ModelError(
            f"{checkpoint} was trained with another {', '.join(differing)}", hint="resume with the configuration of that run"
        )


def _configuration(path: Path, checkpoint: Mapping[str, Any]) -> TrainConfig:
    """The configuration in a checkpoint; ModelError where this version does not know its method or its keys."""
    if isinstance(checkpoint["config"], Mapping):
        method_of(path, str(checkpoint["config"].get("method", "compact")))
    try:
        return TrainConfig.model_validate(checkpoint["config"])
    except ValidationError as error:
        raise ModelError(
            f"{path} was trained by another version of cabinpose: {error.errors()[0]['msg']}", hint="train it again"
        ) from error


def read_checkpoint(path: Path) -> dict[str, Any]:
    """What a checkpoint holds: {"config": plain data, "state": tensors by name, "trained_on": ranges of frames by dataset,
    "joint_definition": of the joints that it has learnt, "" up to version 0.2}.

    Raises ModelError.
    """
    try:
        if is_zipfile(path):
            check_archive(path)
        data = torch.load(path, map_location="cpu", weights_only=True)  # plain types and tensors: no code runs
        learnt = dict(data.get(TRAINED_ON, {}))
        state, definition = data["state_dict"], str(data.get(JOINT_DEFINITION, ""))
        return {"config": data["hyper_parameters"]["config"], "state": state, TRAINED_ON: learnt, JOINT_DEFINITION: definition}
    except (FileNotFoundError, IsADirectoryError, PermissionError) as error:
        raise ModelError(f"cannot read {path}: {error.strerror}", hint="give best.ckpt or last.ckpt of a run") from error
    except Exception as error:  # torch raises whatever its unpickler does, in words that mislead
        raise ModelError(
            f"{path} is no checkpoint of `cabinpose train`, or it is cut short", hint="give best.ckpt or last.ckpt of a run"
        ) from error


def load_detector(path: Path) -> Detector:
    """The trained detector of a checkpoint, ready to infer. Raises ModelError for a checkpoint of another network."""
    data = read_checkpoint(path)
    detector = Detector(_configuration(path, data))
    detector.trained_on, detector.joint_definition = data[TRAINED_ON], data[JOINT_DEFINITION]
    try:
        detector.load_state_dict(data["state"])
    except RuntimeError as error:
        raise ModelError(f"{path} does not fit its network: {str(error).splitlines()[0]}", hint="train it again") from error
    return detector.eval()


def begin_with(detector: Detector, source: Path, training: Frames | Sequence[Kept]) -> None:
    """Give a detector the weights of a checkpoint or of a compact model in an ONNX file.

    Weights of single places and joints are taken by name, see `NetworkMethod.layout`, but that the only place may stand for
    another only one; what the other one does not have keeps its own. A warning says what. Norms that were folded on export are
    measured on `training`. Raises ModelError where the other one is of another method, or of another size beyond that.
    """
    source = packaged_models().get(str(source), source)
    folded: tuple[str, ...] = ()
    if source.suffix == ".onnx":
        theirs, state, folded, learnt = read_weights(source)
    else:
        data = read_checkpoint(source)
        config = _configuration(source, data)
        theirs, learnt = METHODS[config.method].settings(config.settings), data[TRAINED_ON]
        state = {name.removeprefix(_NETWORK): value for name, value in data["state"].items() if name.startswith(_NETWORK)}
    mine, method = detector.method_config, detector.method
    try:
        if type(mine) is not type(theirs):
            raise ValueError("it is of another method")
        if getattr(mine, "input", None) != getattr(theirs, "input", None):  # some have as many channels
            raise ValueError("it sees another image")
        stands = not method.of_places or len(mine.slots) == 1 == len(theirs.slots)
        named = theirs.model_copy(update={"slots": mine.slots}) if stands else theirs
        layouts = method.layout(mine), method.layout(named)
        if not layouts[0] and (mine.joints, mine.slots) != (named.joints, named.slots):
            raise ValueError("its places and joints are others")
        taken = take_weights(detector.network, state, *layouts)
    except ValueError as error:
        others = [n for n, value in theirs if n not in type(mine).model_fields or getattr(mine, n) != value]
        sizes = [name for name in others if name not in _BY_NAME] or others
        raise ModelError(
            f"{source} is of another network: {', '.join(sizes)}", hint="begin with a run of the same method and settings"
        ) from error
    told = [f"has learnt other places: {', '.join(theirs.slots)}"] if stands and mine.slots != theirs.slots else []
    if taken.share < 1:
        told.append(f"gives {100 * taken.share:.3g} % of the weights; new are {', '.join(taken.fresh) or 'some limbs'}")
    if told:
        warnings.warn(f"{source} {' and '.join(told)}", stacklevel=3)
    detector.trained_on = learnt
    if folded:
        frames = _some(training)
        batch = detector.settings.batch
        measure_norms(detector.network, folded, (collate(frames[i : i + batch]) for i in range(0, len(frames), batch)))


def frame_spec(config: TrainConfig) -> FrameSpec:
    """What a run takes of each frame. Raises ConfigError for depths that frames are not kept with."""
    method = METHODS[config.method]
    spec = TASKS[method.task].spec(method.settings(config.settings))
    if (farthest := spec.view.max_depth_m) > MOST_M:
        raise ConfigError(f"max_depth_m {farthest:g} is beyond {MOST_M:g} m, what training keeps", hint="set a smaller one")
    return spec._replace(depth_image=config.depth)


def complete(config: TrainConfig, training: Frames | Sequence[Kept]) -> TrainConfig:
    """The configuration with the settings that are measured on the training frames, where its method has any."""
    method = METHODS[config.method]
    given = method.settings(config.settings)
    settings = method.measured(given, lambda: _some(training))
    return config if settings is given else config.model_copy(update={"settings": settings.model_dump(mode="json")})


def _told(training: Frames | Sequence[Kept]) -> dict[str, Any]:
    """What tells the frames of a run, or of an epoch of it, from others: how many they are, and their ranges by dataset."""
    count = training.count if isinstance(training, GeneratedFrames) else len(cast(Sized, training))
    return {"count": count, **trained_on(training, 1)}


def _some(training: Frames | Sequence[Kept]) -> list[Kept]:
    """At most _MEASURED frames, evenly spread, or the first of those that are made."""
    if isinstance(training, GeneratedFrames):
        return list(islice(iter(training), _MEASURED))
    count = len(cast(Sized, training))
    return [training[int(i)] for i in np.unique(np.linspace(0, count - 1, min(count, _MEASURED)).astype(int))]
