"""What lies about: closed, where it belongs, as often as stated, never near anybody; people are as they were without."""

from __future__ import annotations

import dataclasses
import math
from collections import Counter
from importlib import import_module
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import trimesh

from cabinpose.core import ConfigError
from cabinpose.scene import merge
from cabinpose.scene.cabin import Cabin, build_cabin
from cabinpose.scene.contact import ContactField
from cabinpose.scene.labels import LABEL_ID
from cabinpose.scene.things import CLUTTER, VARIANTS, make_thing
from cabinpose.synth import FrameMaker, SynthConfig, exact_config, preflight
from cabinpose.synth.clutter import CLEAR_M, PLACES_OF_CLUTTER, LyingAbout
from cabinpose.synth.sample import SceneSampler
from cabinpose.synth.scene import Scene
from cabinpose.synth.streams import clutter_rng, frame_rng
from cabinpose.synth.validate import Validator

PLAIN: dict[str, Any] = {
    "cars": ["sedan", "suv", "city_car"],
    "occupancy": {"driver": 0.9, "front_passenger": 0.5, "rear_left": 0.3},
}
THING = {"kind": "cup", "variant": 0, "slot": "driver", "where": "lap", "vehicle_from_thing": np.eye(4).tolist()}


def _empty(cabin: Cabin, contact: ContactField | None = None) -> Any:
    """A cast of nobody."""
    return SimpleNamespace(cabin=cabin, people={}, things=(), validator=Validator(None, contact))


def scenes(count: int, **scene: Any) -> list[Scene]:
    sampler = SceneSampler(SynthConfig.parse({"scene": PLAIN | scene}), 0)
    return [sampler.sample(i, rng=frame_rng(0, i)) for i in range(count)]


@pytest.mark.parametrize("kind", CLUTTER)
def test_each_kind_is_closed_and_of_a_likely_size(kind: str) -> None:
    for variant in range(VARIANTS):
        thing = make_thing(kind, variant)
        assert thing.label in LABEL_ID
        for part in thing.parts:
            mesh = trimesh.Trimesh(part.surface.vertices.astype(float), part.surface.faces, process=True)
            assert mesh.is_watertight, part.name
            assert mesh.volume > 0.0, part.name
        size = np.ptp(thing.box, axis=0).max()
        assert 0.07 < size < (0.85 if kind == "hung_jacket" else 0.32)


@pytest.fixture(scope="module")
def crowded() -> list[Scene]:
    return scenes(60, clutter=10.0)


@pytest.mark.slow
def test_nothing_that_lies_about_is_in_anybody_or_near(crowded: list[Scene]) -> None:
    """Exact, of the dressed surfaces: no triangle of either is nearer than a hand's breadth less what clothes take."""
    kinds: Counter[str] = Counter()
    for scene in crowded:
        about = [thing for thing in scene.things if thing.at == "car"]
        kinds.update(thing.thing.kind for thing in about)
        bodies = [(who, merge(list(who.surfaces[:1]))) for who in scene.people]
        skins = [trimesh.Trimesh(body.vertices.astype(float), body.faces, process=False) for _, body in bodies]
        for thing in about:
            mesh = thing.surface(0)
            solid = trimesh.Trimesh(mesh.vertices.astype(float), mesh.faces, process=False)
            low, high = solid.bounds
            for (who, body), skin in zip(bodies, skins, strict=True):
                near = (np.asarray(body.vertices > low - 0.03) & (body.vertices < high + 0.03)).all(axis=1)
                if near.any():  # clothes come nearer than skin does
                    points = body.vertices[near].astype(float)
                    assert trimesh.proximity.closest_point(solid, points)[1].min() > 0.002, (thing.thing.kind, who.slot)
                    assert not skin.contains(solid.vertices[::5]).any()
                gap = np.maximum(np.maximum(low - who.posed.skin, who.posed.skin - high), 0.0).max(axis=1)
                assert gap.min() >= CLEAR_M - 1e-6
    assert len(kinds) >= 10
    assert sum(kinds.values()) > 120


@pytest.mark.slow
def test_things_lie_on_what_carries_them(crowded: list[Scene]) -> None:
    checked = 0
    for scene in crowded[:25]:
        assert scene.cabin is not None
        parts = {part.name: part.surface for part in scene.cabin.parts}
        for thing in (t for t in scene.things if t.at == "car" and t.thing.kind in ("papers", "tissues", "ticket", "sunglasses")):
            underside = thing.surface(0).vertices.astype(float)
            carriers = [parts[n] for n in ("dashboard", "parcel shelf", "floor mats", "floor") if n in parts]
            carrier = merge(carriers)
            mesh = trimesh.Trimesh(carrier.vertices.astype(float), carrier.faces, process=False)
            assert trimesh.proximity.closest_point(mesh, underside)[1].min() < 0.006, thing.thing.kind
            assert trimesh.proximity.signed_distance(mesh, underside).max() < 0.012, thing.thing.kind
            checked += 1
    assert checked > 10


