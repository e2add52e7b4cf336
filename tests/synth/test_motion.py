"""Sequences: timing by closed forms, speeds by differences, bodies free at thrice the rate, the same bytes however made."""

from __future__ import annotations

import re
import warnings
from collections.abc import Callable, Mapping
from pathlib import Path
from types import MappingProxyType

import numpy as np
import pytest
from exact_contact import thing_penetrations
from scipy import ndimage
from scipy.spatial import cKDTree
from synth_scenes import fingerprint, small_config

from cabinpose.app.view.summary import summarise
from cabinpose.core.errors import ConfigError, SceneError
from cabinpose.core.frames import invert
from cabinpose.core.skeleton import CABINPOSE
from cabinpose.scene.body import DOFS, SEGMENTS
from cabinpose.scene.body.rig import BONE_INDEX, LOWER, UPPER
from cabinpose.scene.things import THINGS
from cabinpose.store import open_dataset, read_manifest
from cabinpose.synth import FrameMaker
from cabinpose.synth.config import Output, SynthConfig
from cabinpose.synth.generate import generate
from cabinpose.synth.motion.activities import activities_for
from cabinpose.synth.motion.film import EYES_LEAD_S
from cabinpose.synth.motion.handover import giving_palm, meeting_place, taking_palm
from cabinpose.synth.motion.minimum_jerk import FASTEST, PEAK, progress, progress_rate
from cabinpose.synth.motion.planner import CHECKS_PER_FRAME, WHEEL_LIMIT, Surroundings
from cabinpose.synth.motion.sequences import SequenceDraw
from cabinpose.synth.motion.track import CLOSING_S, WIDTH, Held, duration, way_through
from cabinpose.synth.posture.grasps import OPEN_HAND, Grasp, Hold, hold
from cabinpose.synth.posture.places import GIVE, TAKE
from cabinpose.synth.sample import SceneSampler
from cabinpose.synth.validate import Rejection, Validator, Verdict

RATE, FRAMES = 10.0, 36
TWO = {"driver": 1.0, "front_passenger": 1.0}


def _sampler(*, things: Mapping[str, object] = MappingProxyType({}), **sequence: object) -> SceneSampler:
    scene = {"occupancy": TWO, **things, "sequence": {"frames": FRAMES, "rate_hz": RATE} | sequence}
    return SceneSampler(small_config(**scene), 2)


@pytest.fixture(scope="module")
def film():
    """A planned sequence of a driver who steers and a passenger who drinks, before a booster."""
    things = {"in_hand": 1.0, "child_seats": {"rear_right": "booster"}}
    return _sampler(things=things, activities=["steer", "drink"])._films.film(0)


def test_a_movement_is_the_polynomial_of_least_jerk() -> None:
    """Its boundary conditions, its known peak, and less jerk than other polynomials with the same ends."""
    t = np.linspace(0.0, 1.0, 20001)
    s = progress(t)
    speed = np.gradient(s, t)
    assert s[[0, -1]].tolist() == [0.0, 1.0]
    assert speed.max() == pytest.approx(PEAK, abs=1e-6)
    assert progress_rate(t) == pytest.approx(speed, abs=2e-4)
    assert np.abs(np.gradient(speed, t)[[1, -2]]).max() < 0.01

    def jerk(polynomial: np.polynomial.Polynomial) -> float:
        square = polynomial.deriv(3) ** 2
        return float(square.integ()(1.0) - square.integ()(0.0))

    ours = np.polynomial.Polynomial((0, 0, 0, 10, -15, 6))
    assert ours(t) == pytest.approx(s, abs=1e-12)
    for change in (0.1, -0.1, 1.0):  # t^3 (1 - t)^3 leaves the ends as they are
        assert jerk(ours) < jerk(ours + change * np.polynomial.Polynomial((0, 1)) ** 3 * np.polynomial.Polynomial((1, -1)) ** 3)


def test_a_straight_way_takes_the_time_of_its_slowest_joint() -> None:
    states = np.zeros((2, WIDTH))
    elbow = next(i for i, dof in enumerate(DOFS) if dof.name == "lelbow.flexion")
    states[1, elbow] = 2.0
    seconds = duration(way_through(states), 1.0)
    assert PEAK * 2.0 / seconds == pytest.approx(0.15 * FASTEST[elbow], rel=1e-3)
    assert duration(way_through(states), 0.5) == pytest.approx(2.0 * seconds)


