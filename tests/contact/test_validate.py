"""Verdicts on collisions made by hand: one of each cause, the order of the tests, and what may touch."""

from __future__ import annotations

from collections import Counter

import numpy as np
import pytest
import trimesh
from capsule_people import StubCabin, StubSeat, capsule, person, surface
from exact_contact import exact_penetrations

from cabinpose.core.frames import Matrix, transform
from cabinpose.scene.cabin import Part
from cabinpose.scene.contact import BOTH_YIELD_M, FLESH_M, OUTSIDE
from cabinpose.synth import validate
from cabinpose.synth.validate import Rejection, Validator, Verdict, by_cause, most_common

FLOOR = Part("floor", surface(trimesh.creation.box((6, 6, 0.4)).apply_translation((0, 0, -0.2))))
RIM = Part("rim", surface(trimesh.creation.torus(0.185, 0.015, 96, 24)), group="wheel")
BACKREST = Part("backrest", surface(trimesh.creation.box((0.1, 0.5, 0.7))), group="seat:driver/back", give_m=0.05)
FAR = {"wheel": transform(translation=(9, 0, 1)), "seat:driver/back": transform(translation=(9, 2, 1))}


@pytest.fixture(scope="module")
def validator() -> Validator:
    return Validator(StubCabin((FLOOR, RIM, BACKREST)))


def _at(group: str, x: float, y: float, z: float) -> dict[str, Matrix]:
    return FAR | {group: transform(translation=(x, y, z))}


def test_a_free_stand_is_accepted(validator: Validator) -> None:
    verdict = validator.check([("driver", *person((0, 0, 0.05)))], FAR)
    assert verdict.ok
    assert verdict == Verdict()


def test_an_arm_through_the_torso_is_found(validator: Validator) -> None:
    through = person((0, 0, 0.05), lelbow=(0.1, 0.4, 1.3), lwrist=(0.0, 0.15, 1.25), lhand=(0.0, 0.07, 1.25))
    verdict = validator.check([("driver", *through)], FAR)
    assert (verdict.ok, verdict.cause) == (False, "self")
    assert str(verdict.rejection) == "driver: lforearm in torso"
    assert verdict.depth_m > 0.02


@pytest.mark.parametrize(("overlap", "ok"), [(0.013, True), (0.017, False)])
def test_a_hand_may_rest_on_the_thigh_as_deep_as_stated(validator: Validator, overlap: float, ok: bool) -> None:
    """The tip of the hand (30 mm) goes straight at the thigh (75 mm); 15 mm are allowed."""
    x = 0.105 - overlap
    hand = person((0, 0, 0.05), lknee=(0, 0.12, 0.5), lelbow=(0.45, 0.3, 1.1), lwrist=(0.25, 0.12, 0.7), lhand=(x, 0.12, 0.7))
    verdict = validator.check([("driver", *hand)], FAR)
    assert verdict.ok == ok
    if not ok:
        assert str(verdict.rejection) == "driver: lhand in lthigh"
        assert verdict.depth_m == pytest.approx(overlap, abs=0.001)


@pytest.mark.parametrize(("overlap", "ok"), [(BOTH_YIELD_M - 0.001, True), (BOTH_YIELD_M + 0.002, False)])
def test_people_may_touch_as_deep_as_both_yield(validator: Validator, overlap: float, ok: bool) -> None:
    """Two heads of 100 mm side by side, as far apart as 200 mm less the overlap."""
    reach = {"lelbow": (0.0, 0.25, 1.2), "lwrist": (0.0, 0.25, 1.0), "lhand": (0.0, 0.25, 0.95)}
    lean = {"head": (0, -0.4 - overlap / 2, 1.7), "neck": (0, -0.1, 1.5)}
    mirrored = {"head": (0, 0.4 + overlap / 2, 1.7), "neck": (0, 0.1, 1.5)}
    one, two = person((0, 0.5, 0.05), **lean, **_right(reach)), person((0, -0.5, 0.05), **mirrored, **reach)
    verdict = validator.check([("driver", *one), ("front_passenger", *two)], FAR)
    assert verdict.ok == ok
    if not ok:
        assert (verdict.cause, str(verdict.rejection)) == ("person", "front_passenger, driver: head in head")
        assert verdict.depth_m == pytest.approx(overlap, abs=0.001)


