"""Folds of cloth inside bent elbows, hips and knees, and none where it is drawn taut outside."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import trimesh

from cabinpose.scene.body import DOF_INDEX, DOFS, SUBJECTS, BodyModel, Outfit, garments, load_chart
from cabinpose.scene.body.folds import bend_fields, seen_chart
from cabinpose.scene.body.garments import FULL_BEND_RAD, layer

CLOTHED = Outfit("long_sleeve", "trousers")
JOINTS = ("lelbow.flexion", "rhip.flexion", "lknee.flexion")


def bent(dof: str, share: float, outfit: Outfit = CLOTHED) -> tuple[np.ndarray, np.ndarray]:
    """(N, 3) m: the surface at rest without and with a joint's folds."""
    person = BodyModel.load().person(SUBJECTS["S01"].phenotype, outfit)
    q = np.zeros(len(DOFS))
    q[DOF_INDEX[dof]] = share * FULL_BEND_RAD
    return person.dressed.rest, person.dressed.bent(q)


@pytest.mark.parametrize("dof", JOINTS)
def test_folds_grow_with_the_bend(dof: str) -> None:
    """In proportion, no further than fully bent, and about this joint alone."""
    moved = {share: np.linalg.norm(np.subtract(*bent(dof, share)), axis=1) for share in (0.0, 0.5, 1.0, 1.3)}
    assert moved[0.0].max() == 0.0
    assert 0.004 < moved[1.0].max() < 0.012
    np.testing.assert_allclose(moved[0.5], 0.5 * moved[1.0], atol=1e-6)
    np.testing.assert_array_equal(moved[1.3], moved[1.0])
    at = bent(dof, 0.0)[0][moved[1.0] > 0.001]
    assert (at[:, 1] * (1.0 if dof[0] == "l" else -1.0) > -0.01).all()
    assert np.ptp(at[:, 2]) < 0.45


def test_bare_skin_has_no_folds() -> None:
    for dof, outfit in (
        ("lelbow.flexion", replace(CLOTHED, top="t_shirt")),
        ("lknee.flexion", replace(CLOTHED, bottom="shorts")),
    ):
        rest, folded = bent(dof, 1.0, outfit)
        chart = load_chart()
        bare = rest[np.linalg.norm(folded - rest, axis=1) > 0.001]
        where = chart.heads["llowerarm01" if "elbow" in dof else "lfoot"]
        assert not len(bare) or np.linalg.norm(bare - where, axis=1).min() > 0.03


def test_cloth_is_smoother_outside_and_not_below_the_skin(monkeypatch: pytest.MonkeyPatch) -> None:
    """Behind a bent elbow cloth is nearer to cloth without folds of before; all of it stays outside of the skin."""
    body = BodyModel.load().person(SUBJECTS["S01"].phenotype, CLOTHED)
    worn = layer(body.rest_skin, body.rest, CLOTHED, 1.0)
    with monkeypatch.context() as patched:
        patched.setattr(garments, "folds", lambda where, *_, **__: np.full(len(where), 0.3))
        plain = layer(body.rest_skin, body.rest, CLOTHED, 1.0).vertices
    vertices = worn.vertices.copy()
    for bend in worn.bends:
        vertices[bend.rows] += bend.offsets
    taut = bend_fields()["lelbow.flexion"].taut > 0.5
    assert taut.sum() > 20
    outwards = (plain - worn.bare) / np.maximum(np.linalg.norm(plain - worn.bare, axis=1), 1e-6)[:, None]
    before, after = (np.einsum("ij,ij->i", v - plain, outwards)[taut].std() for v in (worn.vertices, vertices))
    assert after < 0.8 * before
    mesh = trimesh.Trimesh(body.rest_skin, body.skin_faces, process=False)
    moved = np.concatenate([bend.rows for bend in worn.bends])
    moved = moved[np.abs(seen_chart().rest[moved, 1]) > 0.04]  # between the thighs skin faces skin
    inside = moved[mesh.contains(vertices[moved].astype(np.float64))]
    if len(inside):
        _, depth, _ = trimesh.proximity.closest_point(mesh, vertices[inside].astype(np.float64))
        assert depth.max() < 0.002
