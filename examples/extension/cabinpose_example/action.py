"""An action: a hand at the head, as if it smoothed the hair over an ear."""

from cabinpose.synth.posture import PLACES, Action, Gaze

ADJUST_HAIR = Action("adjust_hair", PLACES["ear"], PLACES["thigh"], Gaze((0.0, 8.0), (-12.0, 5.0)), most_neighbours=0)
