"""From the meshes of a file to the parts of a cabin: which rule each belongs to, what is a solid, what is open or broken."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
import trimesh
from numpy.typing import NDArray

from cabinpose.core import Bools, Floats, Ints, Ints32, Matrix, MeshError, distinct_rows, invert
from cabinpose.scene.cabin.car_file import COMMON_RULES, Rule
from cabinpose.scene.cabin.meshfile import NamedMesh
from cabinpose.scene.cabin.model import STATIC_GROUP, Part
from cabinpose.scene.cabin.shading import to_surface
from cabinpose.scene.cabin.shapes import Solid
from cabinpose.scene.contact.triangles import welded

_MOST, _ENOUGH = 0.5, 0.25  # of a piece, to lie in a box; of what is in the box, for such pieces to be all that it means
_MANY_HOLES = 0.03  # holes a triangle: the windows of a car are far fewer, a mesh with every tenth triangle gone has more
_MANY_OPEN = 0.15  # of the edges, where a tenth of the triangles is gone
_OPEN_SEAT = 0.04  # of a seat's surface, as the area of its holes


class Openness(NamedTuple):
    """How open a mesh is.

    open_edges: share of its edges that have one triangle only · holes: a triangle, by Euler's formula; a panel's rim is none ·
    missing: the share of triangles whose loss at random leaves as many open edges ·
    gap: area of the holes as a share of the surface, by the sum of area vectors, which is zero for a closed surface.
    """

    open_edges: float
    holes: float
    missing: float
    gap: float


def openness(vertices: Floats, faces: NDArray[np.integer]) -> Openness:
    """`Openness` of vertices (V, 3) m and faces (F, 3), doubled vertices merged.

    Of triangles lost at random with probability p, 2p / (1 + p) of the edges left have one neighbour: so p is told.
    """
    mesh = trimesh.Trimesh(vertices, faces, process=False)
    mesh.merge_vertices()
    sides = mesh.edges_sorted
    first, edge = distinct_rows(sides)
    edges, uses = sides[first], np.bincount(edge)
    share = float((uses == 1).mean())
    if share == 0.0:
        return Openness(0.0, 0.0, 0.0, 0.0)
    piece = trimesh.graph.connected_component_labels(edges, len(mesh.vertices))
    open_pieces = np.unique(piece[edges[uses == 1, 0]])  # a closed one has no hole, whatever its handles
    vertices_of, edges_of, faces_of = (
        int(np.isin(piece[each], open_pieces).sum()) for each in (np.unique(edges), edges[:, 0], mesh.faces[:, 0])
    )
    holes = len(open_pieces) - (vertices_of - edges_of + faces_of)
    vector = np.cross(mesh.triangles[:, 1] - mesh.triangles[:, 0], mesh.triangles[:, 2] - mesh.triangles[:, 0])
    gap = np.linalg.norm(vector.sum(axis=0)) / max(np.linalg.norm(vector, axis=1).sum(), 1e-12)
    return Openness(share, max(holes, 0) / len(mesh.faces), share / (2.0 - share), float(gap))


def open_warning(name: str, found: Openness, *, is_seat: bool) -> str:
    """What to tell of an open mesh; "" where it is as open as meshes of cars are: panes, panels, a shell with windows."""
    if found.holes > _MANY_HOLES and found.open_edges > _MANY_OPEN:
        return (
            f"{name}: {100 * found.open_edges:.0f} % of its edges are open, as if {100 * found.missing:.0f} % of its triangles"
            " were missing: people pass through the holes; export it anew"
        )
    if is_seat and found.gap > _OPEN_SEAT:
        return (
            f"{name}: a seat with holes of {100 * found.gap:.0f} % of its surface counts as a sheet,"
            " not as a solid with foam inside; close it"
        )
    return ""


def mesh_parts(
    path: Path,
    meshes: Sequence[NamedMesh],
    rules: Sequence[tuple[Rule, tuple[Floats, Floats] | None]],
    groups: Mapping[str, Matrix],
    h_points: Floats,
    shell_m: float,
) -> tuple[list[Part], list[str], list[str]]:
    """Sort the meshes of a file into the parts of a cabin.

    Parameters
    ----------
    path
        The mesh file, for messages.
    meshes
        In the vehicle frame.
    rules
        The user's, each with its box (low, high: (3,) m, vehicle frame) where it has `within`.
    groups
        `vehicle_from_group` by name, at the design position.
    h_points
        (S, 3) m, vehicle frame.
    shell_m
        Thickness on both sides of open surfaces.

    Returns
    -------
    parts, notes, warnings
        Parts in the frames of their groups, what was done to the meshes, and what is wrong with them.

    Raises
    ------
    MeshError
        Where the rules hide every mesh.
    """
    parts, notes, warnings = [], [], []
    idle = [rule for rule, _ in rules]
    for mesh, rule, share in _shares(meshes, (*rules, *((rule, None) for rule in COMMON_RULES))):
        idle = [each for each in idle if each is not rule]
        if rule.hide:
            continue
        cut_from = "" if rule.within is None else mesh.name
        name = f"{mesh.name} ({rule.group})" if cut_from else mesh.name
        pieces, remark = _cleaned(mesh.vertices, mesh.faces[share], h_points)
        if remark:
            notes.append(f"{name}: {remark}")
        if not all(closed for _, closed in pieces):
            warnings.append(_open_share(mesh, rule, share, name))
        for solid, closed in pieces:
            surface = to_surface(solid.moved(invert(groups[rule.group])), rule.label, rule.material)
            parts.append(Part(name, surface, rule.group, rule.give_mm / 1000, closed, 0.0 if closed else shell_m, cut_from))
    if not parts:
        raise MeshError(f"{path}: every mesh is hidden by a rule", hint="leave at least the seats and the floor")
    for rule in idle:
        where = "no mesh of such a name" if rule.within is None else "nothing of such a name in its box"
        warnings.append(f"the rule '{rule.pattern}' takes nothing: there is {where}, or rules before it took it")
    return parts, notes, list(dict.fromkeys(filter(None, warnings)))


def _open_share(mesh: NamedMesh, rule: Rule, share: Ints, name: str) -> str:
    """`open_warning` of the faces of a mesh that a rule takes; of the whole mesh where they are cut out of a piece of it."""
    piece = piece_of_face(mesh.vertices, mesh.faces)
    others = np.delete(piece, share)
    if np.isin(piece[share], others).any():
        return open_warning(mesh.name, openness(mesh.vertices, mesh.faces), is_seat=False)
    is_seat = rule.label in ("seat", "headrest") or (rule.group != STATIC_GROUP and rule.give_mm > 0)
    return open_warning(name, openness(mesh.vertices, mesh.faces[share]), is_seat=is_seat)


def _shares(
    meshes: Sequence[NamedMesh], rules: Sequence[tuple[Rule, tuple[Floats, Floats] | None]]
) -> Iterator[tuple[NamedMesh, Rule, Ints]]:
    """Each mesh with the rules that it falls under, and the numbers of its faces of each."""
    left = [np.arange(len(mesh.faces)) for mesh in meshes]
    shares: list[list[tuple[Rule, Ints]]] = [[] for _ in meshes]
    for rule, box in rules:
        named = [i for i, mesh in enumerate(meshes) if len(left[i]) and rule.names(mesh.name)]
        taken = (
            [np.ones(len(left[i]), np.bool_) for i in named]
            if box is None
            else faces_within([(meshes[i].vertices, meshes[i].faces[left[i]]) for i in named], *box)
        )
        for i, these in zip(named, taken, strict=True):
            if these.any():
                shares[i].append((rule, left[i][these]))
                left[i] = left[i][~these]
    for mesh, several in zip(meshes, shares, strict=True):
        yield from ((mesh, rule, share) for rule, share in several)


def faces_within(meshes: Sequence[tuple[Floats, Ints32]], low: Floats, high: Floats) -> list[Bools]:
    """Which faces of meshes (vertices (V, 3) m, faces (F, 3)) a box means; low, high: its corners (3,) m, the same frame.

    Connected pieces of which most lies in it, so that they stay closed; where these are little of what is in the box, as with
    a seat that is one with the body, all triangles whose middle is in it.
    """
    pieces, cuts = [], []
    in_pieces = in_box = 0.0
    for vertices, faces in meshes:
        corners = vertices[faces]
        area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
        middle = corners.mean(axis=1)
        inside = ((middle >= low) & (middle <= high)).all(axis=1)
        cuts.append(inside)
        if not inside.any():
            pieces.append(inside)
            continue
        piece = piece_of_face(vertices, faces)
        share = np.bincount(piece, area * inside) / np.maximum(np.bincount(piece, area), 1e-12)
        pieces.append(share[piece] > _MOST)
        in_pieces += float(area[pieces[-1] & inside].sum())
        in_box += float(area[inside].sum())
    return pieces if in_pieces >= _ENOUGH * in_box else cuts


def piece_of_face(vertices: Floats, faces: Ints32) -> Ints:
    """(F,) number of the connected piece that each face (F, 3) of vertices (V, 3) m belongs to, doubled vertices merged."""
    _, merged = welded(vertices)
    triangles = merged[faces]
    ends = triangles[:, [0, 1, 1, 2]].reshape(-1, 2)
    return np.asarray(trimesh.graph.connected_component_labels(ends, merged.max() + 1)[triangles[:, 0]], np.int64)


def _cleaned(vertices: Floats, faces: Ints32, h_points: Floats) -> tuple[list[tuple[Solid, bool]], str]:
    """The mesh without doubled and degenerate triangles: what of it is solid and what is not, and what was done to it.

    Connected pieces are judged one by one: a car in one mesh is mostly many closed pieces and some that are open.
    """
    mesh = trimesh.Trimesh(vertices, faces, process=False)
    mesh.merge_vertices()
    f = np.asarray(mesh.faces)
    f = f[(f[:, 0] != f[:, 1]) & (f[:, 1] != f[:, 2]) & (f[:, 2] != f[:, 0])]
    first, _ = distinct_rows(np.sort(f, axis=1))
    doubled = len(f) - len(first)
    remarks = [f"{doubled} triangles lay twice in one place: one of each kept"] if doubled else []
    v, f = np.asarray(mesh.vertices, dtype=np.float64), f[np.sort(first)].astype(np.int32)
    if not len(f):
        return [], "; ".join(remarks)
    piece = piece_of_face(v, f)
    corners = v[f]
    volume = np.bincount(piece, np.einsum("ij,ij->i", corners[:, 0], np.cross(corners[:, 1], corners[:, 2])))
    closed = np.bincount(piece, _open_sides(f)) == 0
    inward = closed & (volume < 0)
    if inward.any():
        f = np.where(inward[piece][:, None], f[:, ::-1], f)
        remarks.append("faces looked inwards: turned")
    around = closed & np.any([np.bincount(piece, _solid_angle(v[f], h)) > 2 * np.pi for h in h_points], axis=0)
    if around.any():
        remarks.append("closed around an occupant: taken as a shell")
    solid = (closed & ~around)[piece]
    return [(_piece(v, f[of]), is_solid) for of, is_solid in ((solid, True), (~solid, False)) if of.any()], "; ".join(remarks)


def _piece(vertices: Floats, faces: Ints32) -> Solid:
    """Some faces with the vertices that they use."""
    used, local = np.unique(faces, return_inverse=True)
    return Solid(vertices[used], np.ascontiguousarray(local.reshape(faces.shape), dtype=np.int32))


def _open_sides(faces: Ints32) -> Ints:
    """(F,) how many sides of each face have no neighbour, or more than one, or one that looks the other way round."""
    ends = np.stack((faces, np.roll(faces, -1, axis=1)), axis=2).reshape(-1, 2)
    _, edge = distinct_rows(np.sort(ends, axis=1))
    forward = np.bincount(edge, ends[:, 0] < ends[:, 1])
    good = (np.bincount(edge) == 2) & (forward == 1)
    return np.asarray((~good[edge]).reshape(-1, 3).sum(axis=1))


def _solid_angle(corners: Floats, point: Floats) -> Floats:
    """(F,) sr under which triangles (F, 3, 3) are seen from a point: 4 pi in all from inside a closed mesh, 0 from outside.

    van Oosterom and Strackee 1983.
    """
    a, b, c = (corners[:, i] - point for i in range(3))
    la, lb, lc = (np.linalg.norm(v, axis=1) for v in (a, b, c))
    numerator = np.einsum("ij,ij->i", a, np.cross(b, c))
    denominator = la * lb * lc + np.sum(a * b, 1) * lc + np.sum(b * c, 1) * la + np.sum(c * a, 1) * lb
    return np.asarray(2 * np.arctan2(numerator, denominator))
