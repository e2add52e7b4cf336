"""Training of any method with Lightning: resumable, best epoch by validation, the same curve after an interruption.

What an epoch sees depends on the seed and the epoch's number alone: the order of the frames, and the augmentation of each batch.
A run that was killed goes on from its last whole epoch with the numbers that it would have had.
"""

from __future__ import annotations

from importlib import import_module
from pathlib import Path
from typing import Annotated, Any, Literal

import lightning
import numpy as np
import torch
from lightning.pytorch.callbacks import Callback, EMAWeightAveraging, ModelCheckpoint
from lightning.pytorch.loggers import CSVLogger
from pydantic import BaseModel, ConfigDict, Field
from torch import Tensor, nn
from torch.utils.data import DataLoader, Dataset

from cabinpose.core.errors import ConfigError, ModelError
from cabinpose.core.skeleton import SYMMETRIC_PAIRS
from cabinpose.estimate.augment import AugmentConfig, augment
from cabinpose.estimate.batch import Batch
from cabinpose.estimate.data import FrameSpec, GeneratedFrames, Kept, collate
from cabinpose.estimate.methods import Method, method_named

HEAD_M = 0.2  # PCKh's head in 3D (pose.md's protocol); in the image it is this length at the joint's depth
_MIRROR_SLOTS = {"rear_left": "rear_right", "rear_right": "rear_left"}  # the driver stays at the wheel of the mirrored car
Positive = Annotated[int, Field(ge=1)]