@pytest.mark.parametrize(
    "car", ["city_car", *(pytest.param(car, marks=pytest.mark.slow) for car in ("sedan", "suv", "hatchback", "coupe", "van"))]
)
def test_nothing_stands_through_panes_or_roof(car: str) -> None:
    """By rays of trimesh from where the driver's head is: no pane and no roof is between it and any corner of a thing's hull."""
    cabin = build_cabin(car)
    contact = ContactField(cabin)
    placed = contact.at({slot: seat.default for slot, seat in cabin.seats.items()})
    parts = {part.name: part.surface for part in cabin.parts}
    around = merge([parts[name] for name in parts if name.endswith((" glass", "windscreen", "backlight", "headlining"))])
    shell = trimesh.Trimesh(around.vertices.astype(float), around.faces, process=False)
    head = np.asarray(cabin.seats["driver"].design_h_point) + (0.0, 0.0, 0.5)
    cast: Any = _empty(cabin, contact)
    seated: Any = SimpleNamespace(placed=placed)
    lying, far, found = LyingAbout(50.0), np.full(3, 100.0), Counter[str]()
    for index in range(24):
        for thing in lying.about(cast, [], seated, far, rng=clutter_rng(5, index)):
            found[thing.thing.kind] += 1
            hull = trimesh.convex.convex_hull(thing.surface(0).vertices.astype(float)).vertices
            if thing.thing.kind == "phone_on_screen":  # its cup is at the pane
                hull = hull[trimesh.proximity.closest_point(shell, hull)[1] > 0.025]
            at, ray, _ = shell.ray.intersects_location(np.tile(head, (len(hull), 1)), hull - head, multiple_hits=False)
            beyond = np.linalg.norm(hull[ray] - head, axis=1) - np.linalg.norm(at - head, axis=1)
            assert not len(beyond) or beyond.max() < 1e-4, (thing.thing.kind, float(beyond.max()))
    assert len(found) >= 9
    hooks = 2 * 24
    assert found["hung_jacket"] >= hooks // 2 or car in ("coupe", "city_car")  # some are too long for small cars


def test_cups_stand_in_the_holders() -> None:
    """What stands in a holder is within its collar and deeper than its rim."""
    for car in ("sedan", "hatchback"):
        cabin, far, seen = build_cabin(car), np.full(3, 100.0), set[float]()
        bare: Any = SimpleNamespace(placed=None)
        rims = next(part.surface for part in cabin.parts if part.name == "cup holders").vertices.astype(float)
        cast: Any = _empty(cabin)
        for index in range(12):
            for thing in LyingAbout(50.0).about(cast, [], bare, far, rng=clutter_rng(5, index)):
                if thing.thing.kind not in ("cup", "bottle") or abs(thing.vehicle_from_thing[2, 2] - 1.0) > 1e-9:
                    continue
                body = thing.surface(0).vertices.astype(float)
                middle = thing.vehicle_from_thing[:2, 3]
                collar = np.hypot(*(rims[:, :2] - middle).T)
                at_rim = body[body[:, 2] < rims[:, 2].max()]
                assert np.hypot(*(at_rim[:, :2] - middle).T).max() < collar[collar > 0.03].min()
                assert body[:, 2].min() < rims[:, 2].max() - 0.02
                seen.add(round(float(middle[1]), 3))
        assert len(seen) == (2 if car == "sedan" else 1)


def test_shares_are_those_of_the_table() -> None:
    """Chi-square of how often each place has something, in an empty car: no one is in the way."""
    cabin, lying, frames = build_cabin("sedan"), LyingAbout(1.0), 1200
    cast: Any = _empty(cabin)
    seated: Any = SimpleNamespace(placed=None)
    far = np.full(3, 100.0)
    found: Counter[str] = Counter()
    for index in range(frames):
        found.update(thing.thing.kind for thing in lying.about(cast, [], seated, far, rng=clutter_rng(3, index)))
    cup = {name: place.share * place.kinds["cup"] / sum(place.kinds.values()) for name, place in PLACES_OF_CLUTTER.items()
           if "cup" in place.kinds}  # fmt: skip
    shares = {
        "cup": list(cup.values()),
        "ticket": [PLACES_OF_CLUTTER["under_screen"].share],
        "hung_jacket": [PLACES_OF_CLUTTER[name].share for name in ("hook_left", "hook_right")],
    }
    square = 0.0
    for kind, each in shares.items():
        expected, variance = frames * sum(each), frames * sum(p * (1.0 - p) for p in each)
        square += (found[kind] - expected) ** 2 / variance
    assert square < 16.27  # 0.1 % of three degrees of freedom
    twice = LyingAbout(2.0)
    more = sum(len(twice.about(cast, [], seated, far, rng=clutter_rng(3, index))) for index in range(300))
    less = sum(len(lying.about(cast, [], seated, far, rng=clutter_rng(3, index))) for index in range(300))
    assert 1.6 < more / less < 2.2


