"""The room of the arms against the cabin's and the body's own triangles, and arms that give way."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

from cabinpose._native import pose as native
from cabinpose.scene.body import SEGMENTS, SUBJECTS, BodyModel, Person
from cabinpose.scene.cabin import build_cabin
from cabinpose.synth.posture import choose_setting, sample_pose
from cabinpose.synth.posture.limbs import frames
from cabinpose.synth.posture.room import CELL_M, YIELD_M, room_for
from cabinpose.synth.posture.seat_fit import fit_seat
from cabinpose.synth.validate import Validator


@pytest.fixture(scope="module")
def person() -> Person:
    return BodyModel.load().person(*SUBJECTS["S01"])


def test_sides_are_where_rays_meet_the_car(person: Person) -> None:
    cabin = build_cabin("sedan")
    seat = cabin.seats["rear_left"]
    room = room_for(person, cabin, seat, seat.default)
    meshes = [trimesh.Trimesh(p.surface.vertices, p.surface.faces, process=False) for p in cabin.parts if p.group == "body"]
    car = trimesh.util.concatenate(meshes)
    h = seat.design_h_point
    rng = np.random.default_rng(4)
    grid = rng.integers((10, 20), (50, 60), size=(60, 2))  # nodes of the height field
    for i, j in grid:
        x, z = room.corner[0] + CELL_M * np.array([i, j])
        hits = car.ray.intersects_location([[x, h[1] + 0.12, z]], [[0.0, 1.0, 0.0]])[0]
        first = np.abs(hits[:, 1] - h[1]).min()
        assert room.sides[0, 0, i, j] == pytest.approx(first, abs=2e-3)
        depth, way = native.beside(room, np.array([x, h[1] + first + 0.01, z]), 0.0)
        assert depth > 0.009 - 0.002
        assert way == -1.0


def test_own_tubes_hold_the_skin(person: Person) -> None:
    cabin = build_cabin("sedan")
    seat = cabin.seats["front_passenger"]
    fit = fit_seat(person, seat, seat.default.torso_angle)
    room = room_for(person, cabin, seat, seat.default)
    skeleton = frames(fit.q, person.rest, fit.seat_from_root)
    skin = person.pose(fit.q, fit.seat_from_root).skin.astype(np.float64)
    for which, segment in ((0, "lthigh"), (1, "rthigh")):
        bone = skeleton.bone(segment)
        points = skin[person.skin_segment == SEGMENTS.index(segment)]
        along = -((points - bone[:3, 3]) @ bone[:3, 2]) / room.femur
        points = points[(along > 0.3) & (along < 0.85)][::7]
        depth = np.array([native.in_own(room, *skeleton[:2], which, p, 0.0) for p in points])
        assert np.percentile(depth, 5) > -0.008  # the tube is no smaller than the leg ...
        assert np.median(depth) < 0.012  # ... and hardly larger


@pytest.mark.parametrize("slot", ["driver", "rear_left"])
def test_arms_give_way_and_most_poses_hold(slot: str, person: Person) -> None:
    cabin = build_cabin("sedan")
    seat = cabin.seats[slot]
    validator = Validator(None)
    rng = np.random.default_rng(1)
    setting = choose_setting(person, seat, cabin, rng=None)
    room = room_for(person, cabin, seat, setting)
    trouble, held = [], 0
    for _ in range(12):
        pose = sample_pose(person, seat, setting, cabin, "rest_lap", rng=rng)
        skeleton = frames(pose.q, person.rest, pose.vehicle_from_root)
        elbows = [skeleton.bone(s + "forearm")[:3, 3] for s in "lr"]
        trouble += [native.arm_trouble(room, *skeleton[:2], side, elbows[side].copy(), YIELD_M) for side in (0, 1)]
        held += validator.check([(slot, person, person.pose(pose.q, pose.vehicle_from_root))], {}).ok
    assert np.median(trouble) < 1e-4  # m2: no point of an arm deeper than a centimetre
    assert held >= 10
