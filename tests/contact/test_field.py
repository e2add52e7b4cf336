"""Clearance fields against closed forms, give to the millimetre, the interior against what lies beyond it."""

from __future__ import annotations

import gc
import math
import weakref
from collections.abc import Callable

import numpy as np
import pytest
import scipy.ndimage
import trimesh
from capsule_people import StubCabin, StubSeat, surface
from numpy.typing import NDArray

from cabinpose._native import contact as native
from cabinpose.core.errors import ConfigError
from cabinpose.core.frames import transform
from cabinpose.scene.cabin import Part
from cabinpose.scene.contact import BAND_M, OUTSIDE, ContactField
from cabinpose.scene.contact.field import STEP_M, bit_rows, group_field, grow

Distance = Callable[[NDArray[np.float64]], NDArray[np.float64]]


def _box(size: tuple[float, float, float], at: tuple[float, float, float] = (0, 0, 0)) -> trimesh.Trimesh:
    return trimesh.creation.box(size).apply_translation(at)


def _box_distance(p: NDArray[np.float64]) -> NDArray[np.float64]:
    q = np.abs(p) - (0.2, 0.15, 0.1)
    return np.linalg.norm(np.maximum(q, 0), axis=1) + np.minimum(q.max(axis=1), 0)


def _torus_distance(p: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.hypot(np.hypot(p[:, 0], p[:, 1]) - 0.185, p[:, 2]) - 0.015


CASES: dict[str, tuple[trimesh.Trimesh, Distance, float]] = {
    "box": (_box((0.4, 0.3, 0.2)), _box_distance, 0.010),
    "sphere": (trimesh.creation.icosphere(4, 0.2), lambda p: np.linalg.norm(p, axis=1) - 0.2, 0.010),
    "torus": (trimesh.creation.torus(0.185, 0.015, 96, 32), _torus_distance, 0.005),
}


@pytest.mark.parametrize("name", CASES)
def test_field_equals_the_closed_form_within_its_bound(name: str) -> None:
    mesh, distance, step = CASES[name]
    field = group_field("g", [Part(name, surface(mesh))], step=step)
    points = np.random.default_rng(2).uniform(mesh.bounds[0] - 0.06, mesh.bounds[1] + 0.06, (5000, 3))
    clearance = np.full(len(points), BAND_M)
    native.sample(points, np.eye(4), field, clearance)
    exact = np.clip(distance(points), -BAND_M, BAND_M)
    error = clearance - exact
    near = np.abs(exact) < 2 * step - step / 2
    assert np.abs(error[near]).max() < field.bound_m
    assert np.abs(error[near]).mean() < 0.0005
    assert (np.abs(error) < field.bound_m + 0.13 * np.abs(exact)).all()
    assert (np.sign(clearance) == np.sign(exact))[np.abs(exact) > field.bound_m].all()


def test_interpolation_never_hides_depth_beyond_the_bound() -> None:
    """The rounding of nodes is downwards and inherited distances are too long: stored depths are never too small."""
    mesh = trimesh.creation.icosphere(3, 0.12)
    field = group_field("g", [Part("p", surface(mesh))])
    nodes = np.argwhere(np.abs(field.values) < 127)
    exact = field.parts[0].mesh.signed_distance(field.origin + nodes * field.step, 0.3)
    inside = exact < 0
    stored = field.values[tuple(nodes.T)] * 0.00075
    assert (stored[inside] <= exact[inside] + 1e-9).all()


@pytest.mark.parametrize("give", [0.0, 0.05])
def test_give_is_honoured_to_the_millimetre(give: float) -> None:
    cabin = StubCabin((Part("cushion", surface(_box((0.5, 0.5, 0.2), (0, 0, -0.1))), give_m=give),))
    placed = ContactField(cabin).at({})
    at = np.array([[0.013, 0.007, -give - 0.008 + 0.0005]], np.float32)
    assert placed.deepest(at, 0.008) is None
    at[0, 2] -= 0.001
    contact = placed.deepest(at, 0.008)
    assert contact is not None
    assert contact.part == "cushion"
    assert contact.depth_m == pytest.approx(give + 0.0085, abs=1e-6)
    assert contact.excess_m == pytest.approx(0.0005, abs=1e-6)
    rigid = placed.deepest(at, 0.008, give=False)
    assert rigid is not None
    assert rigid.excess_m == pytest.approx(give + 0.0005, abs=1e-6)


@pytest.mark.slow
def test_every_point_is_judged_as_by_trimesh() -> None:
    """Nine thousand points about one threshold, no verdict differs from the exact distance."""
    mesh = trimesh.util.concatenate([_box((0.3, 0.3, 0.1)), trimesh.creation.icosphere(3, 0.08).apply_translation((0, 0, 0.3))])
    parts = [Part(str(i), surface(m), give_m=g) for i, (m, g) in enumerate(zip(mesh.split(), (0.02, 0.0), strict=True))]
    placed = ContactField(StubCabin(tuple(parts))).at({})
    points = np.random.default_rng(3).uniform(mesh.bounds[0], mesh.bounds[1], (9000, 3)).astype(np.float32)
    depth = np.stack([trimesh.proximity.signed_distance(m, points) for m in mesh.split()])
    excess = (depth - [[0.02], [0.0]] - 0.008).max(axis=0)
    for index in np.flatnonzero(np.abs(excess) < 0.012)[:400]:
        assert (placed.deepest(points[index : index + 1], 0.008) is not None) == (excess[index] > 0)
    worst = placed.deepest(points, 0.008)
    assert worst is not None
    assert worst.excess_m == pytest.approx(excess.max(), abs=1e-6)


def test_field_follows_its_group() -> None:
    seat = Part("back", surface(_box((0.1, 0.4, 0.6))), group="seat:driver/back", give_m=0.05)
    field = ContactField(StubCabin((seat,)))
    moved = transform(translation=(1.0, -0.4, 0.5))
    moved[:3, :3] = trimesh.transformations.rotation_matrix(0.4, (0, 1, 0))[:3, :3]
    local = np.random.default_rng(4).uniform(-0.3, 0.3, (200, 3))
    here = field.clearance(local, {})
    there = field.clearance(local @ moved[:3, :3].T + moved[:3, 3], {"seat:driver/back": moved})
    np.testing.assert_allclose(there, here, atol=1e-9)


def _room(hole: float = 0.0) -> StubCabin:
    """A box room of thin sheets, 2 x 1.4 x 1.2 m inside, with a slit of `hole` metres in the left wall."""
    thin = 0.004
    walls = {
        "floor": _box((2, 1.4, 0.05), (0, 0, -0.025)),
        "roof": _box((2, 1.4, thin), (0, 0, 1.2)),
        "front": _box((thin, 1.4, 1.2), (1, 0, 0.6)),
        "rear": _box((thin, 1.4, 1.2), (-1, 0, 0.6)),
        "right": _box((2, thin, 1.2), (0, -0.7, 0.6)),
        "left_low": _box((2, thin, 0.6 - hole / 2), (0, 0.7, (0.6 - hole / 2) / 2)),
        "left_high": _box((2, thin, 0.6 - hole / 2), (0, 0.7, 0.9 + hole / 4)),
    }
    return StubCabin(tuple(Part(n, surface(m)) for n, m in walls.items()), seats={"driver": StubSeat((0, 0, 0.25))})


@pytest.mark.parametrize("hole", [0.0, 0.02])
def test_beyond_a_thin_pane_is_outside_the_cabin(hole: float) -> None:
    placed = ContactField(_room(hole)).at({})
    inside = np.array([[0, 0, 0.6], [0.9, 0.6, 1.1], [0, 0.69, 0.3]], np.float32)
    assert placed.deepest(inside, 0.008) is None
    for beyond in ([0, 0.715, 0.3], [0, 0.76, 0.3], [0, 2.0, 0.3], [0, 0, 1.3]):
        contact = placed.deepest(np.array([[0, 0, 0.6], beyond], np.float32), 0.008)
        assert contact is not None
        assert (contact.part, contact.point) == (OUTSIDE, 1)


def test_an_open_window_leads_out() -> None:
    placed = ContactField(_room(0.2)).at({})
    assert placed.deepest(np.array([[0, 0.75, 0.6]], np.float32), 0.008) is None


def test_an_open_sheet_is_felt_through_its_thickness() -> None:
    sheet = trimesh.Trimesh([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]], [[0, 1, 2], [0, 2, 3]])
    placed = ContactField(StubCabin((Part("sheet", surface(sheet), solid=False, shell_m=0.02),))).at({})
    for z, hit in ((0.0, True), (0.011, True), (-0.011, True), (0.013, False), (-0.013, False)):
        assert (placed.deepest(np.array([[0.1, 0.2, z]], np.float32), 0.008) is not None) == hit


