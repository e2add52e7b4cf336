"""Training: a run that was killed goes on as if nothing had happened, and what does not fit is refused."""

from __future__ import annotations

import csv
import math
import subprocess
import sys
import warnings
from pathlib import Path
from typing import Any, cast

import numpy as np
import pytest
import small
import torch
from lightning.pytorch.callbacks import Callback
from torch import nn
from torch.optim.swa_utils import AveragedModel

from cabinpose.core.errors import ConfigError, ModelError
from cabinpose.core.segmentation import class_table
from cabinpose.estimate import train_config
from cabinpose.estimate.batch import Batch
from cabinpose.estimate.data import GeneratedFrames, StoredFrames, collate, epoch_order
from cabinpose.estimate.found import Found
from cabinpose.estimate.methods import METHODS, NetworkMethod
from cabinpose.estimate.tasks import TASKS, Joints, Lift, Parts
from cabinpose.estimate.train_config import Machines, Observers, Start, TrainConfig
from cabinpose.estimate.training import Detector, _moving_average, check_same, complete, fit, frame_spec, load_detector
from cabinpose.estimate.unet.config import MERGED

ONE = Machines(1)


class KilledError(Exception):
    """What ends a run in its middle."""


class KillInEpoch(Callback):
    def __init__(self, epoch: int) -> None:
        self._epoch = epoch

    def on_train_batch_start(self, trainer: Any, module: Any, batch: Any, index: int) -> None:
        if trainer.current_epoch == self._epoch and index == 1:
            raise KilledError


def config(method: str, **changes: Any) -> TrainConfig:
    return TrainConfig(**({"method": method, "settings": small.TINY[method], "epochs": 4, "batch": 4, "average": 0.5} | changes))


def frames(c: TrainConfig, count: int = 8) -> StoredFrames:
    return StoredFrames(small.dataset(count), frame_spec(c))


class RaiseInEpoch(Callback):
    def __init__(self, epoch: int, error: Exception) -> None:
        self._epoch, self._error = epoch, error

    def on_train_batch_start(self, trainer: Any, module: Any, batch: Any, index: int) -> None:
        if trainer.current_epoch == self._epoch:
            raise self._error


def curve(folder: Path) -> dict[tuple[str, int], float]:
    """Every number of the log by its name and step."""
    rows = list(csv.DictReader((folder / "log" / "metrics.csv").open()))
    return {
        (name, int(row["step"])): float(value)
        for row in rows
        for name, value in row.items()
        if name not in ("step", "epoch") and value not in ("", None)
    }


@pytest.mark.parametrize("method", [pytest.param("compact", marks=pytest.mark.slow), "lifting"])
def test_a_killed_run_goes_on_with_the_same_curve(method: str, tmp_path: Path) -> None:
    c = config(method)
    fit(c, frames(c), frames(c), tmp_path / "whole", machines=ONE)
    with pytest.raises(KilledError):
        fit(c, frames(c), frames(c), tmp_path / "killed", observers=Observers(callbacks=(KillInEpoch(2),)), machines=ONE)
    fit(c, frames(c), frames(c), tmp_path / "killed", start=Start(resume=True), machines=ONE)
    whole, resumed = curve(tmp_path / "whole"), curve(tmp_path / "killed")
    losses = [step for name, step in whole if name == "train_loss"]
    assert len(losses) == 4
    assert len({whole["train_loss", step] for step in losses}) == 4
    assert whole.keys() == resumed.keys()  # the table is whole again, the epochs before the interruption too
    for key, value in resumed.items():
        assert whole[key] == pytest.approx(value, rel=1e-6), key
    a, b = (torch.load(tmp_path / run / "last.ckpt", weights_only=False)["state_dict"] for run in ("whole", "killed"))
    for name, value in a.items():
        torch.testing.assert_close(b[name], value, rtol=1e-6, atol=1e-7)


def test_the_same_seed_gives_the_same_run_and_another_does_not(tmp_path: Path) -> None:
    for run, seed in (("a", 1), ("b", 1), ("c", 2)):
        c = config("lifting", epochs=1, seed=seed)
        fit(c, frames(c), frames(c), tmp_path / run, machines=ONE)
    assert curve(tmp_path / "a") == curve(tmp_path / "b")
    assert curve(tmp_path / "a") != curve(tmp_path / "c")


