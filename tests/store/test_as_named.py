"""Places and joints of a dataset by other names: what is where, what nobody has, and what is refused."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import sphere_people
import xarray as xr

from cabinpose.core.errors import CabinposeError
from cabinpose.core.skeleton import CABINPOSE, ITOP, JOINTS
from cabinpose.store import as_named, dataset_skeleton, joint_dimension, labelled_joints, open_dataset
from cabinpose.store.split import _name


@pytest.fixture(scope="module")
def room(tmp_path_factory: pytest.TempPathFactory) -> xr.Dataset:
    """Three frames of one who stands, whose joints are ITOP's and of ours those that are the same; (15, 3) plain numbers."""
    manifest = sphere_people.manifest(frames=3, frames_per_part=3, persons=("standing", "beside"))
    dataset = open_dataset(sphere_people.write(tmp_path_factory.mktemp("room") / "room", manifest))
    points = np.full((3, 2, 15, 3), np.nan, np.float32)
    points[:, 0] = np.arange(15)[:, None] / [50, 60, 1] + [-0.2, 0.0, 1.0]
    points[:, 0, :, 2] = 1.5
    points[:, 0, ITOP.index["rfoot"], 0] = 9.0  # beside the image
    dataset = dataset.assign({"itop_joints_3d": (("frame", "person", "itop_joint", "xyz"), points)})
    dataset = dataset.assign_coords(itop_joint=list(ITOP.joints))
    same = [CABINPOSE.index[ours] for ours in CABINPOSE.maps["itop"]]
    for name in ("joints_3d", "joints_2d", "visibility"):
        values = dataset[name].values.copy()
        values[:, :, np.setdiff1d(np.arange(20), same)] = 0 if name == "visibility" else np.nan
        dataset[name] = dataset[name].dims, values
    return dataset


def test_places_get_names_and_the_others_go(room: xr.Dataset) -> None:
    named = as_named(room, {"beside": "rear_left", "standing": "driver"})
    assert named["person"].values.tolist() == ["rear_left", "driver"]
    assert np.array_equal(named["joints_3d"], room["joints_3d"].values[:, ::-1], equal_nan=True)
    assert np.array_equal(named["subject"], room["subject"].values[:, ::-1])
    assert _name(named) == "room"  # as splits call it
    one = as_named(room, {"standing": "driver"}, slots=("front_passenger", "driver"))
    assert one["person"].values.tolist() == ["driver", "front_passenger"]
    assert not one["visibility"][:, 1].any()
    assert one["visibility"].dtype == np.uint8
    assert (one["subject"][:, 1] == "").all()
    assert np.isnan(one["joints_3d"][:, 1]).all()


def test_joints_of_another_set_become_ours(room: xr.Dataset) -> None:
    names = {"itop.head": "head", "torso": "chest", "itop.rfoot": "rankle", "lelbow": "lelbow"}
    named = as_named(room, joints=names)
    assert named["joint"].values.tolist() == list(JOINTS)
    assert labelled_joints(named) == ("head", "chest", "lelbow", "rankle")
    for theirs, ours in (("head", "head"), ("torso", "chest"), ("rfoot", "rankle")):
        at = named["joints_3d"].sel(joint=ours).values[:, 0]
        xyz = room["itop_joints_3d"].sel(itop_joint=theirs).values[:, 0]
        assert np.array_equal(at, xyz)
        k = room["camera_k"].values[0]
        uv = xyz[:, :2] / xyz[:, 2:] * np.diag(k)[:2] + k[:2, 2]
        np.testing.assert_allclose(named["joints_2d"].sel(joint=ours).values[:, 0], uv, rtol=1e-6)
    assert named["visibility"].values[0, 0, [CABINPOSE.index[n] for n in ("head", "rankle", "neck")]].tolist() == [4, 1, 0]
    for name in ("joints_3d", "joints_2d", "visibility"):  # ours stay as they were
        assert np.array_equal(named[name].sel(joint="lelbow"), room[name].sel(joint="lelbow"), equal_nan=True)
    assert "itop" in dataset_skeleton(named).definition


def test_the_name_of_a_set_takes_what_is_the_same_in_both(room: xr.Dataset) -> None:
    ours = as_named(room, joints="itop")
    assert set(labelled_joints(ours)) == set(CABINPOSE.maps["itop"])
    assert np.array_equal(ours["joints_3d"].sel(joint="lpelvis"), room["itop_joints_3d"].sel(itop_joint="lhip"), equal_nan=True)
    theirs = as_named(room.drop_dims("itop_joint"), joints="cabinpose", skeleton="itop")
    assert theirs[joint_dimension("itop")].values.tolist() == list(ITOP.joints)
    assert np.array_equal(theirs["itop_joints_3d"].sel(itop_joint="rhip"), room["joints_3d"].sel(joint="rpelvis"), equal_nan=True)
    assert set(labelled_joints(theirs, "itop")) == set(CABINPOSE.maps["itop"].values())


def test_images_are_not_read(room: xr.Dataset, monkeypatch: pytest.MonkeyPatch) -> None:
    lazy = open_dataset(Path(room.encoding["source"]))
    monkeypatch.setattr("cabinpose.store.lazy.read_frames", None)
    as_named(lazy, {"standing": "driver"}, {"head": "neck"}, slots=("driver", "rear_left"))


@pytest.mark.parametrize(("names", "words", "hint"), [
    ({"places": {"stnding": "driver"}}, "unknown place 'stnding'", "did you mean standing"),
    ({"places": {"standing": "driver", "beside": "driver"}}, "two places are named driver", "a name of its own"),
    ({"joints": {"itop.head": "head", "itop.neck": "head"}}, "two joints are named head", "a name of its own"),
    ({"joints": {"lhand": "paw"}}, "unknown joint of cabinpose 'paw'", "known: "),
    ({"joints": {"itop.hed": "head"}}, "unknown joint of the dataset 'itop.hed'", "itop.head"),
    ({"joints": {"ntu.head": "head"}}, "unknown set of joints in the dataset 'ntu'", "known: cabinpose, itop"),
    ({"joints": {"head": "head"}}, "nobody in the dataset has the joint head", "itop.head"),
    ({"joints": {"lelbow": "lhip"}, "skeleton": "cabinpose"}, "unknown joint of cabinpose 'lhip'", "known: "),
    ({"joints": "rig"}, "no table says which joints of cabinpose those of rig are", "name them"),
    ({"joints": "ntu"}, "unknown set of joints 'ntu'", "known: "),
])  # fmt: skip
def test_what_is_not_there_is_refused(room: xr.Dataset, names: dict[str, Any], words: str, hint: str) -> None:
    with pytest.raises(CabinposeError) as error:
        as_named(room, **names)
    assert words in str(error.value)
    assert hint in str(error.value.hint)