@pytest.mark.slow
def test_no_joint_is_faster_than_people_are(film) -> None:
    """Elbows and knees by the angle between their bones, heads by their turn, from poses at thrice the rate alone."""
    step = 1.0 / (CHECKS_PER_FRAME * RATE)
    people = [film.people(t) for t in np.arange(0.0, (FRAMES - 1) / RATE, step)]
    moved = 0.0
    for i in range(len(people[0])):
        joints = np.stack([p[i].posed.joints for p in people])
        for name, near, far, limit in (("elbow", "shoulder", "wrist", 1510.0), ("knee", "pelvis", "ankle", 440.0)):
            for side in "lr":
                one, two = (joints[:, CABINPOSE.index[side + e]] - joints[:, CABINPOSE.index[side + name]] for e in (near, far))
                cosine = (one * two).sum(1) / np.linalg.norm(one, axis=1) / np.linalg.norm(two, axis=1)
                speed = np.degrees(np.abs(np.diff(np.arccos(cosine)))) / step
                assert speed.max() < limit
                moved = max(moved, speed.max())
        q = np.stack([p[i].posed.q for p in people])
        assert (np.abs(np.diff(q, axis=0)) / step < FASTEST).all()
        assert ((q >= LOWER) & (q <= UPPER)).all()
    assert moved > 20.0  # somebody moves at all


def test_nobody_touches_anything_between_the_frames(film) -> None:
    """All bodies at once by the exact test, at thrice the rate; the same test refuses a body that is moved into the seat."""
    cast = film.cast
    for tick in range(CHECKS_PER_FRAME * (FRAMES - 1) + 1):
        t = tick / (CHECKS_PER_FRAME * RATE)
        bodies = [(p.slot, p.person, p.posed) for p in film.people(t)]
        verdict = cast.validator.check(bodies, cast.settings, film.wheel_angle(t))
        assert verdict.ok, (t, verdict)
    slot, person, posed = bodies[0]
    lower = posed.vehicle_from_root.copy()
    lower[2, 3] -= 0.15
    assert not cast.validator.check([(slot, person, person.pose(posed.q, lower))], cast.settings, 0.0).ok


def test_people_move_on_while_a_frame_is_exposed(film) -> None:
    """Where nothing moves, the bytes are those of a still exposure; else depth changes where people move, and no label does."""
    scene = {"occupancy": TWO, "sequence": {"frames": FRAMES, "rate_hz": RATE, "exposure_motion": True}}
    config = small_config(**scene).model_copy(update={"output": Output(noise=True)})
    sampler = SceneSampler(config, 1)
    sampler._films.film = lambda _: film
    moving, still = (FrameMaker(config, 1, sampler) for _ in range(2))
    still._sample_times = np.zeros(0)
    times = moving._sample_times
    assert len(times) == 4 * len(config.camera.sensor_model.frequencies_hz)
    span = float(times[-1] - times[0])
    speeds = np.array([film.moved_m(i / RATE - span / 2, i / RATE + span / 2) for i in range(FRAMES)]) / span
    slow, fast = int(speeds.argmin()), int(speeds.argmax())
    joints = np.stack([np.stack([p.posed.joints for p in film.people(fast / RATE + t)]) for t in times[[0, -1]]])
    assert 0.8 * np.linalg.norm(joints[1] - joints[0], axis=-1).max() < speeds[fast] * span < 0.1
    for index in (slow, fast):
        (a, seen), (b, _) = moving.make(index), still.make(index)
        exposures = sampler.exposed(index, seen, times)
        same = {name for name in a if np.array_equal(a[name], b[name], equal_nan=np.asarray(a[name]).dtype.kind == "f")}
        if index == slow:
            assert all(shown is seen for shown in exposures)
            assert same == a.keys()
            continue
        assert a.keys() - same == {"depth", "amplitude", "confidence", "noise"}
        assert 1 < len({id(shown) for shown in exposures}) <= len(times)
        clock = [shown.sync_ns - seen.sync_ns for shown in exposures]
        assert clock == sorted(clock)
        assert clock[0] == pytest.approx(-clock[-1], abs=1)
        # Far from what moves depth is the same, but for the light that the lens scatters everywhere.
        depths = np.stack([moving._view(shown).depth_m for shown in (exposures[0], exposures[-1])])
        near = ndimage.binary_dilation(np.abs(depths[1] - depths[0]) > 1e-6, iterations=3)
        away = ~near & np.isfinite(a["depth"]) & np.isfinite(b["depth"])
        assert away.sum() > 0.2 * away.size
        apart = np.abs(a["depth"] - b["depth"])[away]
        assert np.quantile(apart, 0.99) < 1e-4
        assert apart.max() < 1e-3  # a dark pixel
        assert np.nanmax(np.abs(a["depth"] - b["depth"])[near]) > 5e-3
        assert a["noise"].dtype == np.uint16
        np.testing.assert_array_equal(a["noise"] == 0, np.isnan(a["depth"]))


