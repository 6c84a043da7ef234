"""Pose algebra on stacks: rotation (N,3,3) and translation (N,3) of `camera_from_world`; tangent rotation first."""

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

Array = NDArray[np.floating[Any]]


def exp_rotation(vectors: Array) -> Array:
    """(N,3) rotation vectors -> (N,3,3)."""
    return Rotation.from_rotvec(vectors).as_matrix()


def moved(rotation: Array, translation: Array, tangent: Array) -> tuple[Array, Array]:
    """Poses after the left update exp(w) x + v, tangent (N,6) = (w, v)."""
    turn = exp_rotation(tangent[:, :3])
    return turn @ rotation, np.einsum("nij,nj->ni", turn, translation) + tangent[:, 3:]


def inverse(transform: Array) -> Array:
    """The rigid 4x4 inverse; exact where `np.linalg.inv` would let rounding creep into the rotation."""
    result = np.eye(4)
    result[:3, :3] = transform[:3, :3].T
    result[:3, 3] = -transform[:3, :3].T @ transform[:3, 3]
    return result


def scaled(transform: Array, factor: float) -> Array:
    """The pose (4,4) in a world whose unit is smaller by `factor`."""
    result = transform.copy()
    result[:3, 3] *= factor
    return result


def compose(rotation: Array, translation: Array) -> Array:
    """(3,3) and (3,) -> 4x4, with the rotation brought back to the nearest true one."""
    u, _, vt = np.linalg.svd(rotation)
    transform = np.eye(4)
    transform[:3, :3] = u @ vt
    transform[:3, 3] = translation
    return transform


def in_camera(camera_from_world: Array, points: Array) -> Array:
    """World points (N,3) in the axes of one camera."""
    return points @ camera_from_world[:3, :3].T + camera_from_world[:3, 3]


def tangent_of(motion: Array) -> Array:
    """(6,) rotation vector and shift of a motion (4,4)."""
    return np.concatenate([Rotation.from_matrix(motion[:3, :3]).as_rotvec(), motion[:3, 3]])


def motion_of(tangent: Array) -> Array:
    """Motion (4,4) of a rotation vector and a shift (6,)."""
    motion = np.eye(4)
    motion[:3, :3], motion[:3, 3] = exp_rotation(tangent[:3]), tangent[3:]
    return motion


def share_of(motion: Array, share: float) -> Array:
    """A share of a motion (4,4): of its rotation vector and of its shift, each by itself."""
    return motion_of(share * tangent_of(motion))


def angle_between(first: Array, second: Array) -> float:
    """Angle of the rotation between two poses, radians."""
    return float(Rotation.from_matrix(first[:3, :3].T @ second[:3, :3]).magnitude())


def interpolated(seconds: Array, world_from_camera: Array, wanted: Array) -> Array:
    """(K,4,4) at times wanted (K,), between poses (N,4,4) at strictly rising times (N,), two and more: centres on
    straight lines, rotations on great arcs; at times beyond either end, the pose at that end."""
    after = np.searchsorted(seconds, wanted).clip(1, len(seconds) - 1)
    part = ((wanted - seconds[after - 1]) / (seconds[after] - seconds[after - 1])).clip(0, 1)[:, None]
    first, second = world_from_camera[after - 1], world_from_camera[after]
    turns = Rotation.from_matrix(first[:, :3, :3])
    turned = (turns.inv() * Rotation.from_matrix(second[:, :3, :3])).as_rotvec()
    result = np.tile(np.eye(4), (len(wanted), 1, 1))
    result[:, :3, :3] = (turns * Rotation.from_rotvec(part * turned)).as_matrix()
    result[:, :3, 3] = first[:, :3, 3] + part * (second[:, :3, 3] - first[:, :3, 3])
    return result
