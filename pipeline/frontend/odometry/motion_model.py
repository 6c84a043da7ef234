"""Constant velocity from frame to frame: where the next pose is looked for."""

import numpy as np
from scipy.spatial.transform import Rotation

from haustra.core.se3 import Array, inverse

MAX_GAP = 3  # frames over which the motion is carried on


def velocity_between(before: Array, now: Array, steps: int) -> Array:
    """Motion (4,4) in one frame interval of a camera that came from camera_from_world `before` to `now` in so many."""
    motion = now @ inverse(before)
    return motion if steps == 1 else _fraction(motion, 1 / steps)


def predicted_pose(camera_from_world: Array, velocity: Array, steps: int) -> Array:
    """camera_from_world (4,4) so many frame intervals later; as it is where they are more than `MAX_GAP`."""
    for _ in range(steps if steps <= MAX_GAP else 0):
        camera_from_world = velocity @ camera_from_world
    return camera_from_world


def _fraction(motion: Array, share: float) -> Array:
    """A share of a motion: of its rotation vector and of its translation."""
    part = np.eye(4)
    part[:3, :3] = Rotation.from_rotvec(share * Rotation.from_matrix(motion[:3, :3]).as_rotvec()).as_matrix()
    part[:3, 3] = share * motion[:3, 3]
    return part
