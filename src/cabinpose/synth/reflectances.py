"""What the surfaces of a scene reflect in near infrared: skin and hair of each person, dye of each garment, trim of each car.

Drawn apart from the colours, with which they agree only as far as one pigment absorbs both: black cloth may be bright, and a blue
print dark. The same in every frame of a dataset, of a seed, a name and a camera's wavelength alone.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from cabinpose.core import Bytes, Floats
from cabinpose.core import reproducible as rp
from cabinpose.scene import DYES, FIRST_COAT, HAIR, MATERIAL_ID, MATERIALS, SKIN, SKIN_LIMITS, Coat, Surface, Wavelength
from cabinpose.scene.body import Outfit, Person, worn
from cabinpose.store import AXES
from cabinpose.synth.once import cached_once
from cabinpose.synth.person_look import NOT_WORN, WORN, PersonLook, look_of, worn_faces
from cabinpose.synth.pictures.look import draw_trim
from cabinpose.synth.scene import Scene
from cabinpose.synth.streams import own_rng

_LUMINANCE = np.array((0.2126, 0.7152, 0.0722))  # of linear sRGB
_OF_CARS = ("seat_fabric", "seat_leather", "soft_trim", "hard_plastic", "headliner", "carpet", "steering_leather")
_AT = {material.name: material.at for material in MATERIALS}
_FIRST = WORN.index("inner")  # of the places that have a stream of their own
_KEPT = 64  # people and cars that are remembered


@dataclass(frozen=True)
class WornReflectance:
    """What somebody's surfaces reflect.

    reflectance, material: of each of `person_look.WORN` · faces: (F,) which of them each triangle is, as `worn_faces` says.
    """

    reflectance: Mapping[str, float]
    material: Mapping[str, str]
    faces: Bytes

    def labels(self, outfit: Outfit, wavelength_nm: Wavelength) -> tuple[float, ...]:
        """What is on each place of the axis `worn` of datasets reflects, NaN where nothing is."""
        wears = worn(outfit)
        own = {**self.reflectance, "beard": self.reflectance["hair"]}
        return tuple(
            own.get(place, _AT[wears[place][1]](wavelength_nm)) if wears.get(place, ("", ""))[1] else np.nan
            for place in AXES["worn"]
        )


@dataclass(frozen=True)
class SceneReflectance:
    """A scene's surface, whose material is a code of `coats` where they have one; and what each person's places reflect.

    worn: by slot, over the axis `worn` of datasets.
    """

    surface: Surface
    coats: tuple[Coat, ...]
    worn: Mapping[str, tuple[float, ...]]


class Reflectances:
    """Those of the people and cars of one dataset."""

    def __init__(self, seed: int, wavelength_nm: Wavelength) -> None:
        self._seed, self._wavelength = seed, wavelength_nm
        self.person = cached_once(_KEPT)(self._draw_person)
        self._car = cached_once(_KEPT)(self._draw_car)

    def of(self, scene: Scene, surface: Surface) -> SceneReflectance:
        """What is seen of a scene; surface: `scene.surface()`."""
        material = surface.material.copy()
        start, coats, labels = len(scene.backdrop.faces), list[Coat](), {}
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
            start += sum(len(s.faces) for s in who.surfaces)
        return SceneReflectance(replace(surface, material=material), tuple(coats), labels)

    def _draw_person(self, subject: str, person: Person) -> WornReflectance:
        rng = own_rng(self._seed, f"near infrared of {subject}")
        wears, ranks, kinds = worn(person.outfit), rng.random(_FIRST), rng.random(_FIRST)
        more = own_rng(self._seed, f"near infrared of small clothes of {subject}").random((2, len(WORN) - _FIRST))
        ranks, kinds = (np.concatenate(both) for both in ((ranks, more[0]), (kinds, more[1])))
        if number := person.outfit.number:  # clothes of its own, on the same skin and hair
            other = own_rng(self._seed, f"near infrared of {subject} in outfit {number}").random((2, len(WORN)))
            ranks[2:], kinds[2:] = other[0, 2:], other[1, 2:]
        look = look_of(person, self._seed, subject)
        material = dict.fromkeys(WORN, "cotton") | {"skin": "skin", "hair": "hair", "scarf": "wool", "gloves": "wool"}
        material["mask"] = "synthetic_fabric"
        material |= {name: wears[name][1] for name in ("top", "bottom", "shoes", "headwear") if wears[name][1]}
        result = {"skin": self._skin(look.tone, float(rng.standard_normal())), "hair": self._hair(look, float(ranks[1]))}
        for k, name in enumerate(WORN):
            if name not in result:
                dyes = "print" if name.endswith("_print") else material[name]
                seen = float(rp.matmul(_LUMINANCE, look.colours[name]))
                result[name] = self._dyed(dyes, float(kinds[k]), float(ranks[k]), seen)
        return WornReflectance(result, material, worn_faces(person, look))

    def _draw_car(self, place: str) -> tuple[Coat, ...]:
        rng = own_rng(self._seed, f"near infrared of {place}")
        colours: Mapping[str, Floats] = draw_trim(rng=own_rng(self._seed, place)).colours()
        coats = []
        for name in _OF_CARS:
            kind, rank = rng.random(2).tolist()
            value = self._dyed(name, kind, rank, float(rp.matmul(_LUMINANCE, colours[name])))
            coats.append(Coat(MATERIAL_ID[name], MATERIAL_ID[name], value))
        return tuple(coats)

    def _dyed(self, material: str, kind: float, rank: float, seen: float) -> float:
        """Of a material whose dye is drawn by `kind`, 0..1, over their shares."""
        dyes = DYES[material]
        bounds = np.cumsum([dye.share for dye in dyes])
        dye = dyes[min(int(np.searchsorted(bounds, kind * bounds[-1], side="right")), len(dyes) - 1)]
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
