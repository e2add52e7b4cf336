"""`cabinpose bench detect`: milliseconds from a camera's frame to joints, beside networks of others."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Sequence
from functools import cache
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import onnxruntime

from benchmarks import Say
from benchmarks.opening import medians
from benchmarks.subjects import WARM, Frame, OurDetector, PeerNetwork, Run, Subject, figures, timed_run
from cabinpose.core.errors import ConfigError
from cabinpose.core.pose import OCCUPANT_SLOTS
from cabinpose.estimate.joint_predictor import JointPredictor
from cabinpose.estimate.onnx_model import BATCH
from cabinpose.estimate.predictor import load_model, packaged_detectors
from cabinpose.synth import FrameMaker
from cabinpose.synth.camera import Camera
from cabinpose.synth.config import CabinScene, SynthConfig, room_preset

AIMS = {"compact": 60.0, "paf": 8.0}  # frames a second, one at a time, on two cores
_PEOPLE = ("driver", "front_passenger")
_SHOWN = 8  # different frames, taken in turn
_VIEWS = {"room_top": "room_top"}  # of models that are meant for another view than the first one of their skeleton's scenes
_SEED = 1
_EXTRA = ("torch", "lightning", "onnx")


def run(
    *, model: Sequence[str], peer: Sequence[str], frames: int, repeats: int, threads: int, skip: Sequence[str], say: Say
) -> dict[str, Any]:
    """Measure detectors. Without torch, fresh weights and peers are left out, and named in `left_out`.

    Parameters
    ----------
    model
        ONNX files, beside the packaged models.
    peer
        Networks of others, as NAME=FILE.onnx, beside those of `peers`.
    frames, repeats
        Frames in each run of each model, and runs; models and peers take turns, so that other load on the machine affects all.
    threads
        Of ONNX Runtime.
    skip
        "fresh" leaves out the methods of `AIMS` with fresh weights, "peers" the networks of `peers`.
    say
        Called with what is being measured.

    Returns
    -------
    dict
        Of each model: frames_per_s, p50_ms, p95_ms of whole frames, one at a time, from depth and amplitude at the camera's
        resolution to joints in 3D; stages_ms: input (resampling to the model's view), network, decode, checks (whether the frame
        can be a picture of people); frames_per_s_batch: 16 frames at once; aim: the frames_per_s to reach on two cores; weights:
        fresh or file; decodes: "own", the network's outputs, or "true_joints", maps rendered from the joints of the two people in
        the frame, since with fresh weights no people would be assembled; peers_take: for each peer the p50_ms of its network over
        that of the model's whole frame.
        Of each peer: frames_per_s, p50_ms, p95_ms of the network alone; parameters_m, macs_g as published, of those of `peers`.
        Of each model and peer in a file: import_s, load_s, above_runtime_mb, see `opening`.
    """
    if min(frames, repeats, threads) < 1:
        raise ConfigError("the bench needs frames, repeats and threads", hint="give each at least 1")
    known = packaged_detectors()
    trained = [load_model(known.get(each, Path(each)), threads=threads) for each in dict.fromkeys((*known, *model))]
    lacking = [name for name in _EXTRA if find_spec(name) is None]
    left_out = [name for name in ("fresh", "peers") if name not in skip and lacking]
    if left_out:
        say(f"{' and '.join(left_out)} left out: {', '.join(lacking)} not installed (pip install 'cabinpose[train]')")
    load_before = os.getloadavg()
    with tempfile.TemporaryDirectory(prefix="cabinpose-bench-") as name:
        folder = Path(name)
        say(f"{_SHOWN} frames, and the models")
        ours = _trained(trained)
        if "fresh" not in skip and not lacking:
            ours |= _fresh(folder, threads)
        others = {} if "peers" in skip or lacking else _peers(folder, threads)
        others |= _peers_in_files(peer, threads, taken=[*ours, *others])
        subjects = ours | others
        if not subjects:
            raise ConfigError("there is nothing to measure", hint="give --model FILE, or install the extra `train`")
        runs: dict[str, list[Run]] = {name: [] for name in subjects}
        openings: dict[str, list[dict[str, float]]] = {name: [] for name in subjects}
        for number in range(repeats):
            for name, subject in subjects.items():
                say(f"run {number + 1} of {repeats}: {name}")
                runs[name].append(timed_run(subject, frames))
                openings[name].append(subject.opened(folder, threads))
        measured = {
            name: {**subject.about, **figures(subject, runs[name]), **medians(openings[name])}
            for name, subject in subjects.items()
        }
        runtime = _runtime(next(iter(subjects.values())).session)
    for name in ours:
        measured[name]["peers_take"] = {peer: measured[peer]["p50_ms"] / measured[name]["p50_ms"] for peer in others}
    return {
        "models": {name: measured[name] for name in ours},
        "peers": {name: measured[name] for name in others},
        "left_out": left_out, "frames": frames, "repeats": repeats, "warm_up": WARM, "batch": BATCH, "cores": os.cpu_count(),
        "load_average": {"before": list(load_before), "after": list(os.getloadavg())}, "runtime": runtime,
    }  # fmt: skip


def _trained(predictors: Sequence[JointPredictor]) -> dict[str, Subject]:
    """Models in files, by their names; those that share one are told apart by their files."""
    names = [predictor.name for predictor in predictors]
    subjects: dict[str, Subject] = {}
    for predictor in predictors:
        name = predictor.name if names.count(predictor.name) == 1 else str(predictor.model.path)
        shown = bench_frames(predictor.skeleton, _VIEWS.get(predictor.name, ""))
        subjects[name] = OurDetector(predictor, shown, weights="file", decodes="own", **_about(predictor, shown))
    return subjects


def _fresh(folder: Path, threads: int) -> dict[str, Subject]:
    """The methods that have an aim, with fresh weights; needs torch."""
    from benchmarks.fresh import fresh_detector  # noqa: PLC0415 - torch is an extra

    subjects: dict[str, Subject] = {}
    for method in AIMS:
        shown = bench_frames("cabinpose")
        made = fresh_detector(method, shown, folder)
        predictor = load_model(made.path, threads=threads)
        about = {"weights": "fresh", "decodes": "own" if made.answers is None else "true_joints", "parameters": made.parameters}
        subjects[f"{method}_fresh"] = OurDetector(predictor, shown, made.answers, **about, **_about(predictor, shown))
    return subjects


def _peers(folder: Path, threads: int) -> dict[str, Subject]:
    """The networks of others; needs torch."""
    from benchmarks.peers import PEERS  # noqa: PLC0415 - torch is an extra

    subjects: dict[str, Subject] = {}
    for name, peer in PEERS.items():
        path = folder / f"{name}.onnx"
        peer.export(path)
        about = {"sees": peer.sees, "parameters_m": peer.parameters_m, "macs_g": peer.macs_g}
        subjects[name] = PeerNetwork(path, threads=threads, weights="fresh", **about)
    return subjects


def _peers_in_files(named: Sequence[str], threads: int, taken: Sequence[str]) -> dict[str, Subject]:
    """Those of `--peer NAME=FILE.onnx`; ConfigError for other words or names that are taken, and for a graph that takes images of
    any size.
    """
    subjects: dict[str, Subject] = {}
    for words in named:
        name, _, file = words.partition("=")
        if not name or not file or name in (*subjects, *taken):
            raise ConfigError(f"{words} names no network of others", hint="give --peer NAME=FILE.onnx, each name once")
        if not Path(file).is_file():
            raise ConfigError(f"there is no network {file}", hint="give --peer NAME=FILE.onnx")
        subjects[name] = PeerNetwork(Path(file), threads=threads, weights="file", sees="")
    return subjects


@cache
def bench_frames(skeleton: str, view: str = "") -> tuple[Frame, ...]:
    """The frames that models of a skeleton are timed on: driver and front passenger from the front row's view at 352 x 287; for
    ITOP's skeleton one person in a room at 320 x 240, from the front or from the view that is named.
    """
    if skeleton == "itop":
        config = room_preset()
        if view:
            config = config.model_copy(update={"camera": config.camera.model_copy(update={"views": {view: 1.0}})})
    else:
        occupancy = {slot: float(slot in _PEOPLE) for slot in OCCUPANT_SLOTS}
        config = SynthConfig(
            scene=CabinScene(cars=("sedan",), occupancy=occupancy, right_hand_drive=0.0),
            camera=Camera(sensor="pico_monstar_105", views={"front_row": 1.0}),
        )
    maker = FrameMaker(config, _SEED)
    return tuple(maker.make(index)[0] for index in range(_SHOWN))


def _about(predictor: JointPredictor, frames: Sequence[Frame]) -> dict[str, Any]:
    view = predictor.config.view
    return {
        "method": predictor.model.method.name,
        "aim": AIMS.get(predictor.model.method.name),
        "camera": list(frames[0]["depth"].shape[::-1]),
        "view": [view.width, view.height],
        "people": sum(subject != "" for subject in frames[0]["subject"]),
    }


def _runtime(session: onnxruntime.InferenceSession) -> dict[str, Any]:
    """What ONNX Runtime ran with; every session of a bench is opened alike."""
    options = session.get_session_options()
    return {
        "onnxruntime": onnxruntime.__version__,
        "providers": session.get_providers(),
        "intra_op_num_threads": options.intra_op_num_threads,
        "inter_op_num_threads": options.inter_op_num_threads,
        "execution_mode": options.execution_mode.name,
        "graph_optimization_level": options.graph_optimization_level.name,
    }
