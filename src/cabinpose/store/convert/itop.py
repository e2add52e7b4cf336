"""ITOP's HDF5 layout (Haque et al. 2016, "Towards viewpoint invariant 3D human pose estimation"): one person a frame.

`depth_map.h5` has `id` and `data` (n, H, W) float16 m; `labels.h5` has `id`, `is_valid`, `visible_joints` (n, 15) int16,
`image_coordinates` (n, 15, 2) int16 px, `real_world_coordinates` (n, 15, 3) float16 m and `segmentation` (n, H, W) int8:
the index of the joint whose body part a pixel shows, -1 for the background. Its camera frame has y up, ours down. ITOP's
images are 320x240; other sizes keep theirs. `id` is subject and frame, "XX_YYYYY". ITOP's files do not say their intrinsics;
what is exported has them beside the depth, as `camera_k` (n, 3, 3) and `camera_dist` (n, 5).
"""

from __future__ import annotations

from pathlib import Path
from types import MappingProxyType

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from cabinpose.core import CABINPOSE, ITOP, DatasetError, Visibility
from cabinpose.store.frames import frames, label_table, people, require_variables
from cabinpose.store.itop import hdf5
from cabinpose.store.lazy import camera_of
from cabinpose.store.source import Report

# Joint of ours whose visibility stands for one of ITOP's, and whose position does where the dataset has no
# `itop_joints_3d`: ITOP's hand is the palm and its foot the front of the foot.
_OURS = MappingProxyType(
    {"torso": "chest", "rhip": "rpelvis", "lhip": "lpelvis"} | {n: n for n in ITOP.joints if n in CABINPOSE.index}
)  # fmt: skip
# Beginning of a body part's name -> ITOP's joint; a trailing _left or _right chooses the side.
_PART_JOINT = MappingProxyType(
    {
        "head": "head", "hair": "head", "headwear": "head", "glasses": "head", "neck": "neck", "torso": "torso",
        "hip_center": "torso", "shoulder": "{}shoulder", "upper_arm": "{}shoulder", "elbow": "{}elbow", "forearm": "{}elbow",
        "wrist": "{}hand", "hand": "{}hand", "hip": "{}hip", "thigh": "{}hip", "knee": "{}knee", "shin": "{}knee",
        "ankle": "{}foot", "foot": "{}foot",
    }
)  # fmt: skip


def export(dataset: xr.Dataset, folder: Path, report: Report) -> None:
    """Write every frame of `dataset` into `folder`; `DatasetError` where a frame shows more than one person.

    The dataset has to have depth, classes and instances.
    """
    require_variables(dataset, "ITOP's layout", ("depth", "labels", "instance"))
    count, (height, width) = dataset.sizes["frame"], dataset["depth"].shape[1:]
    segmentation_of = segmentation_table(dataset)
    subjects = sorted({str(s) for s in dataset["subject"].values.ravel() if s})
    h5py = hdf5()
    with h5py.File(folder / "depth_map.h5", "w") as depth_file, h5py.File(folder / "labels.h5", "w") as label_file:
        # Equal datasets give equal bytes: no times in the files, and not LZF, whose output depends on stale memory.
        image = {"shape": (count, height, width), "chunks": (1, height, width), "track_times": False}
        image |= {"compression": "gzip", "compression_opts": 1, "shuffle": True}
        data = depth_file.create_dataset("data", dtype="f2", **image)
        segmentation = label_file.create_dataset("segmentation", dtype="i1", **image)
        ids = np.zeros(count, "S8")
        valid = np.zeros(count, np.uint8)
        visible = np.zeros((count, 15), np.int16)
        uv = np.zeros((count, 15, 2), np.int16)
        xyz = np.zeros((count, 15, 3), np.float16)
        for i, frame in enumerate(frames(dataset, ("depth", "labels", "instance"))):
            persons = people(frame)
            if len(persons) > 1:
                raise DatasetError(
                    f"frame {int(frame['frame'])} shows {len(persons)} people, ITOP's layout holds one",
                    hint="select frames with one person (for example with a scene of kind room), or export as coco",
                )
            data[i] = np.nan_to_num(frame["depth"].values).astype(np.float16)
            ids[i] = f"{0:02d}_{i:05d}".encode()
            segmentation[i] = -1
            if persons:
                person = persons[0]
                ids[i] = f"{subjects.index(person.subject) % 100:02d}_{i:05d}".encode()
                joints = itop_joints(frame, person.position)
                valid[i] = np.isfinite(joints).all()
                visible[i] = person.visibility[[CABINPOSE.index[_OURS[name]] for name in ITOP.joints]] == Visibility.VISIBLE
                uv[i] = np.rint(np.nan_to_num(camera_of(frame, width, height).project(joints))).astype(np.int16)
                xyz[i] = np.nan_to_num(joints * (1, -1, 1))
                mine = frame["instance"].values == person.position + 1
                segmentation[i] = np.where(mine, segmentation_of[frame["labels"].values], -1)
            report(i + 1)
        small = {
            "id": ids, "is_valid": valid, "visible_joints": visible, "image_coordinates": uv, "real_world_coordinates": xyz,
        }  # fmt: skip
        intrinsics = {name: dataset[name].values for name in ("camera_k", "camera_dist")}
        for name, values in ({"id": ids} | intrinsics).items():
            depth_file.create_dataset(name, data=values, track_times=False)
        for name, values in small.items():
            label_file.create_dataset(name, data=values, track_times=False)


def itop_joints(frame: xr.Dataset, position: int) -> NDArray[np.float64]:
    """(15, 3) ITOP's joints in our camera frame: as the dataset has them, or the nearest of ours.

    Without `itop_joints_3d`, the torso is put midway between chest and hip; head stays at the skull base.
    """
    if "itop_joints_3d" in frame:
        return np.asarray(frame["itop_joints_3d"].values[position], np.float64)
    ours = np.asarray(frame["joints_3d"].values[position], np.float64)
    joints = ours[[CABINPOSE.index[_OURS[name]] for name in ITOP.joints]]
    joints[ITOP.joints.index("torso")] = (ours[CABINPOSE.index["chest"]] + ours[CABINPOSE.index["hip"]]) / 2
    return joints


def segmentation_table(dataset: xr.Dataset) -> NDArray[np.int8]:
    """(256,) ITOP's joint index by our class id, -1 for everything that is no part of a person."""
    table = np.full(256, -1, np.int8)
    for row in label_table(dataset):
        stem, _, side = row["name"].rpartition("_")
        joint = _PART_JOINT.get(row["name"]) or (_PART_JOINT.get(stem) if side in ("left", "right") else None)
        if joint is not None:
            table[row["id"]] = ITOP.joints.index(joint.format(side[:1]))
    return table
