"""What the surfaces of a scene reflect in near infrared: skin and hair of people, dyes of garments, of cars' trim and of things.

Drawn apart from the colours, with which they agree only as far as one pigment absorbs both: black cloth may be bright, and a blue
print dark. The same in every frame of a dataset, of a seed, a name and a camera's wavelength alone.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from cabinpose.core import Bytes, Camera, Floats, Ints, Matrix, apply, at_rank
from cabinpose.core import reproducible as rp
from cabinpose.scene import DYES, FIRST_COAT, HAIR, MATERIAL_ID, MATERIALS, SKIN, SKIN_LIMITS, Coat, Surface, Wavelength
from cabinpose.scene.body import Outfit, Person, worn
from cabinpose.scene.sensor import GeometryBuffers
from cabinpose.scene.things import Thing
from cabinpose.store import AXES
from cabinpose.synth.once import cached_once
from cabinpose.synth.person_look import NOT_WORN, WORN, PersonLook, look_of, pattern_cells, worn_faces
from cabinpose.synth.pictures.look import draw_trim, thing_colours
from cabinpose.synth.render import RenderedFrame
from cabinpose.synth.scene import Scene
from cabinpose.synth.streams import own_rng

_LUMINANCE = np.array((0.2126, 0.7152, 0.0722))  # of linear sRGB
_OF_CARS = ("seat_fabric", "seat_leather", "soft_trim", "hard_plastic", "headliner", "carpet", "steering_leather")
_AT = {material.name: material.at for material in MATERIALS}
_ACROSS = np.iinfo(np.int64).min  # of a triangle that a pattern's border goes through
_FIRST = WORN.index("inner")  # of the places that have a stream of their own
_KEPT = 64  # people and cars that are remembered


class Pattern(NamedTuple):
    """What is printed on a garment.

    part: of `WORN` · kind: as in `PersonLook.patterns` · faces: (F,) the stripe or check that holds all of a triangle of the
    wearer's, `_ACROSS` where a border goes through it · rest: (F, 3, 3) their corners at rest, m.
    """

    part: str
    kind: str
    faces: Ints
    rest: Floats


class Print(NamedTuple):
    """A pattern in a scene. cloth, code: of the coats of cloth and print · first: the wearer's first triangle in its surface."""

    cloth: int
    code: int
    first: int
    pattern: Pattern


@dataclass(frozen=True)
class WornReflectance:
    """What somebody's surfaces reflect.

    reflectance, material: of each of `person_look.WORN` · faces: (F,) which of them each triangle is, as `worn_faces` says ·
    patterns: on garments.
    """

    reflectance: Mapping[str, float]
    material: Mapping[str, str]
    faces: Bytes
    patterns: tuple[Pattern, ...]

    def labels(self, outfit: Outfit, wavelength_nm: Wavelength) -> tuple[float, ...]:
        """What is on each place of the axis `worn` of datasets reflects, NaN where nothing is."""
        wears = worn(outfit)
        return tuple(
            np.nan
            if (of := wears.get(place)) is None
            else self.reflectance[of.coat]
            if of.coat
            else _AT[of.material](wavelength_nm)
            for place in AXES["worn"]
        )


