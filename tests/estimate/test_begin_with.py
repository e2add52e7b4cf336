"""A run that begins with another network takes what stands for the same place, joint, limb or part, and says what is new."""

from __future__ import annotations

import warnings
from itertools import product
from pathlib import Path
from typing import Any

import pytest
import small
import torch
from torch import Tensor

from cabinpose.core.errors import ModelError
from cabinpose.core.skeleton import CABINPOSE, ITOP
from cabinpose.estimate.data import StoredFrames, collate
from cabinpose.estimate.methods import METHODS, NetworkMethod
from cabinpose.estimate.train_config import Machines, Start, TrainConfig
from cabinpose.estimate.training import Detector, begin_with, fit, frame_spec, load_detector
from cabinpose.estimate.weights import take_weights

ONE = Machines(1)


def config(method: str, **settings: Any) -> TrainConfig:
    return TrainConfig(method=method, settings={**small.TINY[method], **settings}, epochs=1, batch=4, average=0.0)


def begun(method: str, source: Path, **settings: Any) -> tuple[Detector, str]:
    """A detector that begins with another one, and the one line that says what it took."""
    detector = Detector(config(method, **settings))
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always", UserWarning)
        begin_with(detector, source, [])
    lines = [str(each.message) for each in told if str(source) in str(each.message)]
    assert len(lines) <= 1
    return detector.eval(), lines[0] if lines else ""


OTHERS: list[tuple[str, dict[str, Any]]] = [
    ("compact", {}), ("compact", {"skeleton": "itop", "slots": ("driver",)}), ("yolo", {}), ("lifting", {}), ("unet", {}),
    ("paf", {}), ("paf", {"stages": 3, "body": "itop"}), ("paf", {"presence_labels": 0, "width": 96}),
]  # fmt: skip


@pytest.mark.parametrize(("method", "settings"), OTHERS)
def test_what_rows_stand_for_is_said_of_all_of_them(method: str, settings: dict[str, Any]) -> None:
    """A tensor that changes its size with places, joints, parts or the view is in the layout, and its rows have own names."""
    known = METHODS[method]
    assert isinstance(known, NetworkMethod)
    run = Detector(config(method, **settings))
    state, layout = run.network.state_dict(), known.layout(run.method_config)
    assert layout
    for name, axes in layout.items():
        for axis, labels in axes.items():
            assert len(set(labels)) == len(labels) == state[name].shape[axis]
    values = {"width": 128, "skeleton": "itop", "body": "full", "classes": "person"}
    changes: dict[str, Any] = {"slots": (*run.method_config.slots, "more")}
    changes |= {field: value for field, value in values.items() if field in known.settings_type.model_fields}
    if method == "lifting":
        del changes["width"]  # of its layers
    other = Detector(config(method, **{**settings, **changes})).network.state_dict()
    for name, value in state.items():
        for axis, (one, two) in enumerate(zip(value.shape, other[name].shape, strict=True)):
            assert one == two or axis in layout[name]


def test_places_and_joints_are_taken_by_name(checkpoints: dict[str, Path]) -> None:
    """Row by row of the votes, by an index that is written out here."""
    theirs = load_detector(checkpoints["compact"]).network
    slots = ("rear_right", "front_passenger", "driver")
    detector, told = begun("compact", checkpoints["compact"], slots=slots, skeleton="itop")
    mine = detector.network
    named = {"lhip": "lpelvis", "rhip": "rpelvis"}
    fresh = Detector(config("compact", slots=slots, skeleton="itop")).network.votes.weight
    for (i, slot), (j, joint) in product(enumerate(slots), enumerate(ITOP.joints)):
        rows = slice(6 * (15 * i + j), 6 * (15 * i + j + 1))
        ours = named.get(joint, joint)
        if slot == "rear_right" or ours == "torso":
            assert not torch.equal(mine.votes.weight[rows], fresh[rows])  # another draw, as any
            continue
        at = 6 * (20 * small.PERSONS.index(slot) + CABINPOSE.index[ours])
        assert torch.equal(mine.votes.weight[rows], theirs.votes.weight[at : at + 6])
        assert torch.equal(mine.looks[1].place[i, j], theirs.looks[1].place[small.PERSONS.index(slot), CABINPOSE.index[ours]])
    assert torch.equal(mine.present[2].bias[[1, 2]], theirs.present[2].bias[[1, 0]])
    assert torch.equal(mine.deep[0].mix[0].weight, theirs.deep[0].mix[0].weight)
    assert told.endswith("new are rear_right, torso")