def test_depth_is_the_median_over_the_frames_before(film) -> None:
    """Of frames without the filter, whatever was made before in the thread; a sequence begins anew."""
    scene = {"occupancy": TWO, "sequence": {"frames": FRAMES, "rate_hz": RATE}}
    config = small_config(**scene)
    sensor = config.camera.sensor_model.model_copy(update={"temporal_median": 3})
    filtered = config.model_copy(update={"camera": config.camera.model_copy(update={"sensor": sensor})})
    sampler = SceneSampler(config, 1)
    sampler._films.film = lambda _: film
    plain, late = FrameMaker(config, 1, sampler), FrameMaker(filtered, 1, sampler)
    depths = {i: plain.make(i)[0]["depth"] for i in (0, 1, 2, 3, FRAMES)}
    for index, before in ((0, [0]), (3, [1, 2, 3]), (FRAMES, [FRAMES])):
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", RuntimeWarning)  # of pixels without any depth
            expected = np.nanmedian([depths[i] for i in before], axis=0)
        expected[np.isnan(depths[index])] = np.nan
        np.testing.assert_array_equal(late.make(index)[0]["depth"], expected)
        assert (np.nan_to_num(expected) != np.nan_to_num(depths[index])).any() == (index == 3)


def test_what_is_held_moves_with_the_hand_and_is_pressed_by_it(film) -> None:
    """Rigidly with its holder's palm, up and down; touched by trimesh, and not pierced; what stands on a seat stands still."""
    hold, raised = film.tracks["front_passenger"].hold, []
    assert "drink" in THINGS[hold.kind].held_at
    assert film.tracks["driver"].hold is None
    for t in (0.0, 1.3, 2.6):
        people = film.people(t)
        seat, held = film.things_with(people, t)
        assert (seat.thing.kind, seat.slot) == ("booster", "rear_right")
        np.testing.assert_array_equal(seat.vehicle_from_thing, film.cast.things[0].vehicle_from_thing)
        holder = next(p for p in people if p.slot == held.slot == "front_passenger")
        in_palm = invert(holder.posed.palms["lr"[hold.side]]) @ held.vehicle_from_thing
        np.testing.assert_allclose(in_palm, hold.placed(np.eye(4)), atol=1e-9)
        found = thing_penetrations([(holder.slot, holder.person, holder.posed)], (held,))
        assert any(p.cause == "thing" for p in found)
        assert max(p.excess_m for p in found) < 1e-6
        raised.append(held.vehicle_from_thing[2, 3])
    assert np.ptp(raised) > 0.04


def test_eyes_are_where_the_head_will_be(film) -> None:
    turned = 0.0
    for t in (0.4, 1.0, 2.2):
        for now, later in zip(film.people(t), film.people(t + EYES_LEAD_S), strict=True):
            head = later.posed.bones[BONE_INDEX["head"]][:3, :3]
            np.testing.assert_allclose(now.coming_head, head, atol=1e-9)
            turned = max(turned, np.abs(now.posed.bones[BONE_INDEX["head"]][:3, :3] - head).max())
    assert turned > 1e-3


@pytest.mark.slow
def test_a_neighbour_is_hit_by_who_has_one() -> None:
    """Only where somebody sits at the inboard hand; the hand comes to the skin of the other's arm."""
    film = _sampler(activities=["hit"])._films.film(0)
    seats, cabin = film.cast.cabin.seats, film.cast.cabin
    assert "hit" in activities_for(seats["driver"], cabin, taken=TWO)
    assert "hit" not in activities_for(seats["driver"], cabin, taken=["driver", "rear_left"])
    near = []
    for slot, track in film.tracks.items():
        for segment in (s for s in track.segments if s.activity == "hit"):
            people = {p.slot: p for p in film.people(segment.start_s + segment.lasts_s)}
            mine, other = people.pop(slot), *people.values()
            hands = np.isin(mine.person.skin_segment, [SEGMENTS.index(side + "hand") for side in "lr"])
            near.append(cKDTree(other.posed.skin).query(mine.posed.skin[hands])[0].min())
    assert min(near) < 0.02


def _free(film, time_s: float) -> Verdict:
    """Whether all bodies and things hold together at a time, put into the car one after the other."""
    people, judge = film.people(time_s), film.cast.validator
    seated = judge.empty(film.cast.settings, film.wheel_angle(time_s), film.cast.things)
    for p in people:
        verdict, seated = judge.admit(seated, (p.slot, p.person, p.posed))
        if not verdict.ok:
            return verdict
    for thing in film.things_with(people, time_s)[len(film.cast.things) :]:
        verdict, seated = judge.bring(seated, thing)
        if not verdict.ok:
            return verdict
    return Verdict()