def test_a_field_takes_a_byte_a_node() -> None:
    shell = [_box((3, 1.6, 0.05)), _box((3, 1.6, 0.05), (0, 0, 1.3))]
    field = group_field("g", [Part(str(i), surface(m)) for i, m in enumerate(shell)])
    nodes = math.prod(math.ceil((n + 2 * BAND_M) / STEP_M) + 1 for n in (3, 1.6, 1.35))
    assert field.values.nbytes < 1.1 * nodes


def test_copies_of_a_seat_share_one_field() -> None:
    cushion = surface(_box((0.5, 0.5, 0.2)))
    seats = [Part(f"{slot} cushion", cushion, group=f"seat:{slot}/base") for slot in ("driver", "rear_left")]
    one, two = ContactField(StubCabin(tuple(seats))).groups
    assert one.values is two.values
    assert (one.parts[0].name, two.parts[0].name) == ("driver cushion", "rear_left cushion")


def test_cars_with_equal_seats_share_a_field_as_long_as_one_is_there() -> None:
    def fields(slot: str, give_m: float = 0.0, shell_m: float = 0.0) -> ContactField:
        part = Part(slot, surface(_box((0.31, 0.32, 0.33))), group=f"seat:{slot}/base", give_m=give_m, shell_m=shell_m)
        return ContactField(StubCabin((part,)))

    one, two, softer, thicker = fields("driver"), fields("rear_left"), fields("driver", 0.02), fields("driver", 0.0, 0.01)
    assert one.groups[0].values is two.groups[0].values
    for other in (softer, thicker):
        assert not np.array_equal(one.groups[0].values, other.groups[0].values)
    values = weakref.ref(one.groups[0].values)
    del one, two
    gc.collect()
    assert values() is None


