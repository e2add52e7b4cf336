"""Seat-specific postures: inverse kinematics, seat fit, actions and profiles of seated people."""

from cabinpose.synth.posture.actions import ACTIONS, actions_for
from cabinpose.synth.posture.sampling import OccupantPose, random_action, sample_pose
from cabinpose.synth.posture.seating import SeatOffset, choose_setting, draw_offset

__all__ = [
    "ACTIONS", "OccupantPose", "SeatOffset", "actions_for", "choose_setting", "draw_offset", "random_action", "sample_pose",
]  # fmt: skip
