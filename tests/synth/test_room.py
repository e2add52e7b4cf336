"""The furnished room: the same for the same numbers, and free where people stand."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

from cabinpose.core.errors import ConfigError
from cabinpose.core.frames import is_rigid
from cabinpose.scene import room as module
from cabinpose.scene.room import furnish_room, place_room_camera
from cabinpose.synth import FrameMaker
from cabinpose.synth.config import SynthConfig, room_preset
from cabinpose.synth.preflight import preflight
from cabinpose.synth.streams import frame_rng


def test_same_numbers_same_room() -> None:
    one, two, other = (furnish_room(rng=frame_rng(3, i)) for i in (5, 5, 6))
    assert one.surface.vertices.tobytes() == two.surface.vertices.tobytes()
    assert one.surface.vertices.tobytes() != other.surface.vertices.tobytes()


def test_nothing_stands_where_people_stand() -> None:
    for i in range(40):
        room = furnish_room(rng=frame_rng(0, i))
        assert room.stand_x[0] < room.stand_x[1]
        # Rays straight up from the places to stand must meet the ceiling first; straight ahead, nothing within reach.
        mesh = trimesh.Trimesh(room.surface.vertices, room.surface.faces, process=False)
        x, y = np.meshgrid(np.linspace(*room.stand_x, 5), np.linspace(*room.stand_y, 5))
        feet = np.stack((x.ravel(), y.ravel(), np.full(x.size, 0.01)), axis=1)
        hits, _, _ = mesh.ray.intersects_location(feet, np.tile((0.0, 0.0, 1.0), (len(feet), 1)), multiple_hits=False)
        assert len(hits) == len(feet)
        assert hits[:, 2].min() > 2.4


def test_normals_are_those_of_the_triangles() -> None:
    surface = furnish_room(rng=frame_rng(0, 1)).surface
    corners = surface.vertices[surface.faces].astype(np.float64)
    flat = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    flat /= np.linalg.norm(flat, axis=1, keepdims=True)
    assert np.einsum("fk,fk->f", flat, surface.normals[surface.faces[:, 0]]).min() > 0.999


def test_solids_are_closed_and_look_outwards() -> None:
    box = module._box((1.0, 2.0, 3.0), (2.0, 4.0, 6.0), "wall", "wood").vertices.reshape(-1, 3, 3)
    for triangles, volume in ((box, 6.0), (module._pot(0.14, 0.4), 0.0235), (module._ball(0.1), 0.00366)):
        count = len(triangles)
        solid = trimesh.Trimesh(triangles.reshape(-1, 3), np.arange(3 * count).reshape(-1, 3), process=True)
        solid.merge_vertices(digits_vertex=6)
        assert solid.is_watertight
        assert solid.is_winding_consistent
        assert solid.volume == pytest.approx(volume, rel=0.01)
    assert np.linalg.norm(module._ball(0.1), axis=-1) == pytest.approx(0.1)


def test_camera_is_level_high_and_looks_into_the_room() -> None:
    room = furnish_room(rng=frame_rng(0, 0))
    for i in range(50):
        pose, spot = place_room_camera("room", room, rng=frame_rng(1, i))
        assert is_rigid(pose)
        assert 1.1 <= pose[2, 3] <= 1.6
        assert room.stand_x[0] <= spot[0] <= room.stand_x[1]
        forward, down = pose[:3, 2], pose[:3, 1]
        assert forward[0] > 0.97
        assert -np.sin(np.radians(6.1)) <= forward[2] <= np.sin(np.radians(2.1))
        assert down[2] < -0.97


def test_camera_above_looks_down_on_the_person_with_the_wall_at_the_top_of_the_image() -> None:
    for i in range(50):
        room = furnish_room(rng=frame_rng(2, i))
        pose, spot = place_room_camera("room_top", room, rng=frame_rng(3, i))
        assert is_rigid(pose)
        assert 2.4 <= pose[2, 3] < room.height
        assert pose[2, 2] < -0.97  # the optical axis points to the floor
        assert pose[0, 1] < -0.97  # down in the image is away from the wall, towards the camera of the view `room`
        assert spot[2] == 0.0
        shoulders = np.linalg.inv(pose) @ (*spot[:2], 1.4, 1.0)
        assert np.abs(shoulders[:2] / shoulders[2]).max() < 120 * 0.0035  # inside ITOP's middle 240 columns and rows


@pytest.mark.parametrize("view", [{"rom_top": 1.0}, {"mine": {"position_m": [2.0, 0.0, 1.5], "look_at_m": [0.0, 0.0, 1.0]}}])
def test_other_views_than_a_rooms_are_refused(view: dict[str, object]) -> None:
    config = {"scene": {"kind": "room"}, "camera": {"sensor": "kinect_v1"}, "noise": {"kind": "structured_light"}}
    preflight(SynthConfig.parse(config), frames=1)
    config["camera"] |= {"views": {"room": 1.0, **view}}
    with pytest.raises(ConfigError, match=f"unknown view of a room '{next(iter(view))}'") as caught:
        preflight(SynthConfig.parse(config), frames=1)
    assert "room_top" in (caught.value.hint or "")


@pytest.mark.parametrize(("views", "seen"), [({"room_top": 1.0}, {"room_top"}), ({"driver": 1.0}, {"room"})])
def test_people_are_seen_from_the_views_that_are_asked_for(views: dict[str, float], seen: set[str]) -> None:
    config = room_preset()
    maker = FrameMaker(config.model_copy(update={"camera": config.camera.model_copy(update={"views": views})}), 0)
    frames = [maker.make(i)[0] for i in range(4)]
    assert {str(frame["pov"]) for frame in frames} == seen
    distances = np.concatenate([frame["itop_joints_3d"][0][:, 2] for frame in frames])
    assert (distances.mean() < 2.0) == (seen == {"room_top"})
