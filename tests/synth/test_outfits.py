"""People and their outfits: several to a person, the same person in all of them."""

from __future__ import annotations

import collections

import numpy as np
import pytest
from scipy import stats

import cabinpose
from cabinpose.core import ConfigError
from cabinpose.scene.body import SUBJECTS
from cabinpose.synth.config import SynthConfig
from cabinpose.synth.exact import exact_config, without_defaults
from cabinpose.synth.people import People
from cabinpose.synth.person_look import look_of
from cabinpose.synth.sample import SceneSampler
from cabinpose.synth.streams import frame_rng
from cabinpose.synth.subjects import CHILDREN, Subjects

SEED = 5
FIRST = {"scene": {"kind": "cabin", "occupancy": {"driver": 1}}, "people": {"subjects": ["S02"]}}


def config(**scene: object) -> SynthConfig:
    return SynthConfig.model_validate(FIRST | {"scene": {**FIRST["scene"], **scene}})


def test_outfits_differ_and_the_person_does_not() -> None:
    subjects = Subjects(People(random={"count": 30}), SEED)  # type: ignore[arg-type]
    clothes = collections.Counter()
    for name in ("S01", "S02", *(f"R{i:04d}" for i in range(30))):
        bodies = [subjects.body(name, number) for number in range(subjects.outfits(name))]
        assert len(bodies) == 3
        assert len({body for body, _ in bodies}) == 1
        assert len({(o.hair, o.beard, o.headwear == "headscarf") for _, o in bodies}) == 1
        clothes[len({(o.top, o.bottom, o.shoes, o.fit) for _, o in bodies})] += 1
    assert clothes == {3: 32}
    one, other = (subjects.person("S02", number) for number in (0, 1))
    looks = [look_of(each, SEED, "S02") for each in (one, other)]
    assert looks[0].tone == looks[1].tone
    assert looks[0].hair == looks[1].hair
    np.testing.assert_array_equal(looks[0].colours["hair"], looks[1].colours["hair"])
    assert any((looks[0].colours[name] != looks[1].colours[name]).any() for name in ("top", "bottom", "shoes"))


def test_outfits_are_worn_equally_often() -> None:
    subjects = Subjects(People(), SEED)
    worn = collections.Counter(subjects.worn("S07", index) for index in range(600))
    assert stats.chisquare([worn[number] for number in range(3)]).pvalue > 0.001
    assert {subjects.worn("S07", index, every=100) for index in range(100)} == {subjects.worn("S07", 0, every=100)}


def test_own_people_have_one_outfit_or_a_list() -> None:
    own = {"anna": {"outfit": {"top": "coat"}}, "bob": {"outfit": [{"top": "shirt"}, {"top": "hoodie", "headwear": "hood"}]}}
    subjects = Subjects(People(own=own), SEED)  # type: ignore[arg-type]
    assert subjects.outfits("anna") == 1
    assert [subjects.body("bob", number)[1].top for number in range(subjects.outfits("bob"))] == ["shirt", "hoodie"]
    with pytest.raises(ConfigError):
        SceneSampler(
            SynthConfig.model_validate(
                {"people": {"own": own}, "scene": {"kind": "cabin", "occupants": {"driver": {"subject": "anna", "outfit": 1}}}}
            ),
            SEED,
        ).sample(0, rng=frame_rng(SEED, 0))


def test_bodies_are_made_once_however_many_outfits() -> None:
    """More outfits than are kept do not crowd out the people themselves, nor what is known of a shape in a kind of shoes."""
    names, people = list(SUBJECTS), People(outfits=8)
    subjects = Subjects(people, SEED)
    made = {(name, number): subjects.person(name, number) for number in range(8) for name in names}
    for name in names:
        assert len({made[name, number].build for number in range(8)}) == len({made[name, n].outfit.shoes for n in range(8)})
    again = Subjects(people, SEED)
    for (name, number), person in made.items():
        assert again.person(name, number).build is person.build
        assert number or again.person(name, number) is person


YOUNG = {"scarf": {False}, "gloves": {False}, "mask": {False}, "glasses": {"none"}, "headwear": {"none", "cap", "beanie"}}


