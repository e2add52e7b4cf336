"""OpenSim's text files for the tests: what a .trc and a .sto say, read after OpenSim's documentation."""

from __future__ import annotations

from pathlib import Path

import numpy as np

# OpenSim: x forward, y up, z right. Ours: x forward, y left, z up.
ZUP_FROM_YUP = np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])


def read_trc(path: Path) -> tuple[list[str], np.ndarray, np.ndarray]:
    """Names, times (F,) s and positions (F, M, 3) m, z up; NaN for an occluded marker."""
    lines = path.read_text().splitlines()
    names = [name for name in lines[3].split("\t")[2:] if name]
    cells = [line.split("\t") for line in lines[6:]]
    values = np.array([[float(cell or "nan") for cell in row[1:]] for row in cells])
    return names, values[:, 0], values[:, 1:].reshape(len(cells), -1, 3) * 0.001 @ ZUP_FROM_YUP.T


def read_sto(path: Path) -> tuple[list[str], np.ndarray, np.ndarray]:
    """Names, times (F,) s and values (F, C), or (F, C, n) where a cell holds n of them, as the file has them."""
    lines = path.read_text().splitlines()
    begin = lines.index("endheader") + 1
    rows = [line.split("\t") for line in lines[begin + 1 :]]
    values = np.array([[[float(part) for part in cell.split(",")] for cell in row[1:]] for row in rows])
    times = np.array([float(row[0]) for row in rows])
    return lines[begin].split("\t")[1:], times, values[..., 0] if values.shape[2] == 1 else values