def test_people_are_the_same_with_and_without_and_frames_come_again() -> None:
    with_it, again, without = scenes(6, clutter=8.0), scenes(6, clutter=8.0), scenes(6, clutter=0.0)
    for one, same, bare in zip(with_it, again, without, strict=True):
        assert [(t.thing.kind, t.thing.variant) for t in one.things] == [(t.thing.kind, t.thing.variant) for t in same.things]
        assert all((a.vehicle_from_thing == b.vehicle_from_thing).all() for a, b in zip(one.things, same.things, strict=True))
        assert not bare.things
        assert (one.world_from_camera == bare.world_from_camera).all()
        for who, other in zip(one.people, bare.people, strict=True):
            assert (who.posed.skin == other.posed.skin).all()
            assert all((a.vertices == b.vertices).all() for a, b in zip(who.surfaces, other.surfaces, strict=True))


def test_frames_written_out_come_again_with_all_that_lies_about() -> None:
    """Frames until eight kinds lay about, as they are and as they are written out, to the last bit of depth and labels."""
    config, seen, drawn = SynthConfig.parse({"scene": PLAIN | {"clutter": 10.0}}), set[str](), set[int]()
    maker = FrameMaker(config, 0)
    for index in range(20):
        frame, scene = maker.make(index)
        about = {t.thing.kind for t in scene.things if t.at == "car"}
        if about <= seen:
            continue
        seen |= about
        same, shown = FrameMaker(exact_config(config, 0, index), 0, pictures=False).make(index)
        assert [t.thing.kind for t in shown.things] == [t.thing.kind for t in scene.things]
        assert (same["depth_clean"] == frame["depth_clean"]).all()
        assert (same["labels"] == frame["labels"]).all()
        drawn |= {LABEL_ID[t.thing.label] for t in scene.things} & set(np.unique(frame["labels"]).tolist())
        assert (frame["instance"][frame["labels"] >= LABEL_ID["infant_seat"]] == 0).all()
        if len(seen) >= 8:
            break
    assert len(seen) >= 8
    assert len(drawn) >= 2  # most is behind people


@pytest.mark.parametrize(
    ("kind", "where", "slot"),
    [("keys", "lap", "driver"), ("hung_jacket", "seat", "rear_left"), ("blanket", "car", "")],
)
def test_what_lies_about_is_on_no_lap_and_cloth_does_not_lie_about(kind: str, where: str, slot: str) -> None:
    thing = THING | {"kind": kind, "slot": slot, "where": where}
    with pytest.raises(ConfigError, match=kind) as refused:
        SynthConfig.parse({"scene": {"things": [thing]}})
    assert "where: " in (refused.value.hint or "")
    thing |= {"where": "lap", "slot": "driver"} if where == "car" else {"where": "car", "slot": ""}
    assert SynthConfig.parse({"scene": {"things": [thing]}}).scene.brings_things


def test_none_lies_about_in_sequences_and_where_nothing_is_asked_for() -> None:
    assert not SynthConfig.parse({"scene": {"sequence": {"frames": 2}}}).scene.lies_about
    assert not SynthConfig.parse({"scene": {"clutter": 0}}).scene.brings_things
    assert SynthConfig.parse({}).scene.lies_about
    assert math.isclose(sum(place.share for place in PLACES_OF_CLUTTER.values()), 0.95)


@pytest.mark.parametrize("beside", [{"sequence": {"frames": 2}}, {"things": [THING]}])
def test_clutter_that_is_asked_for_is_there_or_refused(beside: dict[str, Any]) -> None:
    with pytest.raises(ConfigError, match=f"clutter is 3.*{next(iter(beside))}"):
        SynthConfig.parse({"scene": {"clutter": 3} | beside})
    for clutter in (0, 1):  # the latter is what configurations that are written out say
        assert not SynthConfig.parse({"scene": {"clutter": clutter} | beside}).scene.lies_about


def test_cars_without_places_have_nothing_there(monkeypatch: pytest.MonkeyPatch) -> None:
    """Own meshes: whatever parts and reach targets they lack, nothing fails; of one without a dashboard it is said."""
    whole, far = build_cabin("sedan"), np.full(3, 100.0)
    seated: Any = SimpleNamespace(placed=None)
    found = {}
    for name in ("whole", "dashboard", "floor"):
        parts = tuple(part for part in whole.parts if name in ("whole", part.name))
        cabin = whole if name == "whole" else dataclasses.replace(whole, parts=parts, reach_targets={})
        cast: Any = _empty(cabin)
        lying = LyingAbout(10.0)
        found[name] = {t.thing.kind for i in range(40) for t in lying.about(cast, [], seated, far, rng=clutter_rng(3, i))}
    assert len(found["whole"]) >= 10
    assert found["dashboard"] == {"ticket"}
    assert not found["floor"]
    bare = dataclasses.replace(whole, parts=tuple(part for part in whole.parts if part.name != "dashboard"))
    monkeypatch.setattr(import_module("cabinpose.synth.preflight"), "open_cabin", lambda *_: bare)
    changed = {"preset": "sedan", "name": "own", "w3_mm": 1500}
    with pytest.warns(UserWarning, match="nothing lies about, as no part of it is called dashboard"):
        preflight(SynthConfig.parse({"scene": {"cars": [changed], "clutter": 1.0}}), frames=1)