def test_fingers_open_before_they_close_and_follow_the_grip_otherwise() -> None:
    grasp = Grasp(np.array((0.1, 0.5, 0.5, 0.6, 0.6)), np.eye(4))
    held = Held(Hold("bottle", 0, 1, grasp, TAKE), 2.0, 5.0)
    assert held.curl(0.6, 0.3) is None
    assert held.curl(6.4, 0.3) is None
    for time_s in (2.0, 3.0, 5.0):
        np.testing.assert_array_equal(held.curl(time_s, 0.3), np.repeat(grasp.curl, 3))
    for time_s in (2.0 - CLOSING_S - 0.5, 2.0 - CLOSING_S, 5.0 + CLOSING_S, 5.0 + CLOSING_S + 0.5):
        np.testing.assert_allclose(held.curl(time_s, 0.3), np.repeat(OPEN_HAND, 3), atol=1e-9)
    curls = np.stack([held.curl(t, 0.3) for t in np.linspace(0.71, 2.0, 200)])
    assert np.abs(np.diff(curls, axis=0)).max() / (1.29 / 199) < 10.0


def test_the_other_hand_comes_to_what_is_held_from_its_own_side(film) -> None:
    """Thumbs up, the thing upright between the two, one palm above the other."""
    people = {p.slot: p for p in film.people(0.0)}
    one, two = people["driver"], people["front_passenger"]
    side = 1 if one.posed.joints[CABINPOSE.index["hip"], 1] > two.posed.joints[CABINPOSE.index["hip"], 1] else 0
    held = hold(one.person, GIVE, "bottle", 0, side)
    rng = np.random.default_rng(0)
    place = meeting_place((one.person, two.person), (one.posed, two.posed), side, np.array((1.0, 0.0, 0.0)), rng=rng)
    palms = [giving_palm(held, one.posed, place)]
    thing = held.placed(palms[0])
    palms.append(taking_palm(two.person, two.posed, held, thing)[1])
    np.testing.assert_allclose(thing[:3, 2], (0.0, 0.0, 1.0), atol=1e-9)
    np.testing.assert_allclose(thing[:3, 3], place, atol=1e-9)
    for palm, thumb in zip(palms, (1.0 - 2.0 * side, 2.0 * side - 1.0), strict=True):
        np.testing.assert_allclose(thumb * palm[:3, 1], (0.0, 0.0, 1.0), atol=1e-9)
        assert (thing[:3, 3] - palm[:3, 3]) @ palm[:3, 2] > 0.02  # it is before the palm
    assert 0.085 < palms[1][2, 3] - palms[0][2, 3] < 0.15
    shoulders = [p.posed.joints[CABINPOSE.index["lr"[s] + "shoulder"]] for p, s in ((one, side), (two, 1 - side))]
    for person, shoulder in zip((one, two), shoulders, strict=True):
        arm = sum(person.person.segment_lengths[name] for name in ("upper_arm", "forearm"))
        assert 0.35 < np.linalg.norm(place - shoulder) / arm < 1.0


@pytest.mark.slow
@pytest.mark.parametrize(
    ("car", "seats", "seed"), [("suv", TWO, 1), ("hatchback", {"rear_left": 1.0, "rear_right": 1.0}, 0)], ids=["front", "rear"]
)
def test_a_bottle_changes_hands(car: str, seats: dict[str, float], seed: int) -> None:
    """It stays where it is as it changes hands, between two palms; all is free at thrice the rate, no joint is too fast."""
    sequence = {"frames": 60, "rate_hz": RATE, "activities": ["hand_over"]}
    film = SceneSampler(small_config(cars=[car], occupancy=seats, in_hand=1.0, sequence=sequence), seed)._films.film(0)
    change_s, taker = min((h.start_s, slot) for slot, track in film.tracks.items() for h in track.holds if h.start_s > 0.0)
    (giver,) = film.tracks.keys() - {taker}
    assert change_s < 5.9
    (before,), (after,) = (film.things_with(film.people(t), t) for t in (change_s - 1e-6, change_s))
    assert (before.slot, after.slot) == (giver, taker)
    corners = np.c_[np.array(np.meshgrid(*after.thing.box.T)).reshape(3, -1).T, np.ones(8)]
    moved = corners @ (after.vehicle_from_thing - before.vehicle_from_thing).T
    assert np.linalg.norm(moved, axis=1).max() < 0.001
    tracks = film.tracks[giver], film.tracks[taker]
    assert [t.activity(change_s) for t in tracks] == ["hand_over", "receive"]
    people = {p.slot: p for p in film.people(change_s)}
    side = tracks[0].holds[0].hold.side
    palms = [people[s].posed.palms["lr"[h]][:3, 3] for s, h in ((giver, side), (taker, 1 - side))]
    local = [invert(after.vehicle_from_thing) @ np.append(palm, 1.0) for palm in palms]
    height = after.thing.box[1, 2]
    for palm in local:
        assert np.hypot(*palm[:2]) < 0.06
        assert 0.0 < palm[2] < height
    assert abs(local[0][2] - local[1][2]) > 0.06
    ticks = np.arange(max(0, round((change_s - 1.5) * 30)), min(round((change_s + 2.0) * 30), 177)) / (CHECKS_PER_FRAME * RATE)
    for t in ticks:
        assert (verdict := _free(film, t)).ok, (t, verdict)
    for track in tracks:
        q = np.stack([track.at(t).q for t in ticks])
        assert (np.abs(np.diff(q, axis=0)) * CHECKS_PER_FRAME * RATE < FASTEST).all()
        assert ((q >= LOWER) & (q <= UPPER)).all()


