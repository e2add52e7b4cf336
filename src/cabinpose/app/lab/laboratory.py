"""A whole session in the virtual laboratory: calibration takes, a take of a person, the files that name them, and their truth."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import yaml
from pydantic import BaseModel, ConfigDict, Field

from cabinpose.align.board import Board
from cabinpose.app.lab.calibration import board_take, pendulum_take, write_board_take, write_pendulum_take
from cabinpose.app.lab.rig import Rig
from cabinpose.app.lab.takes import CODE, Truth, dress_up, truth_path, write_action_take, write_head_take, write_motion_take
from cabinpose.core.errors import ConfigError
from cabinpose.core.frames import invert
from cabinpose.store.yaml_file import read_mapping, validated

SESSION, RIG = "session.yaml", "rig.yaml"
BOARD, PENDULUM, HEAD, ACTION, EXERCISES = "board.mcap", "pendulum.mcap", "head.mcap", "take.mcap", "exercises.mcap"
STEPS = 5  # takes of a session, and the files that name them


class Plan(BaseModel):
    """What is recorded in the laboratory."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    views: int = Field(50, ge=6, description="poses of the board")
    frames_per_view: int = Field(3, ge=1, description="of the camera, averaged, in each")
    pendulum_s: float = Field(25.0, gt=5, description="length of the pendulum take")
    seconds: float = Field(20.0, gt=1, description="length of the take of the driver")
    rate_hz: float | None = Field(None, gt=0, description="frames per second in it; left out: the rig's")
    exercises: bool = Field(True, description="movements in each anatomical plane outside the car as well")
    car: str = Field("sedan", description="a preset car")
    subject: str = Field("S01", description="one of the package's people")
    seed: int = Field(0, ge=0, description="of everything that is drawn")


def record_session(folder: Path, rig: Rig, plan: Plan, report: Callable[[int], None] = lambda _: None) -> Truth:
    """Record a session into a new folder and return the truth of the driver's take, which lies beside it as well.

    report: called with the number of `STEPS` done. Same rig and plan, same recordings. Raises ConfigError where the folder
    is not empty.
    """
    if folder.exists() and any(folder.iterdir()):
        raise ConfigError(f"{folder} is not empty", hint="give a new or empty folder with --out")
    folder.mkdir(parents=True, exist_ok=True)

    def drawn(take: int) -> np.random.Generator:
        return np.random.Generator(np.random.Philox(key=(plan.seed, take)))

    (folder / RIG).write_text(yaml.safe_dump(rig.model_dump(mode="json"), sort_keys=False, default_flow_style=None, width=120))
    board = Board()
    shown = board_take(rig, views=plan.views, board=board, rng=drawn(0))
    write_board_take(folder / BOARD, rig, shown, frames_per_view=plan.frames_per_view, rng=drawn(1))
    report(1)
    write_pendulum_take(folder / PENDULUM, rig, pendulum_take(rig, duration_s=plan.pendulum_s, rng=drawn(2)), rng=drawn(3))
    report(2)
    actor = dress_up(plan.car, plan.subject, rng=drawn(4))
    write_head_take(folder / HEAD, rig, actor, rng=drawn(5))
    report(3)
    if plan.exercises:
        write_motion_take(folder / EXERCISES, rig, actor, rng=drawn(6))
    report(4)
    truth = write_action_take(folder / ACTION, rig, actor, plan.seconds, rate_hz=plan.rate_hz, rng=drawn(7))
    _write_session(folder, board, truth)
    report(5)
    return truth


def _write_session(folder: Path, board: Board, truth: Truth) -> None:
    """The session as a user would write it: what can be measured with a ruler is given, everything else is to be found."""
    session = {
        "board": board.model_dump(mode="json"),
        "intrinsics": "checkerboard",
        "board_take": BOARD,
        "pendulum_take": PENDULUM,
        "subjects": {
            CODE: {
                "take": HEAD,
                "head_offset_m": [round(float(x), 9) for x in truth.object_from_head[:3, 3]],
                "hands_m": [[round(float(x), 9) for x in hand] for hand in truth.hands],
            }
        },
        "vehicle_from_world": [[float(x) for x in row] for row in invert(truth.world_from_scene)],
    }
    text = yaml.safe_dump(session, sort_keys=False, default_flow_style=None, width=120)
    (folder / SESSION).write_text(text, encoding="utf-8")


def load_rig(path: Path) -> Rig:
    """The rig of a laboratory in a YAML file. Raises ConfigError."""
    hint = "`cabinpose lab` writes one as rig.yaml; docs/alignment.md lists its keys"
    return validated(Rig, read_mapping(path, hint=hint), path, hint=hint)


def load_truth(folder: Path) -> Truth:
    """The truth of the driver's take of a session. Raises ConfigError where there is none."""
    path = truth_path(folder / ACTION)
    if not path.exists():
        raise ConfigError(
            f"{folder} holds no session of the laboratory: {path.name} is missing", hint="make one with `cabinpose lab`"
        )
    return Truth.load(path)
