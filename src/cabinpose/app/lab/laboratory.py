"""A whole session in the virtual laboratory: calibration takes, a take of a person, the files that name them, and their truth."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from numpy.typing import NDArray

from cabinpose.align import Board
from cabinpose.app.lab.calibration import board_take, pendulum_take, write_board_take, write_pendulum_take
from cabinpose.app.lab.exercises import ARMS_OFF_DEG
from cabinpose.app.lab.plan import (
    BOARD,
    PAIR,
    PENDULUM,
    PERSON_TAKES,
    RIG,
    RIG_TAKES,
    SESSION,
    Plan,
    drive_take,
    exercise_take,
    head_take,
    pose_take,
)
from cabinpose.app.lab.rig import VirtualRig
from cabinpose.app.lab.suit import hand_offset
from cabinpose.app.lab.takes import (
    Actor,
    Truth,
    dress_up,
    truth_path,
    write_action_take,
    write_head_take,
    write_motion_take,
    write_pair_take,
    write_pose_take,
)
from cabinpose.core import ConfigError, Matrix, invert, make_folder, write_whole
from cabinpose.store import read_mapping, validated


def record_session(folder: Path, rig: VirtualRig, plan: Plan, report: Callable[[int], None] = lambda _: None) -> dict[str, Truth]:
    """Record a session into a new folder and return the truth of each subject's drive, which lies beside it as well.

    report: called with the number of `plan.steps` done. Same rig and plan, same recordings. Raises ConfigError where the folder
    is not empty, and for a car or a person that there is not.
    """
    if folder.exists() and any(folder.iterdir()):
        raise ConfigError(f"{folder} is not empty", hint="give a new or empty folder with --out")

    def drawn(*take: int) -> np.random.Generator:
        return np.random.Generator(np.random.Philox(np.random.SeedSequence((plan.seed, *take))))

    actors = []  # first of all: a car or a person that there is not leaves no half of a session
    for number, subject in enumerate(plan.subjects):
        worn: dict[str, Any] = {"suit": "suit2", "head": "head2"} if plan.together and number == 1 else {}
        actors.append(dress_up(plan.car, subject, **worn, rng=drawn(4, number)))
    make_folder(folder)
    _write_yaml(folder / RIG, rig.model_dump(mode="json", exclude_none=True))
    board = Board()
    shown = board_take(rig, views=plan.views, board=board, rng=drawn(0))
    write_board_take(folder / BOARD, rig, shown, frames_per_view=plan.frames_per_view, rng=drawn(1))
    report(1)
    write_pendulum_take(folder / PENDULUM, rig, pendulum_take(rig, duration_s=plan.pendulum_s, rng=drawn(2)), rng=drawn(3))
    report(RIG_TAKES)
    truths: dict[str, Truth] = {}
    for number, (subject, actor) in enumerate(zip(plan.subjects, actors, strict=True)):
        done = RIG_TAKES + PERSON_TAKES * number
        write_head_take(folder / head_take(subject), rig, actor, rng=drawn(5, number))
        report(done + 1)
        if plan.exercises:
            write_motion_take(folder / exercise_take(subject), rig, actor, rng=drawn(6, number))
        report(done + 2)
        write_pose_take(folder / pose_take(subject), rig, actor, rng=drawn(8, number))
        report(done + 3)
        path = folder / drive_take(subject)
        truths[subject] = write_action_take(path, rig, actor, plan.seconds, rate_hz=plan.rate_hz, rng=drawn(7, number))
        report(done + 4)
    if plan.together:
        pair = actors[0], actors[1].moved_to("front_passenger", rng=drawn(9))
        write_pair_take(folder / PAIR, rig, pair, plan.seconds, rate_hz=plan.rate_hz, rng=drawn(10))
        report(plan.steps)
    # the car stands where the first drive has it, and stays there
    write_session(folder, rig, board, actors, invert(next(iter(truths.values())).world_from_scene))
    return truths


def write_session(folder: Path, rig: VirtualRig, board: Board, actors: Sequence[Actor], vehicle_from_world: Matrix) -> None:
    """The session as a user would write it: what can be measured with a ruler is given, everything else is to be found."""

    def measured(p: NDArray[np.float64]) -> list[float]:
        return [round(float(x), 9) for x in p]

    session: dict[str, Any] = {
        "board": board.model_dump(mode="json"),
        "intrinsics": "checkerboard",
        "board_take": BOARD,
        "pendulum_take": PENDULUM,
        "subjects": {
            actor.code: {
                "take": head_take(actor.code),
                "head_offset_m": measured(actor.cap.object_from_head[:3, 3]),
                "hands_m": [measured(hand_offset(actor.person, side)) for side in "lr"],
                "suit": actor.suit,
                "head_object": actor.head,
                "pose_take": pose_take(actor.code),
                "pose_truth": "n-pose",
                "arms_off_deg": ARMS_OFF_DEG,
            }
            for actor in actors
        },
        "vehicle_from_world": vehicle_from_world.tolist(),
    }
    if rig.tracker is not None:
        session["names"] = {"tracker": "tracker"}
    _write_yaml(folder / SESSION, session)


def _write_yaml(path: Path, data: dict[str, Any]) -> None:
    write_whole(path, yaml.safe_dump(data, sort_keys=False, default_flow_style=None, width=120))


def load_rig(path: Path) -> VirtualRig:
    """The rig of a laboratory in a YAML file. Raises ConfigError."""
    hint = "`cabinpose lab` writes one as rig.yaml; docs/alignment.md lists its keys"
    return validated(VirtualRig, read_mapping(path, hint=hint), path, hint=hint)


def load_truth(folder: Path, subject: str, *, together: bool = False) -> Truth:
    """The truth of a subject's drive in a session, alone or together. Raises ConfigError where there is none."""
    path = truth_path(folder / PAIR, subject) if together else truth_path(folder / drive_take(subject))
    if not path.exists():
        raise ConfigError(f"{folder} holds no {path.name}", hint="`cabinpose lab` makes sessions of the laboratory")
    return Truth.load(path)