@dataclass(frozen=True)
class SceneReflectance:
    """A scene's surface, whose material is a code of `coats` where they have one; and what each person's places reflect.

    Prints are on whole triangles there, and where they are to the pixel in what `printed` makes of a view of `plain`.

    worn: by slot, over the axis `worn` of datasets · prints: of all who wear one.
    """

    surface: Surface
    coats: tuple[Coat, ...]
    worn: Mapping[str, tuple[float, ...]]
    prints: tuple[Print, ...] = ()

    @property
    def plain(self) -> Surface:
        """The surface with the coats of cloth in place of those of prints."""
        if not self.prints:
            return self.surface
        table = np.arange(256, dtype=np.uint8)
        table[[each.code for each in self.prints]] = [each.cloth for each in self.prints]
        return replace(self.surface, material=table[self.surface.material])

    def printed(self, seen: RenderedFrame, camera: Camera, world_from_camera: Matrix) -> GeometryBuffers:
        """Buffers of a view of `plain`, with prints where a pattern has them at the pixels' centres; in the view's memory."""
        buffers = replace(seen.buffers, coats=self.coats)
        material, face = buffers.material.reshape(-1), seen.face_id.reshape(-1)
        for each in self.prints:
            of = each.pattern
            at = np.flatnonzero((material == each.cloth) & (face >= each.first) & (face < each.first + len(of.faces)))
            cell = of.faces[face[at] - each.first]
            across = np.flatnonzero(cell == _ACROSS)
            cell[across] = self._cells(each, at[across], seen, camera, world_from_camera)
            coloured = at[cell % 2 == 1]
            material[coloured] = each.code
            whole = np.zeros(material.size, np.bool_)
            whole[coloured] = True
            parts = buffers.parts_material
            parts[whole[buffers.mixed][:, None] & (parts == each.cloth)] = each.code
        return buffers

    def _cells(self, of: Print, at: Ints, seen: RenderedFrame, camera: Camera, world_from_camera: Matrix) -> Ints:
        """Stripes or checks in which pixels (N,), flat, see a garment: by its place at rest, from their places on triangles."""
        depth, triangle = seen.depth_clean.reshape(-1)[at], seen.face_id.reshape(-1)[at]
        ray = np.concatenate((camera.rays.reshape(-1, 2)[at], np.ones((len(at), 1))), axis=1)
        a, b, c = (self.surface.vertices[self.surface.faces[triangle, k]] for k in range(3))
        along, beside, point = b - a, c - a, apply(world_from_camera, ray * depth[:, None]) - a
        uu, uv, vv, pu, pv = (
            np.einsum("ij,ij->i", x, y, dtype=np.float64)
            for x, y in ((along, along), (along, beside), (beside, beside), (point, along), (point, beside))
        )
        area = np.maximum(uu * vv - uv**2, 1e-30)
        u, v = (pu * vv - pv * uv) / area, (pv * uu - pu * uv) / area
        share = np.clip(np.stack((1.0 - u - v, u, v), axis=1), 0.0, 1.0)
        return pattern_cells(of.pattern.kind, np.einsum("nk,nkj->nj", share, of.pattern.rest[triangle - of.first]))