@pytest.mark.parametrize(
    "error",
    [
        MemoryError(),
        RuntimeError("[enforce fail at alloc_cpu.cpp:124] err == 0. DefaultCPUAllocator: can't allocate memory: you tried ..."),
        RuntimeError("std::bad_alloc"),
        torch.OutOfMemoryError("CUDA out of memory. Tried to allocate 2.00 GiB."),
        RuntimeError("cuDNN error: CUDNN_STATUS_ALLOC_FAILED"),
    ],
)
def test_too_little_memory_names_the_batch(error: Exception, tmp_path: Path) -> None:
    c = config("lifting", epochs=1)
    with pytest.raises(ConfigError, match="too little memory for batches of 4 frames") as caught:
        fit(c, frames(c), frames(c), tmp_path, observers=Observers(callbacks=(RaiseInEpoch(0, error),)), machines=ONE)
    assert "smaller `batch`" in caught.value.hint
    assert "--resume" not in caught.value.hint  # no epoch is whole: there is nothing to go on from
    assert caught.value.__cause__ is error
    c = config("lifting", epochs=1, batch=2)
    assert fit(c, frames(c), frames(c), tmp_path, machines=ONE).exists()


def test_too_little_memory_in_a_later_epoch_hints_to_resume(tmp_path: Path) -> None:
    c = config("lifting", epochs=2)
    raising = RaiseInEpoch(1, MemoryError("no 8 GB"))
    with pytest.raises(ConfigError, match="batches of 4 frames") as caught:
        fit(c, frames(c), frames(c), tmp_path, observers=Observers(callbacks=(raising,)), machines=ONE)
    assert "no 8 GB" in str(caught.value)
    assert "--resume" in caught.value.hint
    assert fit(c, frames(c), frames(c), tmp_path, start=Start(resume=True), machines=ONE).exists()


def test_other_errors_while_training_stay_what_they_are(tmp_path: Path) -> None:
    c = config("lifting", epochs=1)
    raising = RaiseInEpoch(0, RuntimeError("shapes differ"))
    with pytest.raises(RuntimeError, match="shapes differ"):
        fit(c, frames(c), frames(c), tmp_path, observers=Observers(callbacks=(raising,)), machines=ONE)


@pytest.mark.slow
@pytest.mark.skipif(sys.platform != "linux", reason="the address space is limited by its size in /proc")
def test_a_batch_that_does_not_fit_is_named(tmp_path: Path) -> None:
    """For real: a process that may only take 400 MB more than it has learns from frames of 1024 x 1024."""
    program = f"""
import resource, sys
from pathlib import Path
sys.path[:0] = {sys.path!r}
import small, torch
from cabinpose.core.errors import ConfigError
from cabinpose.estimate.data import StoredFrames
from cabinpose.estimate.train_config import Machines, TrainConfig
from cabinpose.estimate.training import fit, frame_spec
torch.set_num_threads(1)
c = TrainConfig(method="compact", settings=small.TINY["compact"] | {{"width": 1024, "height": 1024}}, epochs=1, batch=8)
frames = StoredFrames(small.dataset(8), frame_spec(c))
pages = int(Path("/proc/self/statm").read_text().split()[0])
resource.setrlimit(resource.RLIMIT_AS, (pages * resource.getpagesize() + 400_000_000,) * 2)
try:
    fit(c, frames, frames, Path({str(tmp_path)!r}), machines=Machines(1))
except ConfigError as error:
    print(error)
"""
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert "too little memory for batches of 8 frames: " in done.stdout


def test_another_runs_folder_is_not_overwritten(tmp_path: Path) -> None:
    c = config("lifting", epochs=1)
    fit(c, frames(c), frames(c), tmp_path, machines=ONE)
    with pytest.raises(ConfigError, match="already holds") as caught:
        fit(c, frames(c), frames(c), tmp_path, machines=ONE)
    assert "--resume" in caught.value.hint
    with pytest.raises(ModelError, match="another epochs, batch"):
        fit(config("lifting", epochs=2, batch=2), frames(c), frames(c), tmp_path, start=Start(resume=True), machines=ONE)


def test_a_checkpoint_of_another_network_is_refused(checkpoints: dict[str, Path], tmp_path: Path) -> None:
    with pytest.raises(ModelError, match="another method, settings"):
        check_same(checkpoints["compact"], complete(config("unet"), frames(config("unet"))))
    data = torch.load(checkpoints["lifting"], weights_only=False)
    data["hyper_parameters"]["config"]["settings"]["width"] = 32
    torch.save(data, tmp_path / "other.ckpt")
    with pytest.raises(ModelError, match="does not fit its network"):
        load_detector(tmp_path / "other.ckpt")
    (tmp_path / "torn.ckpt").write_bytes(checkpoints["lifting"].read_bytes()[:5000])
    for name, words in (("torn.ckpt", "no checkpoint"), ("missing.ckpt", "cannot read")):
        with pytest.raises(ModelError, match=words) as caught:
            load_detector(tmp_path / name)
        assert caught.value.hint