def test_children_move_in_their_seats() -> None:
    """What children do, and nothing else; on the seat and in nothing, at thrice the rate; held by its harness."""
    scene = {"cars": ["suv"], "occupancy": {}, "occupants": {"rear_left": {}}, "child_seats": {"rear_left": "toddler"}}
    sequence = {"frames": 18, "rate_hz": RATE, "activities": ["lean_forward", "look_around", "phone_text"]}
    sampler = SceneSampler(small_config(**scene, sequence=sequence), 0)
    film = sampler._films.film(0)
    (track,) = film.tracks.values()
    assert {s.activity for s in track.segments} <= {"look_around", "phone_text"}
    for tick in range(CHECKS_PER_FRAME * 17 + 1):
        assert (verdict := _free(film, tick / (CHECKS_PER_FRAME * RATE))).ok, verdict
    bodies = [film.people(t)[0].posed for t in np.arange(0.0, 1.7, 0.1)]
    assert np.ptp([body.skin for body in bodies], axis=0).max() > 0.05  # a head that turns about itself moves no joint
    moved = np.stack([body.joints for body in bodies])
    assert np.linalg.norm(np.ptp(moved[:, CABINPOSE.index["hip"]], axis=0)) < 0.05
    (child,) = sampler.sample(5, rng=np.random.default_rng(0)).people
    assert (child.belt, child.child) == ("harness", True)


def test_hands_stay_on_the_wheel_that_turns(film) -> None:
    wheel, person, driver = film.cast.cabin.steering_wheel, film.cast.people["driver"], film.tracks["driver"]
    turned = 0.0
    for steered in (s for s in driver.segments if s.activity == "steer"):
        times = np.linspace(steered.start_s, steered.start_s + steered.lasts_s, 40)
        angles = np.array([film.wheel_angle(t) for t in times])
        for side in "lr":
            palms = np.stack([person.pose(p.q, p.root).palms[side][:3, 3] for p in map(driver.at, times)])
            local = (palms - wheel.vehicle_from_wheel[:3, 3]) @ wheel.vehicle_from_wheel[:3, :3]
            along = np.unwrap(np.arctan2(local[:, 1], local[:, 0]) - angles) * wheel.rim_radius_m
            if abs(along[-1] - along[0]) > 0.02:
                continue  # a new grip
            assert np.hypot(np.hypot(local[:, 0], local[:, 1]) - wheel.rim_radius_m, local[:, 2]).max() < 0.018
            assert np.ptp(along) < 0.004
            turned = max(turned, np.ptp(angles))
    assert turned > np.radians(3.0)


@pytest.mark.slow
def test_wheels_of_sequences_begin_no_farther_turned_than_they_are_steered() -> None:
    for seed in range(4):
        sampler = SceneSampler(small_config(occupancy={"driver": 1.0}, sequence={"frames": 2, "rate_hz": RATE}), seed)
        for number in range(3):
            assert abs(sampler._films.film(number).wheel_angle(0.0)) <= WHEEL_LIMIT


