"""A circle of poses, and the exponential of Sim(3) by SciPy."""

import numpy as np
from scipy.linalg import expm
from scipy.spatial.transform import Rotation


def exponential(tangent: np.ndarray) -> np.ndarray:
    """Sim(3) by the matrix exponential of its generator: turn and growth in the corner, shift beside it."""
    x, y, z = tangent[:3]
    generator = np.zeros((4, 4))
    generator[:3, :3] = [[0, -z, y], [z, 0, -x], [-y, x, 0]]
    generator[:3, :3] += tangent[6] * np.eye(3)
    generator[:3, 3] = tangent[3:6]
    return expm(generator)


def circle(count: int = 30) -> np.ndarray:
    """Cameras on a circle of radius 3, looking along it: the last is beside the first."""
    poses = np.tile(np.eye(4), (count, 1, 1))
    for k, angle in enumerate(2 * np.pi * np.arange(count) / count):
        poses[k, :3, :3] = Rotation.from_euler("y", angle).as_matrix()
        poses[k, :3, 3] = 3 * np.sin(angle), 0, 3 * np.cos(angle)
    return poses