def _right(joints: dict[str, tuple[float, float, float]]) -> dict[str, tuple[float, float, float]]:
    return {"r" + name[1:]: (x, -y, z) for name, (x, y, z) in joints.items()}


def test_one_person_through_another_is_found(validator: Validator) -> None:
    verdict = validator.check([("driver", *person((0, 0, 0.05))), ("front_passenger", *person((0, 1.2, 0.05)))], FAR)
    assert (verdict.ok, verdict.cause) == (False, "person")


def test_the_rim_through_a_hand_and_through_a_forearm_is_found(validator: Validator) -> None:
    """The rim is thinner than a forearm: no vertex of the skin need be inside it."""
    body = person((0, 0, 0.05))
    through_hand = validator.check([("driver", *body)], _at("wheel", 0.185, 0.86, 1.5))
    assert (through_hand.cause, str(through_hand.rejection)) == ("car", "driver: lhand in rim")
    beside = validator.check([("driver", *body)], _at("wheel", 0.185 + 0.015 + 0.041, 0.66, 1.5))
    assert beside.ok
    for shift in np.linspace(0.0, 0.02, 5):
        verdict = validator.check([("driver", *body)], _at("wheel", 0.185, 0.66 + shift, 1.5))
        assert verdict.cause == "car"
        assert str(verdict.rejection).endswith("arm in rim")


def test_a_thin_rod_between_the_vertices_is_found() -> None:
    """A rod of 5 mm through a forearm, where a skin of 4 segments has no vertex near."""
    rod = capsule(np.array((-0.2, 0.67, 1.5)), np.array((0.2, 0.67, 1.5)), 0.005, (8, 8))
    finer = rod.subdivide().subdivide()
    validator = Validator(StubCabin((Part("lever", surface(finer)),)))
    assert validator.contact is not None
    body = person((0, 0, 0.05))
    assert validator.contact.at({}).deepest(body[1].skin, FLESH_M) is None
    verdict = validator.check([("driver", *body)], {})
    assert (verdict.cause, str(verdict.rejection)) == ("car", "driver: lforearm in lever")


@pytest.mark.parametrize(("depth", "ok"), [(0.057, True), (0.060, False)])
def test_the_backrest_gives_way_as_far_as_stated(validator: Validator, depth: float, ok: bool) -> None:
    """The thorax is a sphere of 150 mm; the backrest is 100 mm thick, so that no vertex is ever 58 mm inside it."""
    body = person((0, 0, 0.05))
    verdict = validator.check([("driver", *body)], _at("seat:driver/back", -0.15 - 0.05 + depth, 0.0, 1.35))
    assert verdict.ok == ok
    if not ok:
        assert (verdict.cause, str(verdict.rejection)) == ("car", "driver: torso in backrest")
        assert verdict.depth_m == pytest.approx(depth, abs=0.0015)


def test_an_arm_does_not_pass_through_foam_that_gives_way_on_both_sides(validator: Validator) -> None:
    """No point of a forearm of 40 mm is deeper than 50 mm in a backrest of 100 mm, but its bone is inside."""
    reached = person((0, 0, 0.05), lelbow=(0.25, 0.45, 1.45), lwrist=(0.55, 0.45, 1.45), lhand=(0.62, 0.45, 1.45))
    verdict = validator.check([("driver", *reached)], _at("seat:driver/back", 0.45, 0.6, 1.5))
    assert (verdict.ok, verdict.cause) == (False, "car")
    assert str(verdict.rejection) in ("driver: lforearm through backrest", "driver: lhand through backrest")