def test_frames_of_a_sequence_belong_together(tmp_path: Path) -> None:
    """People, car, camera and belts are kept; times go by the rate; the same bytes by one thread and two, parts cut anywhere."""
    config = small_config(belted=0.5, sequence={"frames": 4, "rate_hz": 20.0})  # three frames a part
    for name, workers in (("one", 1), ("two", 2)):
        generate(config, 9, tmp_path / name, seed=3, workers=workers)
    assert fingerprint(tmp_path / "one") == fingerprint(tmp_path / "two")
    dataset = open_dataset(tmp_path / "one").load()
    assert dataset["sequence"].values.tolist() == [0, 0, 0, 0, 1, 1, 1, 1, 2]
    assert dataset["sync_ns"].values.tolist() == [0, 50_000_000, 100_000_000, 150_000_000] * 2 + [0]
    for n in (0, 1):
        part = dataset.isel(frame=slice(4 * n, 4 * n + 4))
        for name in ("subject", "car", "pov", "vehicle_from_camera"):
            assert (part[name].values == part[name].values[:1]).all(), name
        steps = np.linalg.norm(np.diff(part["joints_3d"].values[:, 0], axis=0), axis=-1)
        assert 0.0 < steps.max() < 0.2
    belt = (dataset["labels"] == next(r["id"] for r in config_labels(dataset) if r["name"] == "seat_belt")).any(("y", "x"))
    assert np.ptp(belt.values[:4].astype(int)) == 0
    assert np.ptp(belt.values[4:8].astype(int)) == 0


def config_labels(dataset) -> list[dict[str, object]]:
    """The classes of a dataset's pixels."""
    attrs = dataset["labels"].attrs
    return [{"id": i, "name": n} for i, n in zip(attrs["flag_values"], attrs["flag_meanings"].split(), strict=True)]


def test_a_configuration_without_sequences_says_nothing_of_them() -> None:
    """So that `dataset.yaml` has the bytes that it had."""
    assert "sequence" not in small_config().model_dump(mode="json")["scene"]
    told = small_config(sequence={"frames": 4}).model_dump(mode="json")
    assert SynthConfig.parse(told).scene.sequence.frames == 4


def test_no_way_ends_with_its_cause(monkeypatch: pytest.MonkeyPatch) -> None:
    refused = Verdict(Rejection("car", "driver", "lhand", "roof"))
    monkeypatch.setattr(Surroundings, "verdict", lambda *_: refused)
    with pytest.raises(SceneError, match="sequence 0: no way without collision was found for everybody: driver: lhand in roof"):
        _sampler()._films.film(0)


@pytest.mark.parametrize(
    ("scene", "says"),
    [
        ({"sequence": {"activities": ["dance"]}}, "activity 'dance'"),
        ({"sequence": {"frames": 4}, "profile": {"kind": "gaussian"}}, "people in motion have no profile but mocap"),
        ({"sequence": {"frames": 4}, "factorial": {"poses": 2}}, "people in motion have no scene.factorial"),
        ({"sequence": {"frames": 1}}, "frames"),
        ({"sequence": {"activities": ["hand_over"]}}, "nobody has anything in the hand to hand over"),
        ({"sequence": {"activities": ["receive"]}}, "activity 'receive'"),
    ],
)
def test_what_has_no_meaning_is_refused(scene: dict[str, object], says: str) -> None:
    with pytest.raises(ConfigError, match=says):
        SynthConfig.parse({"scene": scene})


def test_a_recording_moves_somebody_in_its_own_time(real_data: Callable[[str], Path]) -> None:
    """Arms go as they were recorded where there is room, no joint is too fast, nothing is touched at thrice the rate."""
    profile = {"kind": "mocap", "path": str(real_data("mocap/xsens_upper_body.mvnx"))}
    sequence = {"frames": 18, "rate_hz": RATE}
    config = small_config(occupancy=TWO, sequence=sequence, occupants={"front_passenger": {"profile": profile}})
    film = SceneSampler(config, 1)._films.film(0)
    step = 1.0 / (CHECKS_PER_FRAME * RATE)
    times = np.arange(0.0, 17 / RATE, step)
    track, recorded = film.tracks["front_passenger"], config.scene.profile_of("front_passenger")
    assert {s.activity for s in track.segments} == {"mocap"}
    for t in times:
        bodies = [(p.slot, p.person, p.posed) for p in film.people(t)]
        assert film.cast.validator.check(bodies, film.cast.settings, film.wheel_angle(t)).ok
    q = np.stack([track.at(t).q for t in times])
    assert (np.abs(np.diff(q, axis=0)) / step < FASTEST).all()
    asked = np.stack([recorded.whole_body(round(t * 30)).q for t in times])
    arms = [i for i, dof in enumerate(DOFS) if dof.name[1:].startswith(("shoulder", "elbow"))]
    assert np.median(np.abs(q - asked)[:, arms]) < np.radians(4)
    elbow = next(i for i, dof in enumerate(DOFS) if dof.name == "lelbow.flexion")
    assert np.ptp(asked[:, elbow]) > np.radians(25)
    assert np.corrcoef(q[:, elbow], asked[:, elbow])[0, 1] > 0.95
    assert np.corrcoef(q[:-15, elbow], asked[15:, elbow])[0, 1] < 0.9  # half a second off the recording's time


