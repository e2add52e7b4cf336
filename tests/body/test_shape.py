"""Shapes against Anny itself (`anny_reference.npz`, written by tools/export_body.py), and against anthropometry."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal

from cabinpose._native import body as native
from cabinpose.core.errors import CabinposeError, ConfigError
from cabinpose.scene.body import SUBJECTS, BodyModel, Outfit, Phenotype
from cabinpose.scene.body.shape import load_shape_space

OURS_FROM_ANNY = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
REFERENCE = dict(np.load(Path(__file__).parent / "anny_reference.npz"))


def person(**values: float) -> object:
    return BodyModel.load().person(Phenotype(**values))


@pytest.mark.parametrize("row", range(len(REFERENCE["people"])))
def test_vertices_and_bone_heads_are_annys(row: int) -> None:
    skin, heads = load_shape_space().shape(Phenotype(*REFERENCE["people"][row].tolist()))
    assert_allclose(skin[REFERENCE["chosen"]], REFERENCE["rest"][row] @ OURS_FROM_ANNY.T, atol=5e-5)
    # The vertebrae leave the midline by up to 2 mm in Anny; ours are symmetric.
    assert_allclose(heads[: len(REFERENCE["bones"])], REFERENCE["heads"][row] @ OURS_FROM_ANNY.T, atol=2.5e-3)


@pytest.mark.parametrize(("row", "age"), [(0, -0.9), (1, -1.0)])
def test_a_baby_and_a_newborn_are_annys(row: int, age: float) -> None:
    """Of the one build for which the assets have them; the left and right of blend shapes are averaged, as everybody's."""
    build = {"gender": 0.5, "muscle": 0.5, "weight": 0.5, "height": 0.45, "proportions": 0.3}
    skin, _ = load_shape_space().shape(Phenotype(age=age, **build))
    assert_allclose(skin[REFERENCE["chosen"]], REFERENCE["infants"][row] @ OURS_FROM_ANNY.T, atol=1.5e-4)


@pytest.mark.parametrize("row", range(len(REFERENCE["people"])))
def test_skinning_kernel_reproduces_annys_posed_vertices(row: int) -> None:
    weights = REFERENCE["weights"]
    order = np.argsort(-weights, axis=1, kind="stable")[:, :9]
    weight = np.take_along_axis(weights, order, axis=1)
    out = np.empty((1, len(weights), 3), np.float32)
    rest = REFERENCE["rest"][row][None]
    native.skin_layers(
        np.ascontiguousarray(REFERENCE["transforms"][row][:, :3], dtype=np.float64), order.astype(np.uint8), weight, rest, out
    )
    assert_allclose(out[0], REFERENCE["posed"][row], atol=2e-6)


def test_shapes_are_summed_in_the_basis_order() -> None:
    """Bit for bit, whatever the threads of the library that multiplies matrices: cached people outlive its settings."""
    space = load_shape_space()
    coefficients = np.random.default_rng(4).normal(size=len(space.basis))
    expected = space.mean.astype(np.float64)
    for value, component in zip(coefficients, space.basis, strict=True):
        expected += value * component
    points = np.empty_like(space.mean)
    native.blend_shapes(space.mean, space.basis, coefficients, points)
    assert_array_equal(points, expected.astype(np.float32))


def test_skin_is_closed_oriented_and_symmetric() -> None:
    body = BodyModel.load().person(Phenotype())
    mesh = trimesh.Trimesh(body.rest_skin, body.skin_faces, process=False)
    assert mesh.is_watertight
    assert mesh.is_winding_consistent
    assert mesh.body_count == 1
    assert mesh.volume == pytest.approx(body.volume_m3, rel=1e-6)
    mirrored = body.rest_skin * np.float32([1, -1, 1])
    assert_allclose(mirrored[load_shape_space().mirror], body.rest_skin, atol=2e-6)


def test_faces_come_in_quads() -> None:
    faces = load_shape_space().faces
    shared = (faces[::2, :, None] == faces[1::2, None, :]).sum(axis=(1, 2))
    assert_array_equal(shared, 2)