def test_outside_the_cabin_is_refused() -> None:
    pane = Part("window", surface(trimesh.creation.box((2.4, 0.004, 2.4)).apply_translation((0, 0.7, 1.2))))
    sides = [
        Part(n, surface(trimesh.creation.box(e).apply_translation(t)))
        for n, e, t in (
            ("right", (2.4, 0.02, 2.4), (0, -1.2, 1.2)), ("front", (0.02, 1.9, 2.4), (1.2, -0.25, 1.2)),
            ("rear", (0.02, 1.9, 2.4), (-1.2, -0.25, 1.2)), ("roof", (2.4, 1.9, 0.02), (0, -0.25, 2.4)),
            ("floor", (2.4, 1.9, 0.02), (0, -0.25, 0)),
        )
    ]  # fmt: skip
    validator = Validator(StubCabin((pane, *sides), seats={"driver": StubSeat((0, 0, 0.8))}))
    verdict = validator.check([("driver", *person((0, 0, 0.06)))], {})
    assert (verdict.ok, verdict.cause) == (False, "car")
    assert verdict.rejection is not None
    assert verdict.rejection.into == OUTSIDE


def test_the_first_test_that_fails_ends_the_judgement(validator: Validator, monkeypatch: pytest.MonkeyPatch) -> None:
    """A scene that fails all three ways: body, neighbours, car, and what comes later is not even asked."""
    asked: list[str] = []
    for name in ("self_contact", "person_contact"):
        original = getattr(validate, name)
        monkeypatch.setattr(validate, name, lambda *a, n=name, f=original: (asked.append(n), f(*a))[1])
    car = validate._against_car
    monkeypatch.setattr(validate, "_against_car", lambda *a: (asked.append("car"), car(*a))[1])
    through = {"lelbow": (0.1, 0.4, 1.3), "lwrist": (0.0, 0.15, 1.25), "lhand": (0.0, 0.07, 1.25)}
    sunk = (0, 0, -0.05)
    other = ("front_passenger", *person((0, 0.3, -0.05)))
    assert validator.check([("driver", *person(sunk, **through)), other], FAR).cause == "self"
    assert asked == ["self_contact"]
    asked.clear()
    assert validator.check([("driver", *person(sunk)), other], FAR).cause == "person"
    assert asked == ["self_contact", "self_contact", "person_contact"]
    asked.clear()
    assert validator.check([("driver", *person(sunk))], FAR).cause == "car"
    assert asked == ["self_contact", "car"]


def test_rejections_are_codes_that_speak() -> None:
    rejections = Counter(
        {
            Rejection("car", "driver", "lhand", "rim"): 2,
            Rejection("car", "driver", "lforearm", "cushion", bone=True): 1,
            Rejection("person", "driver", "head", "torso", "front_passenger"): 3,
            Rejection("reach", "driver", "rfoot", "seat rails"): 1,
            Rejection("reach", "driver", "rhand"): 1,
            Rejection("camera"): 1,
        }
    )
    assert [str(r) for r in rejections] == [
        "driver: lhand in rim",
        "driver: lforearm through cushion",
        "driver, front_passenger: head in torso",
        "driver: rfoot misses its place, held up by seat rails",
        "driver: rhand misses its place",
        "somebody is right before the camera",
    ]
    assert by_cause(rejections) == {"camera": 1, "car": 3, "person": 3, "reach": 2}
    assert most_common(rejections, 2) == "driver, front_passenger: head in torso (3); driver: lhand in rim (2)"


