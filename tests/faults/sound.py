"""Sound files of every format that is read, made anew in a folder, and their readers as commands use them."""

from __future__ import annotations

import io
import shutil
import sys
from collections.abc import Callable
from contextlib import closing
from functools import cache
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).parents[1] / "store"))
sys.path.insert(0, str(Path(__file__).parents[1] / "cli"))
sys.path.insert(0, str(Path(__file__).parents[1] / "estimate"))

import numpy as np
import small
import sphere_people
import trimesh
import xarray as xr
import yaml
from mutations import Read
from PIL import Image
from scipy.io import savemat
from test_fuzz import rows
from test_import import coco_file, itop_folder
from test_import_ntu import by_hand
from ticam_folder import ticam_folder

from cabinpose.app.lab.takes import Truth
from cabinpose.app.label.corrections import corrections
from cabinpose.app.label.labelling import Labelling, open_labels
from cabinpose.app.live.feed import EveryFrame
from cabinpose.core import Part
from cabinpose.core.pose import OCCUPANT_SLOTS, Visibility
from cabinpose.core.skeleton import JOINTS
from cabinpose.estimate import METHODS, ArrayMethod, AugmentConfig, load_model
from cabinpose.estimate.array_model import write_arrays
from cabinpose.evaluate import frame_batch
from cabinpose.record.sources import SOURCES
from cabinpose.scene.cabin.meshfile import read_mesh
from cabinpose.signals import Channels, Facts, HostClock, Sample, SegmentPoses, ToFFrame
from cabinpose.store import open_dataset, read_itop_frames, read_itop_reference
from cabinpose.store.class_images import read_class_images, write_class_images
from cabinpose.store.convert import FORMATS, LabelFormat, NoOptions, export_dataset, import_recording, open_source, read_clip
from cabinpose.store.frames import write_png
from cabinpose.store.labels import JointLabel, Labels, read_labels, with_labels
from cabinpose.store.predictions import Predictions, write_predictions
from cabinpose.store.recording import Chunking, Recording, RecordingWriter, Take, recover, survey

ANNOTATIONS = "annotations/person_keypoints.json"


def mesh(path: Path) -> None:
    read_mesh(path, up_axis="y", front_axis="z", unit="m")


def load(folder: Path) -> None:
    open_dataset(folder, missing="ignore").load()


def itop_arrays(path: Path) -> None:
    read_itop_frames(path)
    read_itop_reference(path)


def exported(kind: str) -> Callable[[Path], bytes]:
    def make(folder: Path) -> bytes:
        path = folder / f"sound.{kind}"
        trimesh.creation.box((1.8, 1.3, 4.2)).export(path)
        return path.read_bytes()

    return make


def recording(folder: Path) -> bytes:
    path = folder / "sound.mcap"
    path.unlink(missing_ok=True)
    take = Take.model_validate({"action": "sit", "subjects": [{"code": "S01"}]})
    with RecordingWriter(path, take, started_ns=1000, chunking=Chunking(sync_s=0, flush_s=1e9, definitions_s=1e9)) as writer:
        for host_ns, device_ns, message in rows(SegmentPoses, Channels, Facts, frames=4):
            writer.write("suit", Sample(None, host_ns + 1000, device_ns, b"raw", (message,)))
    return path.read_bytes()


def filmed(folder: Path) -> bytes:
    """Frames of a camera."""
    path = folder / "sound.mcap"
    path.unlink(missing_ok=True)
    k, image = np.array([[12.0, 0, 7.5], [0, 12.0, 5.5], [0, 0, 1]]), np.arange(192, dtype=np.uint16).reshape(12, 16)
    with RecordingWriter(path, Take(), started_ns=1000, chunking=Chunking(sync_s=0, flush_s=1e9, definitions_s=1e9)) as writer:
        for i in range(4):
            frame = ToFFrame(image + i, 0.0001, image, (image % 256).astype(np.uint8), k, np.zeros(5), np.zeros(5))
            assert not writer.write("tof", Sample(i, 1000 + 100 * i, 100 * i, b"raw", (frame,)))
    return path.read_bytes()