class TrainConfig(BaseModel):
    """A training run: the method with its settings, the data's splits and the optimiser."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    method: Annotated[str, Field(description="compact, paf, ...")] = "compact"
    settings: Annotated[dict[str, Any], Field(description="Settings of the method.")] = Field(default_factory=dict)
    augment: AugmentConfig = Field(default_factory=AugmentConfig)
    epochs: Annotated[Positive, Field(description="Passes over the training frames.")] = 30
    batch: Annotated[Positive, Field(description="Frames in a batch.")] = 32
    learning_rate: Annotated[float, Field(gt=0, description="Greatest rate of the one-cycle schedule (AdamW).")] = 3e-3
    weight_decay: Annotated[float, Field(ge=0, description="AdamW's weight decay.")] = 0.02
    average: Annotated[float, Field(ge=0, lt=1, description="Decay of the weights' moving average; 0 = none.")] = 0.998
    precision: Annotated[Literal["32-true", "16-mixed", "bf16-mixed"], Field(description="Lightning's precision.")] = "32-true"
    workers: Annotated[int, Field(ge=0, description="Processes that read frames beside the training; 0 = none.")] = 0
    seed: Annotated[int, Field(ge=0, description="Seed of weights, order and augmentation.")] = 1


class Detector(lightning.LightningModule):
    """A network in training, with its loss, optimiser and validation figures."""

    def __init__(self, config: TrainConfig) -> None:
        super().__init__()
        self.settings = config
        self.method: Method = method_named(config.method)
        self.method_config = self.method.settings(config.settings)
        self.network: nn.Module = load_symbol(self.method.network)(self.method_config)
        self._loss = load_symbol(self.method.loss)
        joints, slots = self.method_config.joints, self.method_config.slots
        names = {n: m for a, b in SYMMETRIC_PAIRS for n, m in ((a, b), (b, a))}
        names |= {"lhip": "rhip", "rhip": "lhip"}  # ITOP's
        self._swap = [joints.index(names.get(name, name)) for name in joints]
        mirrored = [_MIRROR_SLOTS.get(name, name) for name in slots]
        self._swap_slots = [slots.index(name) if name in slots else i for i, name in enumerate(mirrored)]
        rays = self.method_config.view.camera.rays.transpose(2, 0, 1)
        self.register_buffer("_rays", torch.tensor(rays, dtype=torch.float32), persistent=False)
        self._errors: list[np.ndarray] = []
        self.save_hyperparameters({"config": config.model_dump(mode="json")})

    def training_step(self, batch: Batch, index: int) -> Tensor:
        """The loss of an augmented batch."""
        generator = torch.Generator(device=batch.depth.device)
        generator.manual_seed(hash((self.settings.seed, self.current_epoch, index, self.global_rank)) & 0x7FFFFFFFFFFFFFFF)
        with torch.no_grad():
            varied = augment(
                batch, self.settings.augment, self._rays, self.method_config.view.focal, self._swap, self._swap_slots,
                generator=generator,
            )  # fmt: skip
        terms = self._loss(self.network, varied)
        self.log_dict({f"train_{name}": value.detach() for name, value in terms.items()}, on_epoch=True, on_step=False,
                      batch_size=len(batch.depth))  # fmt: skip
        self.log("loss", terms["loss"].detach(), prog_bar=True, on_step=True, on_epoch=False)
        return terms["loss"]

    def validation_step(self, batch: Batch, index: int) -> None:  # noqa: ARG002 - the signature is Lightning's
        """Collects the image errors, in heads, of the joints in the image of people who are there."""
        found = self.method.decode(outputs_of(self.network, self.method, batch), self.method_config)
        uvz = self.method_config.view.to_view(found.joints_3d)
        truth = batch.joints.cpu().numpy().astype(np.float64)
        head_px = HEAD_M * self.method_config.view.focal / truth[..., 2]
        error = np.linalg.norm(uvz[..., :2] - truth[..., :2], axis=-1) / head_px
        known = batch.present.cpu().numpy()[..., None] & (batch.visibility.cpu().numpy() > 1) & np.isfinite(head_px)
        self._errors.append(np.where(np.isnan(error), np.inf, error)[known])

    def on_validation_epoch_end(self) -> None:
        """PCKh@0.5 and the area under PCKh from 0 to 0.5, in percent; the best epoch is the one with the greatest area."""
        errors = np.concatenate(self._errors) if self._errors else np.zeros(0)
        self._errors = []
        if not errors.size:
            return
        self.log("val_pckh", float(100 * np.mean(errors <= 0.5)), prog_bar=True)
        self.log("val_auc", float(100 * np.mean(np.clip(1 - errors / 0.5, 0, 1))), prog_bar=True)

    def configure_optimizers(self) -> Any:
        """AdamW under one cycle (Smith and Topin 2018); norms and biases do not decay."""
        decayed = [p for p in self.network.parameters() if p.ndim > 1]
        others = [p for p in self.network.parameters() if p.ndim <= 1]
        groups = [{"params": decayed, "weight_decay": self.settings.weight_decay}, {"params": others, "weight_decay": 0.0}]
        optimiser = torch.optim.AdamW(groups, lr=self.settings.learning_rate)
        steps = int(self.trainer.estimated_stepping_batches)
        schedule = torch.optim.lr_scheduler.OneCycleLR(optimiser, self.settings.learning_rate, total_steps=steps, pct_start=0.15)
        return {"optimizer": optimiser, "lr_scheduler": {"scheduler": schedule, "interval": "step"}}


class _Frames(lightning.LightningDataModule):
    """The loaders of a run: each epoch in a new order (or of new frames), known from the seed and the epoch's number."""

    def __init__(self, config: TrainConfig, training: Dataset[Kept], validation: Dataset[Kept]) -> None:
        super().__init__()
        self._config, self._training, self._validation = config, training, validation

    def train_dataloader(self) -> DataLoader[Kept]:
        """Called by Lightning at the start of each epoch."""
        epoch = self.trainer.current_epoch if self.trainer is not None else 0
        if isinstance(self._training, GeneratedFrames):
            self._training.epoch = epoch
            return self._loader(self._training)
        rng = np.random.Generator(np.random.Philox(key=(self._config.seed, epoch)))
        order = rng.permutation(len(self._training)).tolist()  # type: ignore[arg-type]
        return self._loader(self._training, sampler=order, drop_last=len(order) >= self._config.batch)

    def val_dataloader(self) -> DataLoader[Kept]:
        """The validation frames in their order."""
        return self._loader(self._validation)

    def _loader(self, frames: Dataset[Kept], **how: Any) -> DataLoader[Kept]:
        return DataLoader(frames, self._config.batch, num_workers=self._config.workers, collate_fn=collate, **how)


def load_symbol(path: str) -> Any:
    """What an import path "module:name" means."""
    module, _, name = path.partition(":")
    return getattr(import_module(module), name)