@pytest.mark.parametrize("kind", "IT")
def test_small_children_wear_what_they_can(kind: str) -> None:
    drawn = [Subjects(People(), seed).body(f"{kind}{n:02d}") for seed in range(20) for n in range(CHILDREN)]
    infants = [outfit for phenotype, outfit in drawn if phenotype.years < 1.0]
    toddlers = [outfit for phenotype, outfit in drawn if 1.0 <= phenotype.years < 3.0]
    assert len(infants) > 40
    assert len(toddlers) > 200 or kind == "I"
    for outfit in infants:
        assert all(getattr(outfit, name) in allowed for name, allowed in YOUNG.items())
        assert outfit.bottom in ("trousers", "shorts")
        assert outfit.shoes == "none"
    for outfit in (*infants, *toddlers):
        assert outfit.top != "coat"
        assert not outfit.mask
        assert outfit.glasses == "none"
        assert outfit.headwear != "headscarf"
    assert len({outfit.top for outfit in infants}) > 4  # and not all the same


def test_an_outfit_by_number_needs_its_subject() -> None:
    with pytest.raises(ConfigError, match="number") as error:
        config(occupants={"driver": {"outfit": 1}})
    assert "subject" in (error.value.hint or "")
    assert config(occupants={"driver": {"subject": "S02", "outfit": 1}})


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ({"cap": True, "glasses": True}, {"headwear": "cap", "glasses": "clear"}),
        ({"cap": False, "glasses": False, "top": "jacket", "number": 0}, {"top": "jacket"}),
        ([{"cap": True}, {"glasses": True}], [{"headwear": "cap"}, {"glasses": "clear"}]),
    ],
)
def test_outfits_of_before_are_read(old: object, new: object) -> None:
    """As the version before wrote them into datasets; what is written today has no key that means nothing."""
    was, now = (SynthConfig.parse({"people": {"own": {"anna": {"outfit": outfit}}}}) for outfit in (old, new))
    assert was == now
    dumped = now.model_dump(mode="json")
    told = dumped["people"]["own"]["anna"]["outfit"]
    assert all("number" not in each for each in (told if isinstance(told, list) else [told]))
    assert SynthConfig.parse(dumped) == now


@pytest.mark.parametrize(
    ("outfit", "said"), [({"number": 2}, "number"), ({"cap": True, "headwear": "hat"}, "headwear: cap"), ({"cap": "red"}, "cap")]
)
def test_what_outfits_cannot_say_is_refused(outfit: dict[str, object], said: str) -> None:
    with pytest.raises(ConfigError) as error:
        SynthConfig.parse({"people": {"own": {"anna": {"outfit": outfit}}}})
    assert said in error.value.in_one_line()
    assert "fit, folds, number" not in error.value.in_one_line()


def test_a_frame_of_own_people_is_written_out_with_its_outfit() -> None:
    own = {"anna": {"outfit": [{"top": "shirt"}, {"top": "hoodie", "headwear": "hood"}]}}
    settings = SynthConfig.parse(FIRST | {"people": {"subjects": [], "own": own}})
    index, scene = next(
        (i, s)
        for i in range(20)
        if (s := SceneSampler(settings, SEED).sample(i, rng=frame_rng(SEED, i))).people[0].person.outfit.number
    )
    kept = SynthConfig.parse(without_defaults(exact_config(settings, SEED, index)))
    again = SceneSampler(kept, SEED).sample(index, rng=frame_rng(SEED, index))
    assert again.people[0].person.outfit == scene.people[0].person.outfit


def test_a_sequence_has_one_outfit_and_labels_say_it() -> None:
    settings = config(sequence={"frames": 3, "rate_hz": 10}).model_dump(mode="json")
    frames = list(cabinpose.generate(frames=6, seed=SEED, config=settings))
    worn = [tuple(frame["outfit"][0]) for frame in frames]
    assert len(set(worn[:3])) == len(set(worn[3:])) == 1


def test_a_kept_scene_keeps_the_outfit() -> None:
    """In every frame, not only in the one that it is of."""
    made = {index: SceneSampler(config(), SEED).sample(index, rng=frame_rng(SEED, index)) for index in range(5)}
    index, scene = next((i, s) for i, s in made.items() if s.people[0].person.outfit.number)
    kept = exact_config(config(), SEED, index)
    again = SceneSampler(kept, SEED)
    for other in (index, index + 1, index + 2):
        assert again.sample(other, rng=frame_rng(SEED, other)).people[0].person.outfit == scene.people[0].person.outfit