def test_with_body_counts(film) -> None:
    """A person who sits nearly where another one does is refused by the bodies that were put in unjudged."""
    cast = film.cast
    (one, two) = film.people(0.0)
    judge: Validator = cast.validator
    aside = one.posed.vehicle_from_root.copy()
    aside[:3, 3] += 0.05
    beside = one.person.pose(one.posed.q, aside)
    seated = judge.with_body(judge.empty(cast.settings, film.wheel_angle(0.0)), (two.slot, one.person, beside))
    verdict, _ = judge.admit(seated, (one.slot, one.person, one.posed))
    assert verdict.cause == "person"


def test_the_acceptance_of_a_sequence_is_a_share_of_what_was_judged(tmp_path: Path) -> None:
    """More ways are judged here than poses and activities were drawn; the file has the number of these, and no share."""
    config = small_config(occupancy=TWO, in_hand=1.0, sequence={"frames": 3, "rate_hz": 4.0, "activities": ["reach_down"]})
    report = generate(config, 3, tmp_path, seed=39, workers=1)
    rejected = sum(report.rejections.values())
    assert 0 < rejected < report.proposals < report.judged
    assert report.acceptance == pytest.approx(1.0 - rejected / report.judged)
    dataset = open_dataset(tmp_path)
    assert (dataset.attrs["proposals"], sum(dataset.attrs["rejections"].values())) == (report.proposals, rejected)
    assert summarise(dataset, read_manifest(tmp_path), tmp_path).acceptance is None


def test_each_pose_and_way_is_judged_once(film) -> None:
    """What holds are the poses at first, the breath of each, and of each activity its goal and its way."""
    attempts, segments = film.attempts, sum(len(track.segments) for track in film.tracks.values())
    assert attempts.judged - attempts.rejections.total() >= 2 * len(film.tracks) + 2 * segments


_ARMS = [i for i, dof in enumerate(DOFS) if dof.name[1:].startswith(("shoulder", "elbow", "wrist"))]


def _edges(surface) -> np.ndarray:
    """Middles and corners of a surface's triangles, (N, 3) m."""
    corners = surface.vertices[surface.faces]
    return np.concatenate((corners.reshape(-1, 3), corners.mean(axis=1)))


def test_a_belt_hangs_follows_the_hand_and_is_worn() -> None:
    """Until it is plugged in no belt is worn; webbing runs from the guide to the fist and from there to the lap's anchor."""
    sequence = {"frames": 100, "rate_hz": RATE, "activities": ["buckle_up"]}
    scene = {"cars": ["suv"], "occupancy": {"front_passenger": 1.0}, "belted": 0.5, "sequence": sequence}
    sampler = SceneSampler(small_config(**scene), 3)
    film = sampler.plan_sequence(0)
    side, grasp_s, plug_s = film.tracks["front_passenger"].buckling
    seat, setting = film.cast.cabin.seats["front_passenger"], film.cast.settings["front_passenger"]
    anchors = seat.belt_anchors(setting)
    assert 0.3 < grasp_s < plug_s - 0.5
    assert plug_s < 9.8
    frames = range(0, 100, 4)
    for frame in frames:
        (person,) = sampler.sample(frame, rng=np.random.default_rng(0)).people
        time_s, belt = frame / RATE, _edges(person.surfaces[1])
        palm = person.posed.palms["lr"[side]][:3, 3]
        assert person.belt == ("none" if time_s < plug_s else "worn"), time_s
        for end in (anchors.upper, anchors.outer_lap):
            assert np.linalg.norm(belt - end, axis=1).min() < 0.01
        to_hand, to_buckle = (np.linalg.norm(belt - place, axis=1).min() for place in (palm, anchors.buckle))
        if grasp_s < time_s < plug_s - CLOSING_S:
            assert to_hand < 0.02, time_s
        if time_s < grasp_s:
            assert to_buckle > 0.2
        if time_s >= plug_s:
            assert to_buckle < 0.01
    drawn = [f / RATE for f in frames if grasp_s < f / RATE < plug_s - CLOSING_S]
    assert len(drawn) >= 2


def test_nobody_buckles_up_whose_belt_is_never_worn() -> None:
    sequence = {"frames": 20, "rate_hz": RATE, "activities": ["buckle_up"]}
    for given in ({"belted": 0.0}, {"occupants": {"front_passenger": {"belted": False}}}):
        film = SceneSampler(small_config(occupancy={"front_passenger": 1.0}, **given, sequence=sequence), 1).plan_sequence(0)
        assert film.tracks["front_passenger"].buckling is None


