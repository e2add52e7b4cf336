"""The people of a dataset by their names: named ones of the package, the user's own, a crowd, and children for child seats."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import replace
from typing import Any

import numpy as np

from cabinpose.core import ConfigError, unknown_name
from cabinpose.scene.body import (
    SEATED_YEARS,
    SUBJECTS,
    BodyModel,
    Outfit,
    Person,
    Phenotype,
    Sex,
    age_of,
    face_number,
    hair_shares,
    load_population,
    usual_stature_m,
)
from cabinpose.synth.config import SynthConfig
from cabinpose.synth.once import cached_once
from cabinpose.synth.people import CHILD_NAME, OwnPerson, People
from cabinpose.synth.streams import CHILD_STREAM, PEOPLE_STREAM, frame_rng, own_rng

CHILDREN = 24  # of each kind, of evenly spread ages
# Who lies in carriers, sits on child seats, and toddlers in harnesses or without a seat: by the first letter of their names.
_CHILD_YEARS = {"I": (0.0, 1.0), "K": (3.0, 11.5), "T": (0.75, 3.0)}
_LEAST_M = {"K": 0.90}  # of who is drawn for a child seat: shorter ones are among toddlers
_MUSCLES = (0.3, 0.2, 0.1, 0.0)  # of own people, the first with which a body can have the mass: heavy ones have less
_KEPT = 80  # dressed people, of 1.5 MB: all outfits of those that are in play
_OUTFITS = 3  # of a named person beside the first, kept over all datasets
_BEARD_YEARS, _BALD_YEARS, _WALKS_YEARS = 16.0, 25.0, 1.0
_WEIGHT = 0.65  # of own people; about the average of S01 .. S18
# What nobody wears who is younger, years, and what is worn in its place; all assumed. Harnesses go over no coats.
_WORN_FROM: tuple[tuple[float, str, str | bool, str | bool], ...] = (
    (_WALKS_YEARS, "scarf", True, False), (_WALKS_YEARS, "gloves", True, False),
    *((_WALKS_YEARS, "headwear", name, "none") for name in ("hood", "hat")),
    *((_WALKS_YEARS, "bottom", name, "trousers") for name in ("jeans", "skirt", "long_skirt", "dress")),
    *((_WALKS_YEARS, "shoes", name, "none") for name in ("trainers", "leather")),
    (_WALKS_YEARS, "top", "hoodie", "jumper"), (SEATED_YEARS, "top", "coat", "jumper"), (SEATED_YEARS, "mask", True, False),
    *((SEATED_YEARS, "glasses", name, "none") for name in ("clear", "sun")),
    (8.0, "headwear", "headscarf", "none"),
)  # fmt: skip


class Subjects:
    """The people of one dataset. Holds the bodies used last, a bounded number."""

    def __init__(self, people: People, seed: int, *, like: Subjects | None = None) -> None:
        """like: those of a dataset whose bodies are taken over where people and seed make the same ones."""
        self._people, self._seed = people, seed
        self._person, self._first = cached_once(_KEPT)(self._make_person), cached_once(_KEPT)(self._make_body)
        self.drives = cached_once(1024)(self._old_enough)
        self._stature_m = cached_once(len(_CHILD_YEARS) * CHILDREN)(self._drawn_stature)
        if like is not None and like._seed == seed and like._people == people:
            self._person, self._first = like._person, like._first

    def outfits(self, name: str) -> int:
        """How many outfits somebody has: children in child seats one."""
        if name in self._people.own:
            return len(self._people.own[name].outfits)
        return 1 if CHILD_NAME.fullmatch(name) else self._people.outfits

    def worn(self, name: str, index: int, *, every: int = 1) -> int:
        """The number of the outfit that somebody wears in frame `index`, or in the sequence that begins there.

        every: for so many frames the same, where people change often enough without.
        """
        count = self.outfits(name)
        return 0 if count == 1 else int(own_rng(self._seed, f"outfit of {name} in {index // every}").integers(count))

    def body(self, name: str, number: int = 0) -> tuple[Phenotype, Outfit]:
        """Shape and clothes of somebody; a function of people, seed and name alone, whatever was drawn before.

        number: of the outfit. All have the person's hair, beard, sight and headscarf.
        """
        face = face_number(name if self._everywhere_the_same(name) else f"{name} of {self._seed}")
        phenotype, outfit = self._symmetric_body(name, face)
        if self._people.asymmetric:  # whoever has a name is the same in all datasets
            seed = 0 if self._everywhere_the_same(name) else self._seed
            phenotype = replace(phenotype, asymmetry=int(own_rng(seed, name).integers(1, 1 << 31)))
        if name in self._people.own:
            return phenotype, self._people.own[name].outfits[number]
        if number:
            rng = own_rng(0 if self._everywhere_the_same(name) else self._seed, f"outfit {number} of {name}")
            outfit = outfit.redressed(_suited(Outfit.random(rng=rng, gender=phenotype.gender), phenotype))
        return phenotype, replace(outfit, number=number)

    def _everywhere_the_same(self, name: str) -> bool:
        return name in SUBJECTS or name in self._people.own

    def children(self, stature_m: tuple[float, float], kinds: str = "K") -> list[str]:
        """The children whose stature is in a range, m; kinds: first letters of their names."""
        names = [f"{kind}{number:02d}" for kind in kinds for number in range(CHILDREN)]
        statures = {name: self._stature_m(name) for name in names}
        low, high = stature_m
        return [name for name, stature in statures.items() if max(low, _LEAST_M.get(name[0], 0.0)) <= stature <= high]

    def _drawn_stature(self, name: str) -> float:
        return self.body(name)[0].stature_m or 0.0

    def _symmetric_body(self, name: str, face: int) -> tuple[Phenotype, Outfit]:
        """face: number of the face of who has none by the name alone."""
        if name in SUBJECTS:
            return SUBJECTS[name].phenotype, SUBJECTS[name].outfit
        if name in self._people.own:
            try:
                return _own_body(self._people.own[name], face)
            except ConfigError as error:
                raise ConfigError(f"{name}: {error}", hint=error.hint) from None
        if child := CHILD_NAME.fullmatch(name):
            number, kinds = int(child[2]), {"K": 0, "I": 1, "T": 2}
            rng = frame_rng(self._seed, CHILD_STREAM + CHILDREN * kinds[child[1]] + number)
            years = np.interp(number + rng.random(), (0, CHILDREN), _CHILD_YEARS[child[1]])
            population = crowd.drawn_from if (crowd := self._people.random) else None
            if population is None or not population.has(years):
                population = load_population("nhanes" if years >= SEATED_YEARS else "cdc")
            body = replace(Phenotype.of_size(population.draw(rng=rng, years=(years, years)), rng=rng), face=face)
            hair = hair_shares(body.gender, body.years)
            return body, _suited(Outfit.random(rng=rng, hair=hair, gender=body.gender), body)
        crowd = self._people.random
        if crowd is None or not name.startswith("R"):
            raise unknown_name("subject", name, self._people.names)
        rng = frame_rng(self._seed, PEOPLE_STREAM - int(name[1:]))
        phenotype = replace(crowd.draw(rng=rng), face=face)
        hair = hair_shares(phenotype.gender, phenotype.years)
        return phenotype, _suited(Outfit.random(rng=rng, hair=hair, gender=phenotype.gender), phenotype)

    def person(self, name: str, number: int = 0) -> Person:
        """Somebody in one of their outfits."""
        return self._person(name, number)

    def _old_enough(self, name: str) -> bool:
        """Whether somebody drives in this dataset."""
        least = self._people.driver_years
        return least <= SEATED_YEARS or self.body(name)[0].years >= least

    def _make_person(self, name: str, number: int) -> Person:
        if not number:
            return self._first(name)
        outfit = self.body(name, number)[1]
        if name in SUBJECTS and not self._people.asymmetric:
            return _redressed(name, outfit)
        return self._first(name).redressed(outfit)

    def _make_body(self, name: str) -> Person:
        """Somebody in the first outfit."""
        if name in SUBJECTS and not self._people.asymmetric:
            return _named_person(name)
        return BodyModel.load().person(*self.body(name))


def subject_body(config: SynthConfig, seed: int, subject: str) -> tuple[Phenotype, Outfit]:
    """Shape and clothes of a person of a dataset; a function of the arguments alone."""
    return Subjects(config.people, seed).body(subject)


@cached_once(2 * len(SUBJECTS))
def _named_person(name: str) -> Person:
    """Who is the same in all datasets, in the first outfit; percentiles are kept beside the listed ones."""
    return BodyModel.load().person(SUBJECTS[name].phenotype, SUBJECTS[name].outfit)


@cached_once(_OUTFITS * len(SUBJECTS))
def _redressed(name: str, outfit: Outfit) -> Person:
    """The same in another outfit; apart from the first ones, which these never crowd out: bodies are made once."""
    return _named_person(name).redressed(outfit)


def _suited(outfit: Outfit, phenotype: Phenotype) -> Outfit:
    """The outfit with the beard and baldness of men alone, and of children what they wear."""
    grown_man = phenotype.gender < 0.5 and phenotype.years >= _BEARD_YEARS
    instead: dict[str, Any] = {
        kind: other for years, kind, name, other in _WORN_FROM if phenotype.years < years and getattr(outfit, kind) == name
    }
    outfit = replace(outfit, **instead)
    if phenotype.years < _WALKS_YEARS:  # in a romper suit, socks and little hair
        outfit = replace(outfit, beard=False, hair="short")
        return replace(outfit, hair="bald") if outfit.folds % 2 else outfit
    return replace(
        outfit,
        beard=outfit.beard and grown_man,
        hair="short" if outfit.hair == "bald" and not (grown_man and phenotype.years >= _BALD_YEARS) else outfit.hair,
    )


def _own_body(own: OwnPerson, face: int) -> tuple[Phenotype, Outfit]:
    """Raises ConfigError where no body has the mass."""
    gender = {"male": 0.0, "female": 1.0}.get(own.gender, 0.5) if isinstance(own.gender, str) else own.gender
    age = age_of(own.years)
    stature = own.stature_cm / 100.0 if own.stature_cm is not None else usual_stature_m(gender, age)[0]
    if own.years < SEATED_YEARS and own.weight is None and own.muscle is None:
        sex: Sex = "female" if gender > 0.5 else "male"
        usual = load_population("cdc").of_percentile(sex, 50.0, own.years)
        mass = own.mass_kg if own.mass_kg is not None else usual.mass_kg * (stature / usual.stature_m) ** 2
        return replace(Phenotype.of_size(usual.with_size(stature, mass), rng=None), face=face), own.outfits[0]
    muscles = _MUSCLES if own.muscle is None else (own.muscle,)
    weight = _WEIGHT if own.weight is None else own.weight
    body = Phenotype(gender, age, muscles[0], weight, own.height, own.proportions, stature, face=face)
    if own.mass_kg is None:
        return body, own.outfits[0]
    for muscle in muscles[:-1]:
        with suppress(ConfigError):
            return BodyModel.load().with_mass(replace(body, muscle=muscle), own.mass_kg), own.outfits[0]
    return BodyModel.load().with_mass(replace(body, muscle=muscles[-1]), own.mass_kg), own.outfits[0]