@pytest.mark.parametrize("method", small.NETWORKS)
def test_every_method_leaves_a_best_epoch(method: str, checkpoints: dict[str, Path]) -> None:
    detector = load_detector(checkpoints[method])
    assert detector.method.name == method
    assert not detector.training
    log = curve(checkpoints[method].parent)
    assert math.isfinite(next(value for (name, _), value in log.items() if name == TASKS[METHODS[method].task].best))
    assert detector.settings.learning_rate == METHODS[method].learning_rate
    if method == "paf":
        assert set(detector.method_config.slot_anchors) == set(small.PERSONS)


def test_training_from_generated_frames(tmp_path: Path) -> None:
    c = config("compact", epochs=2)
    made = [GeneratedFrames(small.frame, count, frame_spec(c), small.PERSONS) for count in (6, 2)]
    assert fit(c, *made, tmp_path, machines=ONE).exists()
    assert made[0].epoch == 1
    assert made[1].epoch == 0


def batch_of(method: str) -> tuple[Batch, Any]:
    c = config(method)
    some = frames(c, 3)
    return collate([some[i] for i in range(3)]), Detector(c).method_config


def test_joints_are_judged_in_heads() -> None:
    batch, settings = batch_of("compact")
    truth = batch.joints.double().numpy()
    known = (batch.present[..., None] & (batch.visibility > 1)).numpy()
    uv = truth[..., :2].copy()
    uv[0] += (3.0, 4.0)
    uv[1] = np.nan
    found = Found(uv, truth, truth[..., 0], truth[..., 0])
    errors = Joints().errors(found, batch, settings)
    in_heads = 5 / (0.2 * 51.2 / truth[0, ..., 2][known[0]])
    expected = np.concatenate((in_heads, np.full(known[1].sum(), np.inf), np.zeros(known[2].sum())))
    np.testing.assert_allclose(errors, expected, atol=1e-6)
    figures = Joints().figures([errors])
    assert figures["val_pckh"] == pytest.approx(100 * np.mean(expected <= 0.5))
    thresholds = np.linspace(0, 0.5, 20001)
    area = np.mean([(expected <= t).mean() for t in thresholds])
    assert figures["val_auc"] == pytest.approx(100 * area, abs=0.02)


def test_lifted_joints_are_judged_in_space() -> None:
    batch, settings = batch_of("lifting")
    joints = TASKS["lift"].inputs(batch, settings)["pose"].numpy()
    truth = small.dataset(3)["joints_3d"].values[small.dataset(3)["subject"].values != ""]
    truth = truth[:, [list(small.dataset(3)["joint"].values).index(name) for name in settings.joints]]
    assert len(joints) == len(truth) == 6
    errors = Lift().errors(truth + np.array([0.0, 0.04, 0.03]), batch, settings)
    assert errors.shape == (6 * 14,)
    np.testing.assert_allclose(errors, 0.25, atol=1e-4)


def test_parts_are_judged_by_iou() -> None:
    batch, settings = batch_of("unet")
    truth = class_table(MERGED)[batch.labels.numpy()]
    said = truth.copy()
    head, torso = 1, 2
    assert set(np.unique(truth)) == {0, head, torso}
    said[truth == head] = torso
    figures = Parts().figures([Parts().errors(said[:2], batch._replace(labels=batch.labels[:2]), settings)] * 2)
    t, s = truth[:2], said[:2]
    iou = ((t == torso) & (s == torso)).sum() / ((t == torso) | (s == torso)).sum()
    assert figures["val_iou"] == pytest.approx(100 * (0 + iou) / 2)
    assert figures["val_person_iou"] == pytest.approx(100)
    assert Parts().figures([]) == {}