def test_who_eats_brings_food_to_the_mouth_and_back() -> None:
    """The upper end of what is held is at the face at a bite, and at the lap between two of them."""
    sequence = {"frames": 70, "rate_hz": RATE, "activities": ["eat"]}
    film = SceneSampler(small_config(occupancy={"front_passenger": 1.0}, in_hand=1.0, sequence=sequence), 1).plan_sequence(0)
    (track,) = film.tracks.values()
    assert "bite" in THINGS[track.hold.kind].held_at
    away = []
    for t in np.arange(0.0, 6.9, 0.1):
        (person,), (thing,) = (people := film.people(t)), film.things_with(people, t)
        top = thing.vehicle_from_thing @ (0.0, 0.0, thing.thing.box[1, 2], 1.0)
        head = person.posed.skin[person.person.skin_segment == SEGMENTS.index("head")]
        away.append(np.linalg.norm(head - top[:3], axis=1).min())
    assert min(away) < 0.02
    bites = np.flatnonzero(np.array(away) < 0.03)
    assert max(away) > 0.15
    assert np.diff(bites).max() > 5  # at least two, apart


@pytest.mark.slow
def test_hands_open_before_they_leave_the_wheel_and_close_once_they_are_there() -> None:
    """Fingers of a hand that leaves the rim are open before the arm moves, and no way swings beyond its poses."""
    states = np.zeros((3, WIDTH))
    states[1:, 0], states[2, 1] = 0.2, 1.0
    way = way_through(states)
    between = np.asarray(way(np.linspace(0.0, 1.0, 400)))
    assert between[:, :2].min() >= -1e-12
    assert between[:, 0].max() <= 0.2 + 1e-12
    assert np.abs(between[np.linspace(0.0, 1.0, 400) > way.x[1], 0] - 0.2).max() < 1e-9
    film = _sampler(activities=["look_over_shoulder"])._films.film(0)
    driver, left, opened = film.tracks["driver"], 0, np.repeat(OPEN_HAND, 3)
    for segment in driver.segments:
        knots = segment.way(segment.way.x)
        fingers = knots[:, -32:].reshape(-1, 2, 16)
        for side in (0, 1):
            if len(knots) > 2 and np.allclose(fingers[1, side, :15], opened) and not np.allclose(fingers[0, side, :15], opened):
                np.testing.assert_allclose(knots[1, _ARMS], knots[0, _ARMS], atol=1e-9)  # it has not moved yet
                left += 1
    assert left


@pytest.mark.slow
@pytest.mark.parametrize("car", ["city_car", "suv", "van", "coupe"])
def test_each_activity_gives_a_sequence(car: str) -> None:
    """Nothing that is asked for ends a run; who cannot do it does something else, by its name."""
    for activity in ("buckle_up", "eat", "drink", "phone_call", "reach_down", "turn_to_back_seat", "read", "sleep"):
        sequence = {"frames": 40, "rate_hz": RATE, "activities": [activity]}
        film = SceneSampler(small_config(cars=[car], occupancy=TWO, in_hand=1.0, sequence=sequence), 5).plan_sequence(0)
        assert set(film.tracks) == set(TWO)
        for tick in range(0, CHECKS_PER_FRAME * 39, 5):
            assert (verdict := _free(film, tick / (CHECKS_PER_FRAME * RATE))).ok, (activity, verdict)


def test_an_activity_for_which_no_seat_is_there_is_an_error(tmp_path: Path) -> None:
    config = small_config(occupancy={"rear_left": 1.0}, sequence={"frames": 4, "rate_hz": RATE, "activities": ["steer"]})
    with pytest.raises(ConfigError, match="steer makes no sense for anybody") as caught:
        generate(config, 4, tmp_path / "none", seed=1)
    assert "look_around" in caught.value.hint


@pytest.mark.parametrize(("recorded_hz", "taken_hz"), [(25.0, 30.0), (120.0, 30.0), (25.0, 10.0)])
def test_two_seconds_of_a_recording_last_two_seconds(
    recorded_hz: float, taken_hz: float, real_data: Callable[[str], Path], tmp_path: Path
) -> None:
    slow = tmp_path / "slow.bvh"
    text = real_data("mocap/cmu_131_01.bvh").read_text("utf-8")
    slow.write_text(re.sub(r"Frame Time: *\S+", f"Frame Time: {1.0 / recorded_hz}", text), encoding="utf-8")
    profile = {"kind": "mocap", "path": str(slow), "rate_hz": taken_hz}
    config = small_config(occupancy=TWO, sequence={"frames": 40, "rate_hz": RATE}, occupants={"driver": {"profile": profile}})
    draw = SequenceDraw(config.scene.sequence, 1, 0, 0)
    index = draw.recorded_index(config.scene, "driver", 2.0)
    assert config.scene.profile_of("driver")._frame(index) == pytest.approx(2.0 * recorded_hz, abs=1)