@torch.no_grad()
def outputs_of(network: nn.Module, method: Method, batch: Batch) -> dict[str, np.ndarray]:
    """The network's outputs for a batch by name, as numpy arrays."""
    values = network(*(getattr(batch, name) for name in method.inputs))
    return {name: getattr(values, name).float().cpu().numpy() for name in method.outputs}


def fit(
    config: TrainConfig,
    training: Dataset[Kept],
    validation: Dataset[Kept],
    out: Path,
    *,
    resume: bool = False,
    callbacks: tuple[Callback, ...] = (),
    devices: int | str = "auto",
    nodes: int = 1,
) -> Path:
    """Train into the folder `out` and return the best epoch's checkpoint.

    `out` gets last.ckpt, best.ckpt and metrics.csv (and TensorBoard's files where it is installed). Raises ConfigError where
    `out` holds another run and `resume` is not asked for, ModelError where the run to resume is of another network.
    """
    last = out / "last.ckpt"
    if last.exists() and not resume:
        raise ConfigError(
            f"{out} already holds a training run", hint="--resume goes on with it, or give another folder with --out"
        )
    if resume and last.exists():
        check_same(last, config)
    lightning.seed_everything(config.seed, workers=True, verbose=False)
    out.mkdir(parents=True, exist_ok=True)
    frames = _Frames(config, training, validation)
    best = ModelCheckpoint(out, "best", monitor="val_auc", mode="max", enable_version_counter=False)
    newest = ModelCheckpoint(out, "last", save_on_train_epoch_end=True, enable_version_counter=False)
    average = [EMAWeightAveraging(decay=config.average)] if config.average else []
    trainer = lightning.Trainer(
        default_root_dir=out, max_epochs=config.epochs, precision=config.precision, devices=devices, num_nodes=nodes,
        callbacks=[*average, best, newest, *callbacks], logger=_loggers(out), num_sanity_val_steps=0, log_every_n_steps=10,
        enable_model_summary=False, reload_dataloaders_every_n_epochs=1,
    )  # fmt: skip
    trainer.fit(Detector(config), datamodule=frames, ckpt_path=last if resume and last.exists() else None, weights_only=False)
    return out / "best.ckpt"


def _loggers(out: Path) -> list[Any]:
    loggers: list[Any] = [CSVLogger(out, name="", version="log")]
    try:
        from lightning.pytorch.loggers import TensorBoardLogger

        loggers.append(TensorBoardLogger(out, name="", version="log"))
    except ModuleNotFoundError:
        pass
    return loggers


def check_same(checkpoint: Path, config: TrainConfig) -> None:
    """Raises ModelError where a checkpoint was trained with another configuration."""
    before, now = read_checkpoint(checkpoint)["config"], config.model_dump(mode="json")
    differing = [name for name in now if before.get(name) != now[name]]
    if differing:
        raise ModelError(
            f"{checkpoint} was trained with another {', '.join(differing)}", hint="resume with the configuration of that run"
        )


def read_checkpoint(path: Path) -> dict[str, Any]:
    """Weights and configuration of a checkpoint: {"config": plain data, "state": tensors by name}. Raises ModelError."""
    try:
        data = torch.load(path, map_location="cpu", weights_only=False)
        return {"config": data["hyper_parameters"]["config"], "state": data["state_dict"]}
    except (OSError, KeyError, RuntimeError, EOFError, ValueError) as error:
        raise ModelError(
            f"{path} is no checkpoint of `cabinpose train`: {error}", hint="give best.ckpt or last.ckpt of a run"
        ) from error


def load_detector(path: Path) -> Detector:
    """The trained detector of a checkpoint, ready to infer. Raises ModelError for a checkpoint of another network."""
    data = read_checkpoint(path)
    detector = Detector(TrainConfig.model_validate(data["config"]))
    try:
        detector.load_state_dict(data["state"])
    except RuntimeError as error:
        raise ModelError(f"{path} does not fit its network: {str(error).splitlines()[0]}", hint="train it again") from error
    return detector.eval()


def frame_spec(config: TrainConfig) -> FrameSpec:
    """What a run takes of each frame."""
    method = method_named(config.method)
    settings = method.settings(config.settings)
    return FrameSpec(settings.view, settings.slots, settings.skeleton, labels=method.labels)