@settings(max_examples=20, deadline=None)
@given(st.tuples(*[st.floats(0, 1)] * 6))
def test_any_phenotype_is_a_body(values: tuple[float, ...]) -> None:
    body = BodyModel.load().person(Phenotype(*values))
    assert 0.8 < body.stature_m < 2.6
    assert 10 < body.mass_kg / body.stature_m**2 < 45
    assert np.isfinite(body.rest_skin).all()


def test_parameters_do_what_they_say() -> None:
    base = person(stature_m=1.75)
    assert base.stature_m == pytest.approx(1.75, abs=1e-5)
    assert person(weight=0.9, muscle=0.2).mass_kg > person(weight=0.3, muscle=0.2).mass_kg
    assert person(height=0.6).stature_m > person(height=0.4).stature_m
    assert person(gender=0.0).stature_m > person(gender=1.0).stature_m
    assert person(age=0.0).stature_m < person(age=0.5).stature_m


def test_subjects_cover_the_population() -> None:
    assert len(SUBJECTS) == 18
    people = {name: BodyModel.load().person(*subject) for name, subject in SUBJECTS.items()}
    adults = [p for p in people.values() if p.phenotype.age > 0.2]
    assert people["S03"].stature_m == pytest.approx(1.50, abs=1e-3)  # 5th percentile woman, NHANES 2015-2018: 1.498 m
    assert people["S04"].stature_m == pytest.approx(1.87, abs=1e-3)  # 95th percentile man: 1.880 m
    assert people["S05"].stature_m == pytest.approx(1.40, abs=1e-3)
    assert all(17 < p.mass_kg / p.stature_m**2 < 33 for p in adults)
    # Winter 2009 after Drillis & Contini: thigh 0.245, shin 0.246, upper arm 0.186, forearm 0.146 of stature. Anny's
    # shoulder joints lie lower and its women's thighs are shorter.
    for p in adults:
        share = {name: length / p.stature_m for name, length in p.segment_lengths.items()}
        assert 0.21 < share["thigh"] < 0.255
        assert 0.235 < share["shin"] < 0.275
        assert 0.145 < share["upper_arm"] < 0.19
        assert 0.125 < share["forearm"] < 0.16


def test_random_is_seeded_and_stays_in_the_ranges() -> None:
    ranges = {"gender": (1.0, 1.0), "age": (0.5, 0.7), "stature_m": (1.5, 1.6)}
    one = Phenotype.random(ranges, rng=np.random.Generator(np.random.Philox(1)))
    assert one == Phenotype.random(ranges, rng=np.random.Generator(np.random.Philox(1)))
    assert one.gender == 1.0
    assert 0.5 <= one.age <= 0.7
    assert 1.5 <= one.stature_m <= 1.6
    rng = np.random.Generator(np.random.Philox(2))
    men = [Phenotype.random({"gender": (0.0, 0.0), "age": (0.5, 0.5)}, rng=rng).stature_m for _ in range(600)]
    assert np.mean(men) == pytest.approx(1.754, abs=0.012)
    assert np.std(men) == pytest.approx(0.075, abs=0.008)


@pytest.mark.parametrize(
    "make",
    [
        lambda: Phenotype(age=1.2),
        lambda: Phenotype(weight=float("nan")),
        lambda: Phenotype(stature_m=3.0),
        lambda: Phenotype.random({"hight": (0, 1)}, rng=np.random.Generator(np.random.Philox(0))),
        lambda: Phenotype.random({"age": (0.8, 0.2)}, rng=np.random.Generator(np.random.Philox(0))),
        lambda: Outfit(top="toga"),  # type: ignore[arg-type]
        lambda: Outfit(fit=2.0),
    ],
)
def test_bad_parameters_are_refused_with_a_hint(make: object) -> None:
    with pytest.raises(CabinposeError) as caught:
        make()  # type: ignore[operator]
    assert isinstance(caught.value, ConfigError)
    assert caught.value.hint