class Reflectances:
    """Those of the people and cars of one dataset."""

    def __init__(self, seed: int, wavelength_nm: Wavelength) -> None:
        self._seed, self._wavelength = seed, wavelength_nm
        self.person = cached_once(_KEPT)(self._draw_person)
        self._car = cached_once(_KEPT)(self._draw_car)
        self._thing = cached_once(_KEPT)(self._draw_thing)

    def of(self, scene: Scene, surface: Surface) -> SceneReflectance:
        """What is seen of a scene; surface: `scene.surface()`."""
        material = surface.material.copy()
        start, coats, labels, prints = len(scene.backdrop.faces), list[Coat](), {}, list[Print]()
        if scene.cabin is not None:
            first = FIRST_COAT + len(scene.people) * len(WORN)
            for k, coat in enumerate(self._car(scene.trim)):
                material[:start][surface.material[:start] == coat.material] = first + k
                coats.append(coat._replace(code=first + k))
        for number, who in enumerate(scene.people):
            found = self.person(who.subject, who.person)
            labels[who.slot] = found.labels(who.person.outfit, self._wavelength)
            if not who.surfaces:
                continue
            first = FIRST_COAT + number * len(WORN)
            body = material[start : start + len(found.faces)]
            np.copyto(body, found.faces + np.uint8(first), where=found.faces != NOT_WORN)
            coats += [Coat(first + k, MATERIAL_ID[found.material[name]], found.reflectance[name]) for k, name in enumerate(WORN)]
            for pattern in found.patterns:
                cloth, code = (first + WORN.index(name) for name in (pattern.part, f"{pattern.part}_print"))
                prints.append(Print(cloth, code, start, pattern))
            start += sum(len(s.faces) for s in who.surfaces)
        code = FIRST_COAT + len(scene.people) * len(WORN) + len(_OF_CARS)
        for thing, *_ in scene.things:
            own, of = thing.surface.material, material[start : start + len(thing.surface.faces)]
            for coat in self._thing(thing):
                of[own == coat.material] = code
                coats.append(coat._replace(code=code))
                code += 1
            start += len(of)
        return SceneReflectance(replace(surface, material=material), tuple(coats), labels, tuple(prints))

    def _draw_person(self, subject: str, person: Person) -> WornReflectance:
        rng = own_rng(self._seed, f"near infrared of {subject}")
        ranks, kinds = rng.random(_FIRST), rng.random(_FIRST)
        more = own_rng(self._seed, f"near infrared of small clothes of {subject}").random((2, len(WORN) - _FIRST))
        ranks, kinds = (np.concatenate(both) for both in ((ranks, more[0]), (kinds, more[1])))
        if number := person.outfit.number:  # clothes of its own, on the same skin and hair
            other = own_rng(self._seed, f"near infrared of {subject} in outfit {number}").random((2, len(WORN)))
            ranks[2:], kinds[2:] = other[0, 2:], other[1, 2:]
        look = look_of(person, self._seed, subject)
        material = dict.fromkeys(WORN, "cotton") | {"skin": "skin", "hair": "hair"}
        material |= {place: of.material for place, of in worn(person.outfit).items() if of.coat == place}
        result = {"skin": self._skin(look.tone, float(rng.standard_normal())), "hair": self._hair(look, float(ranks[1]))}
        for k, name in enumerate(WORN):
            if name not in result:
                dyes = "print" if name.endswith("_print") else material[name]
                seen = float(rp.matmul(_LUMINANCE, look.colours[name]))
                result[name] = self._dyed(dyes, float(kinds[k]), float(ranks[k]), seen)
        printed = {part: kind for part, kind in look.patterns.items() if kind}
        rest = person.dressed.rest[person.dressed.faces].astype(np.float64) if printed else np.empty((0, 3, 3))
        patterns = tuple(Pattern(part, kind, _whole_cells(kind, rest), rest) for part, kind in printed.items())
        return WornReflectance(result, material, worn_faces(person, look), patterns)

    def _draw_car(self, place: str) -> tuple[Coat, ...]:
        colours: Mapping[str, Floats] = draw_trim(rng=own_rng(self._seed, place)).colours()
        return self._coats(place, {name: colours[name] for name in _OF_CARS})

    def _draw_thing(self, thing: Thing) -> tuple[Coat, ...]:
        """Of what things of this design are made of, where that is dyed."""
        name = f"{thing.kind} {thing.variant}"
        colours, of = thing_colours(thing.surface, rng=own_rng(self._seed, name)), thing.surface.material
        made_of = {each: of == MATERIAL_ID[each] for each in DYES if each in MATERIAL_ID and (of == MATERIAL_ID[each]).any()}
        return self._coats(name, {each: colours[where].mean(axis=0, dtype=np.float64) for each, where in made_of.items()})

    def _coats(self, owner: str, colours: Mapping[str, Floats]) -> tuple[Coat, ...]:
        """Of materials by name, whose colours are linear sRGB (3,)."""
        rng = own_rng(self._seed, f"near infrared of {owner}")
        coats = []
        for name, colour in colours.items():
            kind, rank = rng.random(2).tolist()
            value = self._dyed(name, kind, rank, float(rp.matmul(_LUMINANCE, colour)))
            coats.append(Coat(MATERIAL_ID[name], MATERIAL_ID[name], value))
        return tuple(coats)

    def _dyed(self, material: str, kind: float, rank: float, seen: float) -> float:
        """Of a material whose dye is drawn by `kind`, 0..1, over their shares."""
        dye = at_rank({dye: dye.share for dye in DYES[material]}, kind)
        return dye.at(rank, self._wavelength, seen)

    def _skin(self, tone: float, deviation: float) -> float:
        rows = [row.at_850 if self._wavelength == 850 else row.at_940 for row in SKIN]
        tones = [row.tone for row in SKIN]
        mean, sd = (float(np.interp(tone, tones, [row[k] for row in rows])) for k in (0, 1))
        return float(np.clip(mean + sd * deviation, *SKIN_LIMITS[self._wavelength]))

    @staticmethod
    def _hair(look: PersonLook, rank: float) -> float:
        """Of hair that has partly turned grey; what it is dyed with does not absorb there."""
        natural, grey = (low + rank * (high - low) for low, high in (HAIR[look.hair], HAIR["grey"]))
        return natural + look.grey * (grey - natural)


def _whole_cells(kind: str, rest: Floats) -> Ints:
    """(F,) the stripe or check that holds all corners (F, 3, 3) of a triangle, else `_ACROSS`."""
    cells = pattern_cells(kind, rest.reshape(-1, 3)).reshape(-1, 3)
    return np.where((cells == cells[:, :1]).all(axis=1), cells[:, 0], _ACROSS)
