"""An orientation filter of others (VQF; Laidig and Seel 2023) on the BROAD benchmark: what one inertial sensor is worth today.

BROAD's trials (Laidig et al. 2021) hold an inertial sensor beside optical truth. `pip install 'cabinpose[bench]'` brings VQF.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from scipy.io import loadmat

from cabinpose.core.errors import MocapError
from cabinpose.core.imports import optional_module
from cabinpose.evaluate.mocap.orientation import OrientationErrors, orientation_errors

_NEEDED = ("imu_gyr", "imu_acc", "imu_mag", "opt_quat", "movement", "sampling_rate")


def broad_errors(path: Path, *, magnetometer: bool = True) -> OrientationErrors:
    """The filter's errors over a BROAD trial's (.mat) phases of movement; without magnetometer a constant heading is removed.

    Raises MocapError where the file is no trial of BROAD.
    """
    vqf = optional_module("vqf", purpose="the bench of orientation filters", hint="pip install 'cabinpose[bench]'")
    try:
        trial = loadmat(path)
    except (OSError, ValueError, IndexError, TypeError, NotImplementedError) as error:
        raise MocapError(f"{path} cannot be read: {error}", hint="give a .mat file of the BROAD benchmark") from error
    if absent := [name for name in _NEEDED if name not in trial]:
        raise MocapError(f"{path} has no {', '.join(absent)}", hint="give a .mat file of the BROAD benchmark")
    sensor = [np.ascontiguousarray(trial[name], np.float64) for name in _NEEDED[:3]]
    found = vqf.VQF(1 / float(trial["sampling_rate"].item())).updateBatch(*sensor)
    return orientation_errors(
        found["quat9D" if magnetometer else "quat6D"],
        trial["opt_quat"],
        counts=trial["movement"].ravel(),
        heading="kept" if magnetometer else "removed",
    )
