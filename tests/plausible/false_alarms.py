"""What is said of frames and recordings that are as they should be: each word of it is a false alarm.

    python tests/plausible/false_alarms.py [FRAMES]

Makes FRAMES (17) frames for each packaged sensor and each of six kinds of scenes, opens and looks at them as `info` does, and
asks the models that know such scenes; then looks at the sample, and at the real data that `CABINPOSE_REAL_DATA` names. Frames
whose people are nearer or farther than the sensor's range, as in rooms, show nobody: models are not asked of them. What a model
says of frames in its result is counted frame by frame: its warning comes only once.
"""

from __future__ import annotations

import contextlib
import io
import os
import sys
import tempfile
import warnings
from collections import Counter
from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np
import xarray as xr

import cabinpose
from cabinpose.app.cli import main
from cabinpose.core import FrameBatch, forget_told_cameras, without_numbers
from cabinpose.estimate import JointPredictor, load_model
from cabinpose.evaluate import frame_batch
from cabinpose.scene.sensor import SENSORS
from cabinpose.store import label_warnings, open_dataset, read_itop_frames

SCENES = {
    "cars": (("scene.cars=[suv, sedan, city_car]",), ("in_car", "paf")),
    "random cars": (("scene.cars=[]", "scene.random_cars=4"), ("in_car",)),
    "rear seats": (("scene.cars=[van, shuttle]", "camera.views={rear: 1.0}"), ("five_seats",)),
    "things": (("scene.in_hand=0.8", "scene.objects={rear_center: {box: 0.5}}"), ("in_car", "five_seats")),
    "rooms": (("scene.kind=room",), ("room",)),
    "rooms from above": (("scene.kind=room", "camera.views={room_top: 1.0}"), ("room_top",)),
}
NOISE = {"structured_light": ("noise={kind: structured_light}",)}
RECORDINGS = (("bvh", "mocap/cmu_131_01.bvh"), ("mvnx", "mocap/xsens_upper_body.mvnx"), ("c3d", "mocap/vicon_two_subjects.c3d"),
              ("azure-mkv", "tof/azure_kinect.mkv"))  # fmt: skip
LOOKS = (("room", "itop/itop_front_64.npz"), ("room_top", "itop/itop_top_64.npz"))

Said = Counter[str]


def heard(said: Said, what: str, act: Callable[[], object]) -> None:
    """Count what is warned of, or printed as a warning or an error, while something is done."""
    forget_told_cameras()
    with warnings.catch_warnings(record=True) as told, contextlib.redirect_stderr(io.StringIO()) as printed:
        warnings.simplefilter("always", UserWarning)
        with contextlib.redirect_stdout(io.StringIO()):
            act()
    lines = [str(each.message) for each in told if each.category is UserWarning]
    lines += [line for line in printed.getvalue().splitlines() if line.startswith(("warning:", "error:"))]
    said.update(f"{what}: {without_numbers(line)}" for line in lines)


def out_of_range(dataset: xr.Dataset) -> np.ndarray:
    """(F,) whether people are in the image, and fewer than a tenth of their pixels have a depth that did not wrap: no torso."""
    there, depth, true = dataset["instance"].values > 0, dataset["depth"].values, dataset["depth_clean"].values
    measured = there & (np.abs(depth - true) < 0.1 * true)  # False for NaN
    return np.asarray(measured.sum(axis=(1, 2)) < 0.1 * there.sum(axis=(1, 2)))


def asked(said: Said, what: str, model: JointPredictor, frames: FrameBatch) -> None:
    """Ask a model, and count what its result says of each frame."""
    found = model.predict(frames)
    said.update(f"frames of {what}: {without_numbers(why)}" for why in found.reason if why)


def generated(said: Said, sensor: str, scene: str, frames: int, folder: Path) -> int:
    """Make, open and look at the frames of a sensor and a kind of scene; how many are of people out of range."""
    preset, (settings, models) = SENSORS[sensor], SCENES[scene]
    options = (*settings, f"camera.sensor={sensor}", "output.drive_side=true", *NOISE.get(preset.principle, ()))
    out, what = folder / "data", f"{scene}, {sensor}"
    command = ["synth", "--frames", str(frames), "--seed", "33", "--overwrite", "--out", str(out), *options]
    heard(said, f"synth, {what}", partial(main, command))
    heard(said, f"info, {what}", partial(main, ["info", str(out)]))
    dataset = open_dataset(out)
    seen = dataset.isel(frame=np.flatnonzero(~out_of_range(dataset)))
    count = seen.sizes["frame"]
    for model in models if count else ():
        found = load_model(model, threads=1)
        if preset.principle == "structured_light" and "amplitude" in found.images:
            continue  # it has none, and the models say so
        batch = frame_batch(seen, slice(0, count), tuple(found.images))
        heard(said, f"{model}, {what}", partial(asked, said, f"{model}, {what}", found, batch))
    return frames - count


def real(said: Said, data: Path, folder: Path) -> int:
    """How many files were looked at."""
    for form, file in RECORDINGS:
        out = folder / f"{form}.mcap"
        heard(said, file, partial(main, ["import", form, str(data / file), "--out", str(out)]))
        heard(said, f"info of {file}", partial(main, ["info", str(out)]))
    for model, file in LOOKS:
        found = load_model(model, threads=1)
        heard(said, f"{model}, {file}", partial(found.predict, read_itop_frames(data / file)))
    return len(RECORDINGS) + len(LOOKS)


def run(frames: int) -> Said:
    """Look at everything, and print what was said."""
    said: Said = Counter()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        kinds = [(sensor, scene) for sensor in SENSORS.names() for scene in SCENES]
        beyond = sum(generated(said, sensor, scene, frames, folder) for sensor, scene in kinds)
        heard(said, "sample", lambda: label_warnings(cabinpose.sample()))
        data = os.environ.get("CABINPOSE_REAL_DATA")
        files = real(said, Path(data), folder) if data else 0
    made = f"{frames * len(kinds)} generated frames, {beyond} of people out of range"
    sys.stdout.write(f"{made}; {files} real files; {sum(said.values())} told\n")
    for words, count in said.most_common():
        sys.stdout.write(f"{count} x {words}\n")
    return said


if __name__ == "__main__":
    run(int(sys.argv[1]) if len(sys.argv) > 1 else 17)
