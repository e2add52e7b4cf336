"""Backs of front seats, seen from behind: closed, their cover proud of the foam, a pocket on it; mats where heels stand."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

from cabinpose.scene.cabin import PRESETS, Cabin, build_cabin

CARS = [name for name in PRESETS if name != "shuttle"]


def mesh(cabin: Cabin, name: str) -> trimesh.Trimesh:
    (part,) = (part for part in cabin.parts if part.name == name)
    return trimesh.Trimesh(part.surface.vertices.astype(float), part.surface.faces, process=True)


def first_hits(meshes: list[trimesh.Trimesh], starts: np.ndarray, way: np.ndarray) -> np.ndarray:
    """(N, M) m: how far each of N rays goes until it meets each of M meshes, inf where it does not."""
    found = np.full((len(starts), len(meshes)), np.inf)
    for column, one in enumerate(meshes):
        places, ray, _ = one.ray.intersects_location(starts, np.broadcast_to(way, starts.shape))
        np.minimum.at(found[:, column], ray, (places - starts[ray]) @ way)
    return found


@pytest.mark.parametrize("name", CARS)
def test_the_back_of_a_front_seat_is_closed_and_its_cover_is_all_that_is_seen_of_it(name: str) -> None:
    cabin = build_cabin(name)
    for slot in ("driver", "front_passenger"):
        parts = [mesh(cabin, f"{slot} {part}") for part in ("backrest", "back shell", "map pocket")]
        assert all(part.is_watertight for part in parts)  # every edge is of two faces
        assert all(part.volume > 0.0 for part in parts)
        shell = parts[1].bounds
        middle = shell.mean(axis=0)
        half = 0.5 * (shell[1] - shell[0])
        y, z = np.meshgrid(np.linspace(-0.60, 0.60, 13), np.linspace(-0.80, 0.80, 17))
        starts = np.column_stack((np.full(y.size, shell[0, 0] - 0.5), y.ravel() * half[1], middle[2] + z.ravel() * half[2]))
        hits = first_hits(parts, starts, np.array((1.0, 0.0, 0.0)))
        assert np.isfinite(hits[:, 0]).all()  # nothing is seen through
        assert (np.minimum(hits[:, 1], hits[:, 2]) < hits[:, 0] - 0.003).all()  # the cover is before the foam
        assert 0.2 < (hits[:, 2] < hits[:, 1]).mean() < 0.6  # the pocket before the cover


@pytest.mark.parametrize("name", CARS)
def test_mats_lie_on_the_carpet_where_heels_stand(name: str) -> None:
    cabin = build_cabin(name)
    mats, carpet = mesh(cabin, "floor mats"), mesh(cabin, "floor")
    assert mats.is_watertight
    assert mats.vertices[:, 2].max() == pytest.approx(0.0, abs=1e-6)  # the height of the heel points
    for seat in cabin.seats.values():
        if seat.slot == "rear_center":
            continue
        above = seat.heel_m + (0.0 if seat.slot.startswith("rear") else -0.05, 0.0, 0.3)
        hits = first_hits([mats, carpet], above[None], np.array((0.0, 0.0, -1.0)))
        assert hits[0, 0] == pytest.approx(0.3, abs=2e-3)
        assert hits[0, 1] == pytest.approx(0.304, abs=1e-3)