def read_recording(path: Path) -> None:
    survey(path)
    with Recording(path, damaged="skip") as opened:
        for _ in opened.samples():
            pass
    out = path.with_name("recovered.mcap")
    out.unlink(missing_ok=True)
    recover(path, out)


def imported(name: str) -> Read:
    def read(path: Path) -> None:
        import_recording(path, name, path.with_name("imported.mcap"), overwrite=True)

    return read


def dataset(folder: Path) -> Path:
    manifest = sphere_people.manifest(frames=2, frames_per_part=2, width=16, height=12)
    shutil.rmtree(folder, ignore_errors=True)
    return Path(sphere_people.write(folder, manifest))


def frames_of(kind: str, **options: Any) -> Callable[[Path], None]:
    def read(path: Path) -> None:
        source = open_source(path, kind, **options)
        for _ in source.frames():
            pass

    return read


def itop(folder: Path) -> Path:
    shutil.rmtree(folder, ignore_errors=True)
    folder.parent.mkdir(exist_ok=True, parents=True)
    return itop_folder(folder)


def coco(folder: Path) -> Path:
    folder.mkdir(exist_ok=True, parents=True)
    coco_file(folder / "people.json")
    return folder


def ntu(folder: Path) -> Path:
    shutil.rmtree(folder, ignore_errors=True)
    clip = by_hand(folder)
    (folder / clip.stem).mkdir()
    for i in range(1, 5):
        write_png(folder / clip.stem / f"Depth-{i:08d}.png", np.full((424, 512), 1000 + i, np.uint16))
    return folder


def ticam(folder: Path) -> Path:
    return ticam_folder(folder) / "Train_images"


OPENCV = {
    "image_width": 16, "image_height": 12, "camera_matrix": {"rows": 3, "cols": 3, "data": [12.0, 0, 7.5, 0, 12.0, 5.5, 0, 0, 1]},
    "distortion_coefficients": {"rows": 1, "cols": 5, "data": [-0.1, 0.01, 0.0, 0.0, 0.0]},
}  # fmt: skip


def depth_image(suffix: str) -> Callable[[Path], bytes]:
    """A ramp from 0.5 m: whole millimetres as PNG, metres otherwise."""

    def make(folder: Path) -> bytes:
        depth = np.linspace(0.5, 2.0, 192, dtype=np.float32).reshape(12, 16)
        path = folder / f"ramp{suffix}"
        if suffix == ".npy":
            np.save(path, depth)
        else:
            Image.fromarray((depth * 1000).astype(np.uint16) if suffix == ".png" else depth).save(path)
        return path.read_bytes()

    return make


def depth_images(path: Path) -> None:
    frames_of("depth-images", fov_deg=60.0)(path)


LAID_OUT = {
    "depth": {"files": "{frame}.png", "unit": "mm"},
    "joints": {
        "files": "rows.csv", "definition": "anatomy", "names": {"lwrist": "W"},
        "values": {"frame": "image", "x": "{joint}.x", "y": "{joint}.y", "z": "{joint}.z", "visibility": "{joint}.seen"},
        "states": {"0": "absent", "2": "visible"},
    },
    "camera": {"fx": 12.0, "fy": 12.0, "cx": 7.5, "cy": 5.5},
}  # fmt: skip
OF_ARRAYS = {"files": "all.mat", "variable": "out/pose", "definition": "kinect_v2", "names": {"lwrist": 0, "rwrist": 1}}


def laid_out(folder: Path, **changes: Any) -> Path:
    """Somebody's folder of two frames, and its layout."""
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    for number in range(2):
        Image.fromarray(np.full((12, 16), 900 + number, np.uint16)).save(folder / f"{number}.png")
    (folder / "rows.csv").write_text("image,W.x,W.y,W.z,W.seen\n0,0.1,0.2,0.9,2\n1,0.1,0.2,0.9,0\n")
    savemat(folder / "all.mat", {"out": {"pose": np.ones((2, 2, 3))}})
    (folder / "layout.yaml").write_text(yaml.safe_dump(LAID_OUT | changes))
    return folder


