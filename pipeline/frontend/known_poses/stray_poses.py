"""Single poses that lie far from those before and after: a tracker's glitch, which no camera moves by."""

import numpy as np
from numpy.typing import NDArray

from haustra.core.se3 import Array

AROUND = 4  # poses before and after
STEPS = 10.0  # times what the camera moves by in as many fast steps; out and back within a quarter of a second
FAST = 90  # percentile of the steps; the median is near zero where the camera rests most of the time
LEAST = 1e-3  # of the path's extent, where nearly all steps are zero


def stray_poses(world_from_camera: Array) -> tuple[NDArray[np.bool_], Array]:
    """Of poses (N,4,4) in the order of time: (N,) which are stray, and (N,) how far each is from the median place of
    its neighbours, in the poses' unit. A camera that moves on, however fast, passes its neighbours' median."""
    places = world_from_camera[:, :3, 3]
    rows = np.arange(len(places))
    around = np.clip(rows[:, None] + np.arange(-AROUND, AROUND + 1), 0, len(places) - 1)
    away = np.linalg.norm(places - np.median(places[around], axis=1), axis=1)
    steps = np.linalg.norm(np.diff(places, axis=0), axis=1)
    extent = np.ptp(np.percentile(places, [5, 95], axis=0), axis=0).max()
    limit = max(STEPS * AROUND * float(np.percentile(steps, FAST)), LEAST * float(extent)) if len(steps) else np.inf
    return away > max(limit, np.finfo(float).tiny), away
