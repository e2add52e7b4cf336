"""BVH reading and forward kinematics: closed forms, an independent walk of the real file, and damaged files."""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from cabinpose.core.errors import MocapError
from cabinpose.synth.mocap import CMU_UNIT_M, read_bvh

SMALL = """HIERARCHY
ROOT Hips
{
  OFFSET 0 0 0
  CHANNELS 6 Xposition Yposition Zposition Zrotation Yrotation Xrotation
  JOINT Arm
  {
    OFFSET 1 0 0
    CHANNELS 3 Zrotation Xrotation Yrotation
    End Site
    {
      OFFSET 0 -2 0
    }
  }
}
MOTION
Frames: 2
Frame Time: 0.01
0 10 0 0 0 0 0 0 0
0 10 5 90 0 0 0 90 0
"""


def written(folder: Path, text: str) -> Path:
    path = folder / "motion.bvh"
    path.write_text(text)
    return path


def test_closed_form(tmp_path: Path) -> None:
    clip = read_bvh(written(tmp_path, SMALL), unit_m=0.01).clip()
    assert clip.names == ("Hips", "Arm", "Arm_end")
    # File axes x left, y up, z forward; ours x forward, y left, z up.
    np.testing.assert_allclose(clip.positions[0], [[0, 0, 0.10], [0, 0.01, 0.10], [0, 0.01, 0.08]], atol=1e-12)
    # Root turned 90 degrees about file z: x -> y, so the arm sits above; then about its own x: -y -> -z, which stays -z.
    np.testing.assert_allclose(clip.positions[1], [[0.05, 0, 0.10], [0.05, 0, 0.11], [0.03, 0, 0.11]], atol=1e-12)
    np.testing.assert_allclose(clip.rest_positions, [[0, 0, 0], [0, 0.01, 0], [0, 0.01, -0.02]], atol=1e-12)


def test_z_up_keeps_lengths_and_handedness(tmp_path: Path) -> None:
    bvh = read_bvh(written(tmp_path, SMALL), up="z")
    clip = bvh.clip()
    np.testing.assert_allclose(np.linalg.det(clip.rotations), 1.0)
    np.testing.assert_allclose(clip.rest_positions[1], [0, CMU_UNIT_M, 0])  # +x is the left in both


def elementary(axis: str, degrees: float) -> np.ndarray:
    c, s = math.cos(math.radians(degrees)), math.sin(math.radians(degrees))
    i, j = {"X": (1, 2), "Y": (2, 0), "Z": (0, 1)}[axis]
    m = np.eye(4)
    m[i, i] = m[j, j] = c
    m[j, i], m[i, j] = s, -s
    return m


def positions_by_matrices(text: str, frame: int, unit: float) -> dict[str, np.ndarray]:
    """An independent reading: one stack of 4x4 matrices pushed and popped while the text goes by."""
    head, tail = text.split("MOTION")
    values = [float(v) for v in tail.strip().splitlines()[2 + frame].split()]
    stack, result, offset, name = [np.eye(4)], {}, np.zeros(3), ""
    for line in (line.strip() for line in head.splitlines()):
        if match := re.match(r"(?:ROOT|JOINT) (\S+)", line):
            name = match[1]
        elif line == "End Site":
            name += "_end"
        elif line.startswith("OFFSET"):
            offset = np.array([float(v) for v in line.split()[1:]]) * unit
            m = np.eye(4)
            m[:3, 3] = offset
            stack.append(stack[-1] @ m)
            result[name] = stack[-1][:3, 3].copy()
        elif line.startswith("CHANNELS"):
            for channel in line.split()[2:]:
                value = values.pop(0)
                if channel.endswith("position"):
                    stack[-1]["XYZ".index(channel[0]), 3] += value * unit
                else:
                    stack[-1] = stack[-1] @ elementary(channel[0], value)
            result[name] = stack[-1][:3, 3].copy()
        elif line == "}":
            stack.pop()
    assert not values
    return result


def test_real_recording_against_an_independent_walk(real_data: Callable[[str], Path]) -> None:
    path = real_data("mocap/cmu_131_01.bvh")
    bvh = read_bvh(path)
    clip = bvh.clip()
    assert len(clip) == 994
    assert clip.frame_s == pytest.approx(1 / 120, rel=1e-3)
    text = path.read_text()
    for frame in (0, 397, 993):
        expected = positions_by_matrices(text, frame, CMU_UNIT_M)
        for j, name in enumerate(clip.names):
            x, y, z = expected[name]
            np.testing.assert_allclose(clip.positions[frame, j], [z, x, y], atol=1e-9, err_msg=name)
    feet = clip.positions[:, [clip.names.index("LeftToe"), clip.names.index("RightToe")], 2]
    assert -0.05 < feet.min() < 0.05  # the ground
    assert 1.35 < clip.positions[..., 2].max() < 1.75  # a grown person, so the unit is right


DAMAGE = {
    "no motion": (lambda t: t.split("MOTION")[0], "no MOTION"),
    "cut hierarchy": (lambda t: t.replace("}\n}\nMOTION", "MOTION"), "ends early"),
    "cut motion": (lambda t: t.rsplit("\n", 2)[0] + "\n", "states 2 frames and holds 1"),
    "short row": (lambda t: t.replace("90 0\n", "90\n"), "frame 1 has 8 values for 9"),
    "no number": (lambda t: t.replace("0 10 5", "0 ten 5"), "no number"),
    "not finite": (lambda t: t.replace("0 10 5", "0 nan 5"), "not finite"),
    "unknown channel": (lambda t: t.replace("Xrotation Yrotation", "Wrotation Yrotation"), "unknown channel 'Wrotation'"),
    "channel count": (lambda t: t.replace("CHANNELS 3", "CHANNELS 4"), "unknown channel 'End'"),
    "channel twice": (lambda t: t.replace("Zrotation Xrotation Yrotation", "Zrotation Zrotation Yrotation"), "a channel twice"),
    "same names": (lambda t: t.replace("JOINT Arm", "JOINT Hips"), "given twice: Hips"),
    "bad offset": (lambda t: t.replace("OFFSET 1 0 0", "OFFSET 1 0 x"), "three numbers"),
    "frame time": (lambda t: t.replace("Time: 0.01", "Time: 0"), "no positive number"),
    "no frames": (lambda t: re.sub(r"Frames: 2(\s.*\s)(.*\s)*", r"Frames: 0\1", t), "holds no frame"),
    "other file": (lambda t: "glTF", "no MOTION"),
}


@pytest.mark.parametrize("name", DAMAGE)
def test_damaged_files_are_refused(name: str, tmp_path: Path) -> None:
    damage, message = DAMAGE[name]
    text = damage(SMALL)
    assert text != SMALL
    with pytest.raises(MocapError, match=message) as caught:
        read_bvh(written(tmp_path, text))
    assert caught.value.hint


def test_missing_and_binary_files(tmp_path: Path) -> None:
    with pytest.raises(MocapError, match="does not exist"):
        read_bvh(tmp_path / "none.bvh")
    (tmp_path / "binary.bvh").write_bytes(b"\xff\xfe\x00\x80")
    with pytest.raises(MocapError, match="as text"):
        read_bvh(tmp_path / "binary.bvh")