def laid_out_by_arrays(folder: Path) -> Path:
    return laid_out(folder, joints=OF_ARRAYS)


def frames_of_layout(folder: Path) -> None:
    frames_of("folder", layout=folder / "layout.yaml")(folder)


def shown_as(kind: str, **options: Any) -> Callable[[Path], Path]:
    """A dataset exported."""

    def make(folder: Path) -> Path:
        data = open_dataset(dataset(folder.with_name(f"{folder.name}-of")))
        return export_dataset(data, kind, folder, overwrite=folder.exists(), **options)

    return make


def pictures(folder: Path) -> Path:
    """COCO's images as JPEG."""
    coco(folder)
    for name in ("1", "2", "3"):
        Image.fromarray(np.arange(36_000, dtype=np.uint8).reshape(100, 120, 3)).save(folder / f"{name}.png", "JPEG")
    return folder


def of_pictures(folder: Path) -> None:
    frames_of("coco", images=folder)(folder / "people.json")


def labelled(folder: Path) -> bytes:
    return (shown_as("coco", images="depth16")(folder / "shown") / ANNOTATIONS).read_bytes()


def corrected(folder: Path) -> Callable[[Path], None]:
    """The reading of a COCO file, its joints held against those of the dataset."""
    images = open_dataset(dataset(folder / "corrected")).load()
    form = FORMATS["coco-labels"]
    assert isinstance(form, LabelFormat)

    def read(path: Path) -> None:
        with closing(open_labels(folder / "corrected.jsonl", images)) as labels:
            corrections(Labelling(images, labels), path, form.read(path, NoOptions()))

    return read


def journal(folder: Path) -> bytes:
    path = folder / "sound.jsonl"
    path.unlink(missing_ok=True)
    labels = Labels(path, "id", OCCUPANT_SLOTS, JOINTS)
    placed = JointLabel((10.0, 20.5), (0.1, 0.2, 0.9), Visibility.VISIBLE)
    labels.set([((i, "driver", "head"), placed) for i in range(4)] + [((1, "driver", "neck"), None)], role="a", how="placed")
    labels.close()
    return path.read_bytes()


def read_journal(path: Path) -> None:
    with_labels(sphere_labels(), read_labels(path)[1])
    Labels(path, "id", OCCUPANT_SLOTS, JOINTS).close()


@cache
def sphere_labels() -> xr.Dataset:
    return small.dataset(3)


def class_images(folder: Path) -> Path:
    path = folder / "images.zarr"
    image = np.arange(2 * 12 * 16, dtype=np.uint8).reshape(2, 12, 16) % 3
    folder.mkdir(exist_ok=True, parents=True)
    write_class_images(path, [image], np.arange(2), [Part("a", (14,)), Part("b", (29,))], model="m", overwrite=path.exists())
    return path


def read_classes(path: Path) -> None:
    found = read_class_images(path)
    found.segment({"depth": np.zeros((3, 12, 16), np.float32), "frame": np.arange(3)})  # type: ignore[typeddict-item]


def truth(folder: Path) -> bytes:
    """Of the virtual laboratory: two samples of everything."""
    eye, stamps = np.eye(4), np.arange(2)
    Truth(
        suit_ns=stamps, optical_ns=stamps, tof_ns=stamps, suit_position=np.zeros((2, 23, 3)),
        suit_orientation_wxyz=np.ones((2, 23, 4)), world_from_object=np.stack([eye, eye]), object_seen=np.ones((2, 4), bool),
        joints_3d=np.ones((2, 20, 3)), joints_2d=np.ones((2, 20, 2)), visibility=np.ones((2, 20), np.uint8),
        camera_from_world=eye, world_from_scene=eye, suit_from_world=eye, object_from_head=eye, hands=np.zeros((2, 3)),
        windows=np.array(["flexion"]), window_ns=np.zeros((1, 2), np.int64), actions=np.array(["drive", "drive"]), rig="{}",
    ).save(folder / "sound.npz")  # fmt: skip
    return (folder / "sound.npz").read_bytes()


