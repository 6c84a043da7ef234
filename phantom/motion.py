"""Where the tip goes: seeded, smooth camera paths that keep off the wall."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter1d
from scipy.spatial.transform import Rotation

from phantom.colon import Colon
from phantom.config import MotionConfig
from phantom.noise import path_noise
from phantom.raycaster import RayCaster

Array = NDArray[np.float64]
PUSH_ROUNDS = 80
PUSH_SPREAD = 5.0  # frames: a push off the wall starts before the wall is reached
DIRECTIONS = {"insertion": 1.0, "withdrawal": -1.0}


def camera_path(colon: Colon, caster: RayCaster, motion: MotionConfig, seed: int) -> Array:
    """Poses world_from_camera (N,4,4), mm. The camera looks along increasing arc length either way."""
    if motion.direction not in DIRECTIONS:
        raise ValueError(f"unknown direction {motion.direction!r}; known: {', '.join(DIRECTIONS)}")
    rng = np.random.default_rng([seed, 4])
    arc = _progress(colon.line.arc[-1], motion, rng)
    centre, frames = colon.line.at(arc)
    sway = motion.wobble_mm * _swings(2, motion, rng)
    positions = centre + frames[..., 0] * sway[:, :1] + frames[..., 1] * sway[:, 1:]
    positions = _keep_off(positions, centre, colon, caster, motion.clearance_mm)
    goal, goal_frames = colon.line.at(arc + motion.ahead_mm)
    looks = np.radians(motion.look_deg) * _swings(2, motion, rng)
    rolls = np.radians(motion.roll_deg) * _swings(1, motion, rng)
    poses = np.tile(np.eye(4), (motion.frames, 1, 1))
    poses[:, :3, :3] = _look_at(goal - positions, goal_frames[..., 1]) @ _turns(looks, rolls)
    poses[:, :3, 3] = positions
    return poses


def clearance(colon: Colon, caster: RayCaster, points: Array) -> tuple[Array, Array]:
    """Distance of points (N,3) to the wall (mm, negative outside the lumen) and the unit way off it (N,3)."""
    foot, triangle = caster.nearest(points)
    corners = colon.vertices[colon.triangles[triangle]].astype(float)
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    away = points - foot
    side = np.sign(np.sum(away * normal, axis=1))
    distance = np.linalg.norm(away, axis=1)
    return side * distance, side[:, None] * away / np.maximum(distance, 1e-9)[:, None]


def _progress(length: float, motion: MotionConfig, rng: np.random.Generator) -> Array:
    """Arc length of each frame: never stops, never turns round."""
    speed = motion.speed_mm * np.maximum(
        0.1, 1 + motion.speed_variation * path_noise(motion.frames, motion.wobble_period, rng)
    )
    travelled = np.concatenate([[0.0], np.cumsum(speed[:-1])])
    arc = motion.start * length + DIRECTIONS[motion.direction] * travelled
    if arc.min() < 0 or arc.max() > length:
        raise ValueError(f"a path of {travelled[-1]:.0f} mm from {motion.start:.0%} leaves the {length:.0f} mm lumen")
    return arc


def _swings(count: int, motion: MotionConfig, rng: np.random.Generator) -> Array:
    """Independent smooth signals (N,count) within about [-1, 1]."""
    return np.stack([path_noise(motion.frames, motion.wobble_period, rng) for _ in range(count)], axis=1)


def _keep_off(positions: Array, centre: Array, colon: Colon, caster: RayCaster, wanted_mm: float) -> Array:
    """Push positions (N,3) off the wall, each push spread over neighbouring frames, until all are clear."""
    for _ in range(PUSH_ROUNDS):
        distance, away = clearance(colon, caster, positions)
        if distance.min() >= wanted_mm:
            return positions
        outside = distance < 0  # beyond the wall the nearest way off it may lead astray: go for the centre
        home = (centre - positions) / np.maximum(np.linalg.norm(centre - positions, axis=1), 1e-9)[:, None]
        push = np.maximum(wanted_mm + 0.3 - distance, 0.0)[:, None] * np.where(outside[:, None], home, away)
        positions = positions + 1.5 * gaussian_filter1d(push, PUSH_SPREAD, axis=0, mode="nearest")
    raise ValueError(f"no path with {wanted_mm} mm clearance: the lumen is too narrow, or the clearance too wide")


def _look_at(forward: Array, down: Array) -> Array:
    """Rotations (N,3,3), columns right, down, forward, from a view direction and a rough down direction."""
    z = forward / np.linalg.norm(forward, axis=1, keepdims=True)
    x = np.cross(down, z)
    x /= np.linalg.norm(x, axis=1, keepdims=True)
    return np.stack([x, np.cross(z, x), z], axis=-1)


def _turns(looks: Array, rolls: Array) -> Array:
    """Look-around (N,2) and roll (N,1) in radians as rotations (N,3,3) applied in camera axes."""
    pan_tilt = Rotation.from_rotvec(np.concatenate([looks, np.zeros_like(rolls)], axis=1))
    roll = Rotation.from_rotvec(np.concatenate([np.zeros_like(looks), rolls], axis=1))
    return (pan_tilt * roll).as_matrix()