def test_advice_is_left_out(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    c = config("lifting", epochs=1)
    fit(c, frames(c), frames(c), tmp_path, machines=ONE)
    captured = capfd.readouterr()
    for noise in ("💡", "Tip", "available:", "does not have many workers", "Seed set"):
        assert noise not in captured.out + captured.err


def test_a_run_begins_with_the_weights_of_another(checkpoints: dict[str, Path], tmp_path: Path) -> None:
    """With a rate that moves nothing, the run ends with the weights that it began with."""
    c = config("compact", epochs=1, learning_rate=1e-12, weight_decay=0.0, average=0.0)
    begun = load_detector(
        fit(c, frames(c), frames(c), tmp_path / "begun", start=Start(init=checkpoints["compact"]), machines=ONE)
    )
    fresh = load_detector(fit(c, frames(c), frames(c), tmp_path / "fresh", machines=ONE))
    before = dict(load_detector(checkpoints["compact"]).network.named_parameters())
    assert all(torch.allclose(value, before[name], atol=1e-8) for name, value in begun.network.named_parameters())
    assert not all(torch.allclose(value, before[name], atol=1e-8) for name, value in fresh.network.named_parameters())


def test_averages_of_weights_are_those_of_their_definition() -> None:
    """m <- k m + (1 - k) w with k = min((1 + n) / (10 + n), decay); a counter is that of the newest weights."""
    network = nn.BatchNorm1d(2)
    averaged = AveragedModel(network, multi_avg_fn=_moving_average(0.25), use_buffers=True)
    averaged.update_parameters(network)  # the first is taken over
    mean = 1.0
    for n, weight in enumerate((3.0, -2.0, 5.0, 7.0), start=1):
        nn.init.constant_(network.weight, weight)
        cast(torch.Tensor, network.num_batches_tracked).fill_(10 * n)
        averaged.update_parameters(network)
        kept = min((1 + n) / (10 + n), 0.25)
        mean = kept * mean + (1 - kept) * weight
        assert averaged.module.weight[0].item() == pytest.approx(mean, rel=1e-6)
        assert averaged.module.num_batches_tracked.item() == 10 * n


@pytest.mark.slow
def test_a_short_run_is_not_judged_by_the_weights_it_began_with(checkpoints: dict[str, Path], tmp_path: Path) -> None:
    """After eight steps the average, of a decay made for thousands, has come as far as half of the way of the weights."""
    before = dict(load_detector(checkpoints["compact"]).network.named_parameters())
    moved = []
    for average in (0.0, 0.998):
        c = config("compact", average=average)
        run = fit(c, frames(c), frames(c), tmp_path / str(average), start=Start(init=checkpoints["compact"]), machines=ONE)
        weights = load_detector(run.with_name("last.ckpt")).network.named_parameters()
        moved.append(sum(float(((value - before[name]) ** 2).sum().detach()) for name, value in weights) ** 0.5)
    assert 0.5 < moved[1] / moved[0] < 1.0


@pytest.mark.parametrize(("method", "before", "slot"), [("compact", ("driver",), "rear_left"), ("paf", small.PERSONS, "driver")])
def test_a_run_begins_with_a_network_of_other_places(
    method: str, before: tuple[str, ...], slot: str, checkpoints: dict[str, Path], tmp_path: Path
) -> None:
    """The only place, or of a network to which they are nothing; its weights are those of the other one, and that is told."""
    other = checkpoints[method]
    if before != small.PERSONS:
        c = config(method, settings=small.TINY[method] | {"slots": before}, epochs=1)
        other = fit(c, frames(c), frames(c), tmp_path / "other", machines=ONE)
    c = config(method, settings=small.TINY[method] | {"slots": (slot,)}, learning_rate=1e-12, weight_decay=0.0, average=0.0)
    with pytest.warns(UserWarning, match=f"has learnt other places: {', '.join(before)}"):
        run = fit(c, frames(c), frames(c), tmp_path / "run", start=Start(init=other), machines=ONE)
    mine, theirs = (dict(load_detector(path).network.named_parameters()) for path in (run, other))
    assert mine.keys() == theirs.keys()
    for name, value in mine.items():
        torch.testing.assert_close(value, theirs[name], atol=1e-6, rtol=0)


@pytest.mark.parametrize("method", small.NETWORKS)
def test_networks_say_whether_they_know_places(method: str) -> None:
    sizes = []
    for slots in (small.PERSONS, small.PERSONS[:2]):
        network = Detector(config(method, settings=small.TINY[method] | {"slots": slots})).network
        sizes.append({name: value.shape for name, value in network.state_dict().items()})
    known = METHODS[method]
    assert isinstance(known, NetworkMethod)
    assert known.of_places == (sizes[0] != sizes[1])


@pytest.mark.parametrize("change", [{"channels": (8, 16, 24, 32)}])
def test_a_run_does_not_begin_with_another_network(change: dict[str, Any], checkpoints: dict[str, Path], tmp_path: Path) -> None:
    c = config("compact", settings=small.TINY["compact"] | change)
    with pytest.raises(ModelError, match="another network"):
        fit(c, frames(c), frames(c), tmp_path, start=Start(init=checkpoints["compact"]), machines=ONE)
    c = config("lifting")
    with pytest.raises(ModelError, match="another network: "):
        fit(c, frames(c), frames(c), tmp_path, start=Start(init=checkpoints["compact"]), machines=ONE)


def test_every_batch_is_told(tmp_path: Path) -> None:
    c, told = config("compact", epochs=2, batch=2), []
    fit(c, frames(c), frames(c), tmp_path, machines=ONE, observers=Observers(lambda *state: told.append(state)))
    assert told[0] == (0, 0, "reading frames")
    done, total, notes = zip(*(state for state in told[1:] if "validating" not in state[2]), strict=True)
    assert done == tuple(range(total[0] + 1))
    assert len(set(total)) == 1
    assert notes[0] == "epoch 1 of 2"
    assert notes[1].startswith("epoch 1 of 2, loss ")
    assert notes[-1].startswith("epoch 2 of 2, loss ")
    assert TASKS["joints"].best in notes[-1]
    assert [state for state in told if "validating" in state[2]] == [
        (4, 8, "epoch 1 of 2, validating"), (8, 8, "epoch 2 of 2, validating"),
    ]  # fmt: skip


def test_a_run_stops_after_its_patience_also_when_it_is_resumed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Figures are given by the epoch: the second is the best, the fourth the last one; a ninth would be better still."""
    figures = dict(enumerate([10.0, 30.0, 20.0, 30.0, 99.0, 99.0]))
    monkeypatch.setattr(Detector, "on_validation_epoch_end", lambda self: self.log("val_auc", figures[self.current_epoch]))
    c = config("lifting", epochs=6, patience=2)
    fit(c, frames(c), frames(c), tmp_path / "whole", machines=ONE)
    with pytest.raises(KilledError):
        fit(c, frames(c), frames(c), tmp_path / "killed", observers=Observers(callbacks=(KillInEpoch(2),)), machines=ONE)
    for _ in range(2):  # the second time there is nothing left to do
        fit(c, frames(c), frames(c), tmp_path / "killed", start=Start(resume=True), machines=ONE)
        assert curve(tmp_path / "whole") == pytest.approx(curve(tmp_path / "killed"), rel=1e-6)
    assert [value for (name, _), value in curve(tmp_path / "whole").items() if name == "val_auc"] == [10, 30, 20, 30]
    assert torch.load(tmp_path / "whole" / "best.ckpt", weights_only=True)["epoch"] == 1


def test_the_validation_loss_is_that_of_the_plain_frames_and_decides_where_it_is_asked_to(tmp_path: Path) -> None:
    c = config("compact", epochs=3, average=0.0, best_by="loss", batch=3)
    some = frames(c)
    best = fit(c, some, some, tmp_path, machines=ONE)
    losses = {step: value for (name, step), value in curve(tmp_path).items() if name == "val_loss"}
    detector = load_detector(tmp_path / "last.ckpt")
    with torch.no_grad():
        parts = [collate([some[i] for i in part]) for part in ([0, 1, 2], [3, 4, 5], [6, 7])]
        each = [detector.method.loss(detector.network, part)["loss"].item() * len(part.joints) for part in parts]
    assert losses[max(losses)] == pytest.approx(sum(each) / 8, rel=1e-4)
    step = torch.load(best, weights_only=True)["global_step"]
    assert losses[step] == min(losses.values())


def test_the_optimiser_and_its_rate_are_those_that_are_asked_for() -> None:
    c = config("compact", optimiser="adam", schedule="constant", learning_rate=4e-4, weight_decay=0.01)
    optimiser = Detector(c).configure_optimizers()  # nothing else: no schedule
    assert type(optimiser) is torch.optim.Adam
    assert [group["weight_decay"] for group in optimiser.param_groups] == [0.01, 0.0]
    assert {group["lr"] for group in optimiser.param_groups} == {4e-4}


class _Spy:
    """What runs when it is unpickled."""

    def __init__(self, trace: Path) -> None:
        self._trace = trace

    def __reduce__(self) -> tuple[Any, ...]:
        return Path.touch, (self._trace,)


def test_code_in_a_checkpoint_does_not_run(checkpoints: dict[str, Path], tmp_path: Path) -> None:
    data = torch.load(checkpoints["compact"], weights_only=True)
    torch.save(data | {"extra": _Spy(tmp_path / "ran")}, tmp_path / "crafted.ckpt")
    with pytest.raises(ModelError, match="no checkpoint") as caught:
        load_detector(tmp_path / "crafted.ckpt")
    assert caught.value.hint
    assert not (tmp_path / "ran").exists()


def test_keywords_of_before_warn_and_mean_the_same(tmp_path: Path) -> None:
    c, told = config("lifting", epochs=1), []
    with (
        pytest.warns(DeprecationWarning, match=r"fit\(devices=...\) is fit\(machines=Machines\(devices=...\)\) now"),
        pytest.warns(DeprecationWarning, match=r"fit\(progress=...\) is fit\(observers=Observers\(progress=...\)\) now"),
    ):
        best = fit(c, frames(c), frames(c), tmp_path, devices=1, progress=lambda *state: told.append(state))
    assert best.exists()
    assert told
    with pytest.raises(TypeError, match="unexpected keyword argument 'device'"):
        fit(c, frames(c), frames(c), tmp_path, device=1)


@pytest.mark.parametrize(
    ("flags", "asked", "used"),
    [
        ("flags\t\t: fpu avx2 avx512f avx512_bf16\n", "bf16-mixed", "bf16-mixed"),
        ("flags\t\t: fpu avx2 avx512f amx_bf16\n", "16-mixed", "16-mixed"),
        ("Features\t: fp asimd bf16\n", "bf16-mixed", "bf16-mixed"),
        ("flags\t\t: fpu avx2 avx512f\n", "bf16-mixed", "32-true"),
        ("flags\t\t: fpu avx2\n", "16-mixed", "32-true"),
        ("flags\t\t: fpu avx2\n", "32-true", "32-true"),
        (None, "bf16-mixed", "32-true"),  # not Linux
    ],
)
def test_a_cpu_that_emulates_bfloat16_trains_in_float32_and_says_so(
    flags: str | None, asked: str, used: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    cpu = tmp_path / "cpuinfo"
    if flags is not None:
        cpu.write_text(flags)
    monkeypatch.setattr(train_config, "_CPU_INFO", cpu)
    monkeypatch.setattr(torch.cuda, "is_available", lambda: False)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", UserWarning)
        assert train_config.usable_precision(asked) == used
    told = [str(each.message) for each in caught]
    assert (told == []) == (asked == used)
    assert all(f"32-true in place of {asked}" in line and "\n" not in line for line in told)
    monkeypatch.setattr(torch.cuda, "is_available", lambda: True)
    assert train_config.usable_precision(asked) == asked


def test_a_run_in_bfloat16_is_the_one_in_float32_where_the_cpu_has_none(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(train_config, "_CPU_INFO", tmp_path / "nothing")
    monkeypatch.setattr(torch.cuda, "is_available", lambda: False)
    told = {}
    for precision in ("32-true", "bf16-mixed"):
        c = config("compact", epochs=1, precision=precision)
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always", UserWarning)
            fit(c, frames(c), frames(c), tmp_path / precision, machines=ONE)
        told[precision] = [str(each.message) for each in caught if "in place of" in str(each.message)]
    assert [len(lines) for lines in told.values()] == [0, 1]
    assert curve(tmp_path / "bf16-mixed") == curve(tmp_path / "32-true")


def test_an_epoch_of_steps_goes_on_where_the_last_one_ended() -> None:
    """Epochs of 12 of 10 frames: all frames are seen before any is seen again, in the order of whole passes."""
    seen = [frame for epoch in range(5) for frame in epoch_order(10, 12, epoch, 5)]
    passes = [frame for number in range(6) for frame in epoch_order(10, 10, number, 5)]
    assert seen == passes
    assert all(sorted(seen[i : i + 10]) == list(range(10)) for i in range(0, 60, 10))
    assert epoch_order(10, 10, 3, 5) == np.random.Generator(np.random.Philox(key=(5, 3))).permutation(10).tolist()
    assert [len(epoch_order(frames, 12, 7, 5)) for frames in (1, 5, 1000)] == [12, 12, 12]


def test_generated_frames_have_no_steps(tmp_path: Path) -> None:
    config = TrainConfig(method="compact", settings=small.TINY["compact"], epoch_steps=3)
    made = GeneratedFrames(small.frame, 4, frame_spec(config), small.PERSONS)
    with pytest.raises(ConfigError, match="epoch_steps counts batches of stored frames"):
        fit(config, made, made, tmp_path / "run")
