"""Do the intervals of a suit's delay hold the truth? Head takes of the laboratory, as many as wanted, of what the delay needs.

`python tests/lab/head_takes.py 500` prints the share by length. A take has a suit put on anew, noise, jitter and a start within
the head's turns of their own; longer ones repeat the turns, as people do. Four lengths, in turn.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from cabinpose.align.clocks import host_from_device
from cabinpose.align.streams import seconds
from cabinpose.align.time import resolution_s, suit_to_optical, widened
from cabinpose.app.lab.motion import KeyedMotion, calibrate_head
from cabinpose.app.lab.optical import kept, measured_object, true_object
from cabinpose.app.lab.rig import VirtualRig
from cabinpose.app.lab.scene import world_from_vehicle
from cabinpose.app.lab.suit import as_worn, put_on, true_segments
from cabinpose.app.lab.takes import Actor, dress_up
from cabinpose.core.skeleton import MVN_SEGMENTS
from cabinpose.signals.delay import Delay, DelaySearch

LENGTHS_S = (6.0, 12.0, 30.0, 60.0)
RIG = VirtualRig()
TRUE_S = RIG.optical.latency_s - RIG.suit.latency_s
_MOTIONS = 6


class HeadTake(NamedTuple):
    """A take's length, s, and the delay that was found in it."""

    seconds: float
    delay: Delay

    @property
    def held(self) -> bool:
        low, high = self.delay.interval_s
        return low <= TRUE_S <= high


def head_takes(count: int, *, seed: int = 0) -> Iterator[HeadTake]:
    """`count` takes of `LENGTHS_S` in turn."""
    people = []
    for number in range(min(_MOTIONS, count)):
        rng = np.random.default_rng((seed, 0, number))
        actor = dress_up(rng=rng)
        people.append((actor, calibrate_head(actor.stage, rng=rng)))
    for number in range(count):
        length = LENGTHS_S[number % len(LENGTHS_S)]
        person = people[number // len(LENGTHS_S) % len(people)]
        yield HeadTake(length, _delay(*person, length, np.random.default_rng((seed, 1, number))))


def _delay(actor: Actor, motion: KeyedMotion, length: float, rng: np.random.Generator) -> Delay:
    begun, world = rng.uniform(0, motion.duration_s), world_from_vehicle(RIG, motion)
    stamps, turns, at = {}, {}, {}
    for source in ("suit", "optical"):
        clock = RIG.clock(source)
        true_ns = clock.ticks(getattr(RIG, source).rate_hz, 0.0, length)
        stamps[source] = clock.stamps(true_ns)
        time = (true_ns - RIG.start_ns) / 1e9
        segments = replace(true_segments(motion, (begun + time) % motion.duration_s).moved(world), time_s=time)
        if source == "suit":
            worn = as_worn(segments, RIG.suit_errors, put_on(rng=rng), actor.person, rng=rng)
            turns[source] = worn.orientation_wxyz[:, MVN_SEGMENTS.index("Head")]
        else:
            seen = kept(time, len(actor.cap.names), rng=rng)
            cap = true_object(segments.pose("Head"), actor.cap)
            turns[source] = measured_object(cap, actor.cap, seen, RIG.optical_noise_m, rng=rng)[1]
        on_host = host_from_device(stamps[source], clock.arrivals(true_ns, rng=rng), source)(stamps[source])
        at[source] = seconds(on_host, RIG.start_ns)
    found = suit_to_optical(at["suit"], turns["suit"], at["optical"], turns["optical"], DelaySearch(max_lag_s=0.5))
    return widened(found, resolution_s(stamps["suit"], stamps["optical"]))


def main() -> None:
    """Print the share of takes whose interval holds the truth, by length."""
    takes = list(head_takes(int(sys.argv[1]), seed=int(sys.argv[2]) if len(sys.argv) > 2 else 0))
    for length in (*LENGTHS_S, 0.0):
        some = [take for take in takes if take.seconds == length or not length]
        half = [500 * (high - low) for low, high in (take.delay.interval_s for take in some)]
        error = [1000 * abs(take.delay.offset_s - TRUE_S) for take in some]
        name = f"{length:2.0f} s" if length else "all"
        sys.stdout.write(
            f"{name}: {len(some)} takes, {100 * np.mean([t.held for t in some]):.1f} % hold, half interval "
            f"{np.median(half):.1f} ms ({min(half):.1f} to {max(half):.1f}), greatest error {max(error):.1f} ms, "
            f"{np.sum(np.array(half) > 10)} wider than 10 ms\n"
        )


if __name__ == "__main__":
    main()