def fitted(name: str, **settings: Any) -> Callable[[Path], bytes]:
    """A model that is arrays, learnt from a few frames."""

    def make(folder: Path) -> bytes:
        from cabinpose.estimate import StoredFrames, TrainConfig, frame_spec  # torch, four seconds

        method = METHODS[name]
        assert isinstance(method, ArrayMethod)
        run = TrainConfig(method=name, settings={"width": 64, "height": 48, "focal": 51.2, "slots": small.PERSONS} | settings)
        config, stored = method.settings(run.settings), StoredFrames(small.dataset(8), frame_spec(run))
        frames = [stored[i] for i in range(8)]
        arrays = method.fit(config, frames, AugmentConfig(flip=0.0), lambda *_: None, seed=0)
        write_arrays(folder / "sound.npz", name, config, arrays, name=name, card={})
        return (folder / "sound.npz").read_bytes()

    return make


def find(path: Path) -> None:
    load_model(path).predict(frame_batch(small.dataset(2), slice(None)))


def gltf(_: Path) -> bytes:
    scene = trimesh.Scene(trimesh.creation.box((1.8, 1.3, 4.2)))
    return bytes(trimesh.exchange.gltf.export_gltf(scene, merge_buffers=True, embed_buffers=True)["model.gltf"])


def training(_: Path) -> bytes:
    from cabinpose.estimate import TrainConfig

    return yaml.safe_dump(TrainConfig().model_dump(mode="json")).encode()


def read_training(path: Path) -> None:
    from cabinpose.estimate import read_train_config

    read_train_config(path, None)


def checkpoint(_: Path) -> bytes:
    import torch

    from cabinpose.estimate import TrainConfig
    from cabinpose.estimate.training import Detector

    torch.set_num_threads(1)
    config = TrainConfig(method="lifting", settings=small.TINY["lifting"])
    file = io.BytesIO()
    state = Detector(config).state_dict()
    torch.save({"hyper_parameters": {"config": config.model_dump(mode="json")}, "state_dict": state}, file)
    return file.getvalue()


def read_weights_of(path: Path) -> None:
    from cabinpose.estimate.training import load_detector

    load_detector(path)


def of_vgg(path: Path) -> None:
    from cabinpose.synth.style.encoder import vgg19

    vgg19(path)


def exported_weights(path: Path) -> None:
    from cabinpose.estimate.weights import read_weights

    read_weights(path)


def clip(path: Path) -> None:
    """The clip of a motion profile."""
    read_clip(path, unit_m=0.01, up="y")


def played(kind: str) -> Read:
    """A file as a camera, as fast as it is read."""

    def read(path: Path) -> None:
        clock = HostClock()
        feed = EveryFrame(SOURCES[kind]("camera", SOURCES[kind].Settings(path=path, speed=0.0), clock), clock)
        feed.start()
        try:
            for _ in feed.frames():
                pass
        finally:
            feed.stop()

    return read


def saved(**arrays: Any) -> Callable[[Path], bytes]:
    def make(_: Path) -> bytes:
        file = io.BytesIO()
        np.savez_compressed(file, **arrays)
        return file.getvalue()

    return make


def _predictions() -> Predictions:
    shape = (3, 1, 2)
    return Predictions(
        frame=np.arange(3), persons=("driver",), joints=("head", "neck"), model="m", joints_2d=np.ones((*shape, 2), np.float32),
        joints_3d=np.ones((*shape, 3), np.float32), score=np.ones(shape, np.float32), presence=np.ones(shape, np.float32),
        expected_error_m=np.full(shape, np.nan, np.float32),
    )  # fmt: skip


def predictions(folder: Path) -> bytes:
    write_predictions(folder / "sound.jsonl", _predictions(), overwrite=True)
    return (folder / "sound.jsonl").read_bytes()


def parquet(folder: Path) -> bytes:
    write_predictions(folder / "sound.parquet", _predictions(), overwrite=True)
    return (folder / "sound.parquet").read_bytes()


def text(value: Any) -> Callable[[Path], bytes]:
    return lambda _: yaml.safe_dump(value).encode()