@pytest.mark.slow
def test_people_admitted_one_by_one_are_judged_like_the_whole_scene(validator: Validator) -> None:
    """Random scenes of three and a turned wheel: `admit` says what `check` says of all, to the last bit."""
    rng = np.random.default_rng(5)
    causes: Counter[str | None] = Counter()
    for _ in range(40):
        settings = FAR | {"wheel": transform(translation=(0.4, 0.5, 1.3))}
        angle = float(rng.uniform(0.1, 1.0))
        seated, held = validator.turned(validator.empty(settings), angle), []
        apart = rng.uniform(1.4, 1.8)
        for slot, y in (("driver", 0.0), ("front_passenger", apart), ("rear_left", -apart)):
            hand = np.array((rng.uniform(0.0, 0.5), rng.uniform(0.0, 0.6), 1.25))
            joints = {"lwrist": tuple(hand), "lhand": tuple(hand + (0.05, -0.05, 0.0))}
            occupant = (slot, *person((0, y, 0.05), **joints))
            verdict, after = validator.admit(seated, occupant)
            whole = validator.check([*held, occupant], settings, angle)
            assert (verdict.ok, verdict.cause, str(verdict.rejection)) == (whole.ok, whole.cause, str(whole.rejection))
            assert verdict.depth_m == whole.depth_m
            causes[verdict.cause] += 1
            if verdict.ok:
                held.append(occupant)
            else:
                assert after is seated
            seated = after
        assert [body.slot for body in seated.bodies] == [slot for slot, *_ in held]
    assert min(causes[cause] for cause in (None, "self", "person", "car")) >= 2, causes


def test_the_wheel_is_turned_before_anybody_sits() -> None:
    """A knob on the rim: the driver's hand is free of it at one angle of the wheel and not at another."""
    knob = trimesh.creation.box((0.04, 0.04, 0.04)).apply_translation((0.3, 0, 0))
    validator = Validator(StubCabin((Part("knob", surface(knob), group="wheel"),)))
    settings = {"wheel": transform(translation=(-0.3, 0.86, 1.5))}
    driver = ("driver", *person((0, 0, 0.05)))
    away = validator.empty(settings, np.pi / 2)
    alone, seated = validator.admit(away, driver)
    assert alone.ok
    refused, same = validator.admit(validator.turned(away, 0.0), driver)
    assert (refused.cause, str(refused.rejection)) == ("car", "driver: lhand in knob")
    assert same.bodies == ()
    assert validator.turned(seated, np.pi / 2) is seated
    with pytest.raises(ValueError, match="before people sit down"):
        validator.turned(seated, 0.0)


def test_without_a_cabin_only_bodies_are_judged() -> None:
    validator = Validator(None)
    assert validator.check([("driver", *person((0, 0, -3.0)))], {}).ok


@pytest.mark.slow
def test_the_exact_test_agrees_on_shaken_scenes(validator: Validator) -> None:
    """Two people and the wheel at random: no accepted scene is too deep, no refused scene is free, by trimesh."""
    rng = np.random.default_rng(11)
    verdicts = []
    for n in range(6):
        shift = rng.normal(0, 0.05, 3)
        joints = {"lwrist": tuple((0.2, 0.5, 1.3) + shift), "lhand": tuple((0.25, 0.45, 1.3) + shift)}
        one, two = person((0, 0, 0.05), **joints), person((0, 1.3 if n % 3 == 0 else 1.9, 0.05))
        settings = FAR | {"wheel": transform(translation=(0.25 + (1.0 if n % 3 == 1 else rng.uniform(0.1, 0.2)), 0.5, 1.3))}
        occupants = [("driver", *one), ("front_passenger", *two)]
        verdict = validator.check(occupants, settings)
        topology = validator._topology(*one)
        exact = exact_penetrations(StubCabin((FLOOR, RIM)), occupants, topology, settings)
        too_deep = {p.cause for p in exact if p.excess_m > 1e-6}
        assert verdict.ok == (not too_deep)
        assert verdict.ok or verdict.cause in too_deep
        verdicts.append(verdict.cause)
    assert {None, "person", "car"} <= set(verdicts)


def test_words_of_what_lies_behind_the_car() -> None:
    assert str(Rejection("car", "driver", "torso", OUTSIDE)) == "driver: torso reaches behind the car's surfaces"


def test_people_who_sit_too_deep_are_told_from_those_who_bump_into_things() -> None:
    torso, hand = Rejection("car", "driver", "torso", "seat"), Rejection("car", "driver", "lhand", "wheel")
    assert validate.sits_too_deep({torso: 2, hand: 1, Rejection("self"): 9})
    assert not validate.sits_too_deep({torso: 1, hand: 1})
    assert not validate.sits_too_deep({Rejection("self"): 9})