def _reached_by_brute_force(clear: NDArray[np.bool_], seed: tuple[int, int, int]) -> NDArray[np.bool_]:
    parts, _ = scipy.ndimage.label(clear)
    return np.asarray(parts == parts[seed]) if clear[seed] else np.zeros_like(clear)


def _nodes(bits: NDArray[np.uint64], nk: int) -> NDArray[np.bool_]:
    return np.unpackbits(bits.view(np.uint8), axis=2, bitorder="little")[:, :, :nk].astype(bool)


@pytest.mark.parametrize("nk", [1, 20, 64, 65, 150])
def test_flood_and_growth_equal_those_of_scipy(nk: int) -> None:
    rng = np.random.default_rng(nk)
    for share, rows in ((0.45, (9, 8)), (0.7, (9, 8)), (1.0, (1, 1))):
        values = rng.random((*rows, nk), np.float32)
        clear = values >= 1.0 - share
        seed = tuple(np.argwhere(clear)[-1 if share == 1.0 else len(clear) // 2])
        passable = bit_rows(values, 1.0 - share)
        reached = np.empty_like(passable)
        open_border = native.flood(passable, np.array([seed]), nk, reached)
        expected = _reached_by_brute_force(clear, seed)
        np.testing.assert_array_equal(_nodes(reached, nk), expected)
        inner = expected[1:-1, 1:-1, 1:-1] if nk > 2 else expected[:0]
        assert open_border == (expected.sum() > inner.sum())
        allowed = rng.random(values.shape, np.float32)
        grown = scipy.ndimage.binary_dilation(expected, np.ones((3, 3, 3))) & (allowed >= 0.5) | expected
        np.testing.assert_array_equal(_nodes(grow(reached, bit_rows(allowed, 0.5)), nk), grown)


def test_no_part_hides_another_under_its_foam() -> None:
    """What is known exactly of soft foam is not the whole truth where a hard part is nearer to its limit."""
    foam, frame = _box((0.3, 0.3, 0.08)), _box((0.24, 0.24, 0.02), (0.01, 0, -0.03))
    parts = [Part("foam", surface(foam), give_m=0.05), Part("frame", surface(frame))]
    field = group_field("g", parts)
    nodes = np.argwhere(np.abs(field.values) < 127)
    where = field.origin + nodes * field.step
    exact = np.min([p.mesh.signed_distance(where, 0.2) + p.give_m for p in field.parts], axis=0)
    error = field.values[tuple(nodes.T)] * 0.00075 - exact
    free = exact > 0
    assert error[free].max() < field.step  # the slack that a search by balls leaves
    assert error[free].min() > -0.001
    assert error[~free].max() < 1e-6


@pytest.mark.parametrize(("below", "above"), [(0.03, 0.03), (0.05, 0.02)])
def test_splat_equals_the_exact_distance(below: float, above: float) -> None:
    """Also for needles and slivers, whose Voronoi regions are all corners and edges."""
    corners = np.random.default_rng(7).normal(0.0, 0.04, (40, 3, 3))
    corners[:10, 2] = 0.5 * (corners[:10, 0] + corners[:10, 1]) + 1e-4 * corners[:10, 2]
    origin, step = np.full(3, -0.12), 0.01
    points = origin + step * np.argwhere(np.ones((25, 25, 25)))
    for triangle in corners:
        distance = np.full((25, 25, 25), np.inf, np.float32)
        native.splat(triangle[None], origin, step=step, below=below, above=above, distance=distance)
        closest = trimesh.triangles.closest_point(np.broadcast_to(triangle, (len(points), 3, 3)), points)
        exact = np.linalg.norm(points - closest, axis=1)
        normal = np.cross(triangle[1] - triangle[0], triangle[2] - triangle[0])
        height = (points - triangle[0]) @ (normal / np.linalg.norm(normal))
        near = (height > -below + 1e-6) & (height < above - 1e-6) & (exact < max(below, above) - 1e-6)
        np.testing.assert_allclose(np.sqrt(distance.reshape(-1)[near]), exact[near], atol=2e-6)
        assert np.isinf(distance.reshape(-1)[exact > max(below, above) + 1e-6]).all()


def test_splat_of_many_triangles_is_the_least_of_each_alone() -> None:
    """To the bit: a triangle is passed over only where another one is nearer."""
    rng = np.random.default_rng(11)
    corners = rng.normal(0.0, 0.06, (300, 1, 3)) + rng.normal(0.0, 0.02, (300, 3, 3))
    corners[:30, 2] = 0.5 * (corners[:30, 0] + corners[:30, 1]) + rng.choice((1e-2, 1e-5, 0.0), (30, 1)) * corners[:30, 2]
    corners[30:60, :, 2] = 0.01  # as flat as a panel, on the nodes themselves

    def splat(triangles: NDArray[np.float64]) -> NDArray[np.float32]:
        distance = np.full((25, 25, 23), np.inf, np.float32)
        native.splat(triangles, np.full(3, -0.12), step=0.01, below=0.07, above=0.02, distance=distance)
        return distance

    alone = np.min([splat(triangle[None]) for triangle in corners], axis=0)
    np.testing.assert_array_equal(splat(corners), alone)
    np.testing.assert_array_equal(splat(corners[::-1].copy()), alone)


def test_a_field_too_large_for_the_memory_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    """Above all a mesh given in millimetres."""
    part = Part("box", surface(_box((1800.0, 1500.0, 1200.0))))
    with pytest.raises(ConfigError, match=r"the contact field of 'g' takes \d+\.\d GB") as caught:
        group_field("g", [part])
    assert "metres" in caught.value.hint
    monkeypatch.setattr("cabinpose.scene.contact.field._free_bytes", lambda: 1000)
    with pytest.raises(ConfigError, match="GB are free"):
        group_field("g", [Part("box", surface(_box((0.3, 0.3, 0.1))))])