def test_the_same_places_in_another_order_answer_the_same(checkpoints: dict[str, Path]) -> None:
    slots = small.PERSONS[::-1]
    detector, told = begun("compact", checkpoints["compact"], slots=slots)
    assert not told
    batch = collate(list(StoredFrames(small.dataset(3), frame_spec(config("compact")))))
    with torch.no_grad():
        mine, theirs = (
            each(batch.depth, batch.amplitude) for each in (detector.network, load_detector(checkpoints["compact"]).network)
        )
    torch.testing.assert_close(mine.joints.flip(1), theirs.joints, atol=1e-4, rtol=1e-4)
    torch.testing.assert_close(mine.present.flip(1), theirs.present)


@pytest.mark.parametrize(("method", "change", "new"), [
    ("paf", {"body": "itop"}, "torso"), ("paf", {"width": 96}, "12 x 6 cells"), ("lifting", {"body": "full"}, "lknee, rknee"),
    ("unet", {"classes": "person"}, "person"), ("yolo", {"slots": ("driver", "rear_center")}, "rear_center"),
])  # fmt: skip
def test_other_methods_take_what_they_share(method: str, change: dict[str, Any], new: str, checkpoints: dict[str, Path]) -> None:
    """Each of these was refused, or its network is not of places; what all methods share below the answers is the other's."""
    detector, told = begun(method, checkpoints[method], **change)
    assert f"new are {new}" in told
    theirs = load_detector(checkpoints[method]).network.state_dict()
    same = [name for name, value in detector.network.state_dict().items() if torch.equal(value, theirs[name])]
    known = METHODS[method]
    assert isinstance(known, NetworkMethod)
    assert set(theirs) - set(known.layout(detector.method_config)) <= set(same)


def test_heat_maps_of_shared_joints_answer_the_same(checkpoints: dict[str, Path]) -> None:
    """ITOP's shoulder is ours, its maps are those of the network that it begins with."""
    detector, _ = begun("paf", checkpoints["paf"], body="itop")
    theirs = load_detector(checkpoints["paf"])
    depth = collate(list(StoredFrames(small.dataset(3), frame_spec(config("paf"))))).depth
    with torch.no_grad():
        one, two = detector.network(depth).heat, theirs.network(depth).heat
    for joint, ours in (("lshoulder", "lshoulder"), ("rhip", "rpelvis"), ("head", "head")):
        at = theirs.method_config.joints.index(ours)
        torch.testing.assert_close(one[:, ITOP.index[joint]], two[:, at], atol=1e-5, rtol=1e-5)
    torch.testing.assert_close(one[:, -1], two[:, -1], atol=1e-5, rtol=1e-5)  # the background


def test_what_no_layout_tells_has_to_be_of_one_size(checkpoints: dict[str, Path]) -> None:
    network = Detector(config("yolo")).network
    state: dict[str, Tensor] = load_detector(checkpoints["yolo"]).network.state_dict()
    with pytest.raises(ValueError, match=r"classes\.bias is of another size"):
        take_weights(network, state | {"classes.bias": torch.zeros(3)}, {}, {})
    with pytest.raises(ValueError, match="there is no more"):
        take_weights(network, state | {"more": torch.zeros(3)}, {}, {})


def test_another_method_is_refused(checkpoints: dict[str, Path]) -> None:
    with pytest.raises(ModelError, match="another network") as error:
        begin_with(Detector(config("yolo")), checkpoints["compact"], [])
    assert "same method" in str(error.value.hint)


def test_an_in_car_network_goes_on_in_a_room(checkpoints: dict[str, Path], tmp_path: Path) -> None:
    """Five places become one that it has not learnt; the run learns, and says that its place is new."""
    room = small.dataset(8).isel(person=[0]).assign_coords(person=["standing"])
    run = config("compact", slots=("standing",))
    frames = StoredFrames(room, frame_spec(run))

    with pytest.warns(UserWarning, match="new are standing"):
        best = fit(run, frames, frames, tmp_path, start=Start(init=checkpoints["compact"]), machines=ONE)
    assert load_detector(best).method_config.slots == ("standing",)
