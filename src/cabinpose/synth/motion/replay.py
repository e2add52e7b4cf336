"""A recorded motion in a seat: poses near the recorded ones that car, body and the others allow, in the recording's time.

The whole-body solver looks for a pose every `_KNOT_S`, from where the body is. Nobody moves faster than joints do, and where the
way on is not free the body goes a part of it, or waits. Between the poses lies a curve that does not overshoot (Fritsch and
Butland, "A method for constructing local monotone piecewise cubic interpolants", SIAM J. Sci. Stat. Comput. 5(2), 1984),
judged at thrice the frame rate as every motion is.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.interpolate import PchipInterpolator

from cabinpose.core import Floats
from cabinpose.synth.motion.activities import RECORDED
from cabinpose.synth.motion.minimum_jerk import FASTEST
from cabinpose.synth.motion.planner import Somebody, Surroundings
from cabinpose.synth.motion.track import FASTEST_STATE, Segment, Track
from cabinpose.synth.posture.sampling import settled
from cabinpose.synth.scene import Attempts
from cabinpose.synth.validate import Rejection

_KNOT_S = 0.1
_OF_FASTEST = 0.45  # of the fastest, from pose to pose: the curve between is at most twice as fast
_MOVES = 0.5  # of the poses, at the least, for which the body does not wait
_STEPS = (1.0, 0.3, 0.0)  # of the way to the recorded pose, one after the other, until it is free


def replay(who: Somebody, around: Surroundings, attempts: Attempts, *, action: str, lasts_s: float) -> bool:
    """Let somebody follow a recording for a time, from the pose that `around` has of it.

    Parameters
    ----------
    who
        Who moves; `draw` gives the recorded posture of a time.
    around
        The car and everybody; the track in it is what is planned.
    attempts
        Counts the pieces of the way that were judged and what was in the way, in place.
    action
        What is drawn; the recording stands in its place.
    lasts_s
        How long.

    Returns
    -------
    bool
        False where not even waiting is free, or there is more waiting than motion.
    """
    track = around.people[who.slot][1]
    knots, steps = [track.last], [0]
    given_up = dict[int, int]()  # by pose: how many of `_STEPS` were tried in vain
    free = 0  # pieces of the curve that are known to be; a piece hangs on the pose before it and the one after it too
    while _KNOT_S * free < lasts_s:
        while len(knots) < free + 3:
            here = len(knots)
            pose, step = _next(who, around, track, knots[-1], action, _KNOT_S * here, given_up.get(here, 0))
            knots.append(pose)
            steps.append(step)
        times_s = _KNOT_S * np.arange(len(knots))
        track.segments[:] = [Segment(0.0, times_s[-1], PchipInterpolator(times_s, np.stack(knots)), RECORDED, evenly=True)]
        ends_s = min(_KNOT_S * (free + 1), lasts_s)
        rejection = around.first_refused(who.slot, who.person, _KNOT_S * free, ends_s)
        attempts.judge(rejection)
        if rejection is None:
            free += 1
            continue
        given_up[free + 1] = steps[free + 1] + 1
        if given_up[free + 1] == len(_STEPS):
            return False
        del knots[free + 1 :], steps[free + 1 :]
        free = max(0, free - 1)
    if steps.count(len(_STEPS) - 1) > (1.0 - _MOVES) * len(steps):
        attempts.judge(Rejection("way", who.slot, RECORDED))
        return False
    return True


def _next(
    who: Somebody, around: Surroundings, track: Track, before: Floats, action: str, time_s: float, first: int
) -> tuple[Floats, int]:
    """(51,) the pose on the way to the recorded one of a time, and what of `_STEPS`, from `first` on, it is of that way."""
    pose = track.pose_of(before)
    drawn = who.draw(action, pose.wheel_angle, None, 0, time_s, None)
    placed = around.empty(pose.wheel_angle).placed
    asked = drawn.sitter.goals.posture - pose.q
    fast = _OF_FASTEST * _KNOT_S * FASTEST
    for tried in range(first, len(_STEPS) - 1):
        goals = drawn.sitter.goals._replace(posture=pose.q + np.clip(_STEPS[tried] * asked, -fast, fast))
        sitter = drawn.sitter._replace(goals=goals, q=pose.q.copy(), root=pose.root.copy())
        (found,) = settled([replace(drawn, sitter=sitter)], around.sitters(who.slot, time_s), placed)
        after = track.state_of(pose._replace(q=found.q, root=found.vehicle_from_root, fingers=found.fingers))
        step = np.abs(after - before)
        slower = np.divide(_OF_FASTEST * FASTEST_STATE * _KNOT_S, step, out=np.ones_like(step), where=step > 0.0).min()
        after = before + min(1.0, float(slower)) * (after - before)
        if around.verdict(who.slot, who.person, track.pose_of(after), time_s).rejection is None:
            return after, tried
    return before, len(_STEPS) - 1
