"""The motion of one person: poses, ways between them, and the breathing on top.

A state is a row of 83 numbers: the degrees of freedom (rad), the pelvis' place (m) and its turn since the start (rotation vector,
rad), the angle of the wheel that the person holds (rad), and the fingers of both hands, as `Person.pose` takes them.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from cabinpose.core import Floats, Matrix, rotation_vector, transform
from cabinpose.core import reproducible as rp
from cabinpose.scene.body import DOF_INDEX, DOFS, LOWER, UPPER, Person, PosedBody, every_finger
from cabinpose.scene.things import PlacedThing
from cabinpose.synth.motion.minimum_jerk import FASTEST, FASTEST_GRIP, progress, progress_rate
from cabinpose.synth.posture.grasps import OPEN_HAND, Hold
from cabinpose.synth.scene import Tongue

if TYPE_CHECKING:
    from scipy.interpolate import PPoly

_Q = len(DOFS)
ROOT, WHEEL = slice(_Q, _Q + 6), _Q + 6
_HANDS = 2, 16  # hands, numbers of each
FINGERS = slice(_Q + 7, _Q + 7 + _HANDS[0] * _HANDS[1])
WIDTH = FINGERS.stop
_COMFORT = 0.15  # of the fastest, at the peak of an unhurried movement
_FASTEST_ROOT = np.concatenate((np.full(3, 1.5), np.full(3, np.radians(280.0))))  # m/s and rad/s, with the trunk
_FASTEST_FINGERS = 2.0 * FASTEST_GRIP  # from open to fist, 1/s: unhurried ones take half a second (assumed)
_FASTEST_WHEEL = 2.0 * np.pi  # rad/s; the arms that hold it have limits of their own
FASTEST_STATE = np.concatenate((FASTEST, _FASTEST_ROOT, [_FASTEST_WHEEL], np.full(_HANDS[0] * _HANDS[1], _FASTEST_FINGERS)))
_SHORTEST_S = 0.35
CLOSING_S, _OPEN_S = 0.25, 0.8  # in which fingers open, and close around something; for which they stay open before and after
_GRIPS = [DOF_INDEX[side + "hand.grip"] for side in "lr"]
_IN_FIST_M = 0.012  # of webbing from the palm's origin
_LEAST_GRIP = 0.01  # with which fingers can still be posed one by one
_CURL = -0.4, 1.0  # of fingers, from wide open to a fist
_LEAST_APART = 0.1  # of the longest piece of a way
_DENSE = np.linspace(0.0, 1.0, 61)


class Pose(NamedTuple):
    """Where somebody is: q (D,) rad, root `vehicle_from_root` (4, 4), wheel_angle (rad).

    fingers: (2, 16) or fewer as `Person.pose` takes them, None where all follow the grip.
    """

    q: Floats
    root: Matrix
    wheel_angle: float
    fingers: Floats | None = None


def way_through(states: Floats) -> PPoly:
    """The way 0..1 through states (K, 83), without overshoot; each piece is as long as its slowest joint takes.

    A spline that swings beyond its points would press a hand that is about to let go into what it holds.
    """
    from scipy.interpolate import PchipInterpolator  # noqa: PLC0415 - loaded where people move

    apart = (np.abs(np.diff(states, axis=0)) / FASTEST_STATE).max(axis=1)
    shares = np.concatenate(([0.0], np.cumsum(np.maximum(apart, _LEAST_APART * apart.max() + 1e-9))))
    return PchipInterpolator(shares / shares[-1], states)


def duration(way: PPoly, tempo: float) -> float:
    """Seconds that somebody of this tempo (1: average) takes for a way, at `_COMFORT` of the fastest at the most."""
    rate = np.abs(way(progress(_DENSE), nu=1)) * progress_rate(_DENSE)[:, None]  # of a second's movement
    return max(_SHORTEST_S, float((rate.max(axis=0) / (_COMFORT * FASTEST_STATE)).max()) / tempo)


class Segment(NamedTuple):
    """A movement from `start_s`, `lasts_s` long, along a way, and what it is for.

    evenly: the way goes by the seconds since the start, and not with minimum jerk by its share.
    """

    start_s: float
    lasts_s: float
    way: PPoly
    activity: str
    evenly: bool = False

    @property
    def last(self) -> Floats:
        """(83,) where it ends."""
        return np.asarray(self.way(self.lasts_s if self.evenly else 1.0))

    def states(self, times_s: Floats) -> Floats:
        """(N, 83) states at times (N,) s from its start on."""
        since_s = times_s - self.start_s
        return np.asarray(self.way(np.clip(since_s, 0.0, self.lasts_s) if self.evenly else progress(since_s / self.lasts_s)))


class Idle(NamedTuple):
    """What a body does without wanting to: breaths (Hz, rad of the thorax), and a head that sways (Hz, rad); phases in rad."""

    breath_hz: float
    breath: float
    sway_hz: float
    sway: float
    phases: tuple[float, float, float]

    @staticmethod
    def drawn(*, rng: np.random.Generator) -> Idle:
        """12 to 20 breaths a minute, as adults at rest."""
        phases = tuple(float(v) for v in rng.uniform(0.0, 2.0 * np.pi, 3))
        breath = np.radians(rng.uniform(0.2, 0.5))
        sway = float(np.radians(0.6))
        return Idle(rng.uniform(0.2, 0.33), float(breath), rng.uniform(0.15, 0.3), sway, (phases[0], phases[1], phases[2]))

    def added(self, times_s: Floats, share: float) -> Floats:
        """(N, 83) what it adds to a state at times (N,); `share` of it all. The upper arms and the head stay level."""
        result = np.zeros((len(times_s), WIDTH))
        breath = share * self.breath * rp.sin(2.0 * np.pi * self.breath_hz * times_s + self.phases[0])
        result[:, DOF_INDEX["thorax.flexion"]] = breath
        result[:, DOF_INDEX["neck.flexion"]] = -breath
        for side in "lr":
            result[:, DOF_INDEX[side + "shoulder.flexion"]] = breath
        for name, phase in (("neck.rotation", self.phases[1]), ("neck.lateral", self.phases[2])):
            result[:, DOF_INDEX[name]] += share * self.sway * rp.sin(2.0 * np.pi * self.sway_hz * times_s + phase)
        return result


class Held(NamedTuple):
    """What is in a hand from one time to another, s."""

    hold: Hold
    start_s: float = -math.inf
    end_s: float = math.inf

    def curl(self, time_s: float, free: Floats) -> Floats | None:
        """(15,) curl of the phalanges, None where it is as without it, `free` (15,): they open before they close, and later."""
        away_s = max(self.start_s - time_s, time_s - self.end_s, 0.0)
        if away_s >= 2.0 * CLOSING_S + _OPEN_S:
            return None
        share = np.array([2.0 * CLOSING_S + _OPEN_S - away_s, CLOSING_S - away_s]) / CLOSING_S
        opened, closed = progress(share).tolist()
        grasp, opening = np.repeat((self.hold.grasp.curl, OPEN_HAND), 3, axis=1)
        return closed * grasp + (1.0 - closed) * (opened * opening + (1.0 - opened) * free)


class Buckling(NamedTuple):
    """When a hand (0 left, 1 right) takes the tongue of the belt, and when it is plugged in, s."""

    side: int
    grasp_s: float
    plug_s: float


class Track:
    """One person's motion; see the module. It begins at a pose that is held until the first segment.

    holds: what is in a hand, one after the other · buckling: of who buckles up, which nobody does twice.
    """

    def __init__(self, first: Pose, activity: str, idle: Idle, idle_share: float, hold: Hold | None = None) -> None:
        self.idle, self.idle_share = idle, idle_share
        self.holds = [] if hold is None else [Held(hold)]
        self.buckling: Buckling | None = None
        self.segments: list[Segment] = []
        self._rotation = first.root[:3, :3]
        self._activity = activity
        self._first = self.state_of(first)

    @property
    def hold(self) -> Hold | None:
        """What is in a hand at the end."""
        return self.holds[-1].hold if self.holds and self.holds[-1].end_s == math.inf else None

    @property
    def last(self) -> Floats:
        """(83,) the state at which the last segment ends."""
        return self.segments[-1].last if self.segments else self._first

    def state_of(self, pose: Pose) -> Floats:
        """(83,) the state of a pose."""
        turned = _rotation_log(rp.matmul(self._rotation.T, pose.root[:3, :3]))
        fingers = every_finger(pose.q, pose.fingers).reshape(-1)
        return np.concatenate((pose.q, pose.root[:3, 3], turned, [pose.wheel_angle], fingers))

    def pose_of(self, state: Floats) -> Pose:
        """The pose of a state (83,), within the joints' limits."""
        root = transform(rp.matmul(self._rotation, rotation_vector(state[ROOT][3:])), state[ROOT][:3])
        q = np.clip(state[:_Q], LOWER, UPPER)
        q[_GRIPS] = np.maximum(q[_GRIPS], _LEAST_GRIP)
        return Pose(q, root, float(state[WHEEL]), np.clip(state[FINGERS].reshape(_HANDS), *_CURL))

    def states(self, times_s: Floats) -> Floats:
        """(N, 83) states at times (N,) s, breathing included."""
        result = np.tile(self._first, (len(times_s), 1))
        for segment in self.segments:
            since = times_s >= segment.start_s
            result[since] = segment.states(times_s[since])
        return result + self.idle.added(times_s, self.idle_share)

    def at(self, time_s: float) -> Pose:
        """The pose at a time."""
        return self.pose_of(self.states(np.array([time_s]))[0])

    def body(self, person: Person, pose: Pose, time_s: float) -> PosedBody:
        """The person in a pose at a time, with fingers around what the hand holds."""
        fingers = every_finger(pose.q, pose.fingers)
        for held in self.holds:
            side = held.hold.side
            curl = held.curl(time_s, fingers[side, :15])
            if curl is not None:
                fingers[side] = *curl, np.nan  # grasps are found with fingers that close up as they curl
        return person.pose(pose.q, pose.root, fingers)

    def held(self, slot: str, body: PosedBody, time_s: float) -> tuple[PlacedThing, ...]:
        """What somebody in a seat and a pose holds at a time."""
        return tuple(held.hold.thing(slot, body) for held in self.holds if held.start_s <= time_s < held.end_s)

    def tongue(self, body: PosedBody, time_s: float, ends: tuple[Floats, Floats]) -> Tongue | None:
        """The tongue of the belt at a time, of a body as it is then; None for who does not buckle up.

        ends: (3,) m where it hangs and where it is plugged in. It comes to the hand that is there, and leaves it at the buckle.
        """
        if self.buckling is None:
            return None
        side, grasp_s, plug_s = self.buckling
        if time_s >= plug_s:
            return Tongue(ends[1], "plugged")
        palm = body.palms["lr"[side]]
        hand = palm[:3, 3] + _IN_FIST_M * palm[:3, 2]
        come, gone = progress(np.array([time_s - grasp_s, time_s - plug_s]) / CLOSING_S + 1.0).tolist()
        held = (1.0 - gone) * hand + gone * ends[1]
        return Tongue((1.0 - come) * ends[0] + come * held, "loose" if time_s < grasp_s else "drawn")

    def activity(self, time_s: float) -> str:
        """What is being done at a time."""
        return next((s.activity for s in reversed(self.segments) if time_s >= s.start_s), self._activity)


def _rotation_log(rotation: Floats) -> Floats:
    """(3,) the rotation vector of a matrix; of turns well below half a one."""
    axis = 0.5 * np.array([rotation[2, 1] - rotation[1, 2], rotation[0, 2] - rotation[2, 0], rotation[1, 0] - rotation[0, 1]])
    sine = rp.norm(axis)
    angle = float(rp.arctan2(sine, 0.5 * (np.trace(rotation) - 1.0)))
    return axis * (angle / sine if sine > 1e-12 else 1.0)
