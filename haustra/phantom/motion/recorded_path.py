"""Camera paths of real hands: a recorded trajectory replayed along a phantom's lumen.

A recording is in the frame of the gut that it was filmed in, which is not ours. What is taken over is the motion
relative to a slow camera, the recording smoothed over SLOW_S seconds:

- progress, the recorded steps along the slow view direction, summed, becomes arc length along our centreline;
- sway, the summed sideways steps less their own slow part, becomes an offset across our lumen;
- the rotation from the slow camera to the recorded one turns our camera away from the lumen's direction.

Speed, tremor, jerks, rests and changes of direction are those of the recording; the slow course is our gut's.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter1d
from scipy.spatial.transform import Rotation, Slerp

from haustra.core.errors import PhantomError
from haustra.phantom.anatomy.colon import Colon
from haustra.phantom.config import MotionConfig
from haustra.phantom.motion.camera_path import keep_off, look_at
from haustra.phantom.raycaster import RayCaster

Array = NDArray[np.float64]
SLOW_S = 1.5  # seconds, standard deviation of the smoothing that divides slow course from hand motion
MAX_SWAY = 0.35  # of the lumen's radius
SHORTEST = 30  # poses; less is no recording of a hand


def read_recording(path: Path) -> tuple[Array, Array]:
    """Seconds (N,) and world_from_camera (N,4,4), mm, of a TUM file. PhantomError where it is none or too short."""
    try:
        lines = path.read_text().splitlines()
        rows = np.array([[float(word) for word in line.split()] for line in lines if line.strip()])
    except OSError as error:
        raise PhantomError(f"recording {path}: {error.strerror}; --recordings names its folder") from None
    except ValueError:  # also of lines of unequal length, and of bytes that are no text
        rows = np.empty(0)
    if rows.ndim != 2 or rows.shape[1] != 8 or not np.isfinite(rows).all():
        raise PhantomError(f"{path}: not a TUM trajectory (lines of 8 numbers: seconds, position, quaternion)")
    if not (np.linalg.norm(rows[:, 4:], axis=1) > 0).all():
        raise PhantomError(f"{path}: has a quaternion of length 0")
    if len(rows) < SHORTEST or not (np.diff(rows[:, 0]) > 0).all():
        raise PhantomError(f"{path}: needs at least {SHORTEST} poses in order of time, has {len(rows)}")
    world_from_camera = np.tile(np.eye(4), (len(rows), 1, 1))
    world_from_camera[:, :3, :3] = Rotation.from_quat(rows[:, 4:]).as_matrix()
    world_from_camera[:, :3, 3] = rows[:, 1:4]
    return rows[:, 0], world_from_camera


def replay(colon: Colon, caster: RayCaster, motion: MotionConfig, seconds: Array, recorded: Array) -> Array:
    """Poses world_from_camera (N,4,4), mm, of a recording's motion (`recorded` (M,4,4) at `seconds`) in our lumen.

    A recording shorter than the film is played backwards from its end, and so on. PhantomError where the way leaves
    the lumen.
    """
    turns, positions = _resampled(seconds, recorded, motion)
    slow = _smoothed(turns, SLOW_S * motion.fps)
    steps = slow[:-1].inv().apply(np.diff(positions, axis=0))  # in the slow camera's axes: right, down, forward
    way = np.concatenate([np.zeros((1, 3)), np.cumsum(steps, axis=0)])
    arc = motion.start * colon.line.arc[-1] + way[:, 2]
    if arc.min() < 0 or arc.max() > colon.line.arc[-1]:
        raise PhantomError(
            f"{motion.recording}: its way of {np.ptp(way[:, 2]):.0f} mm from {motion.start:.0%} leaves the "
            f"{colon.line.arc[-1]:.0f} mm lumen"
        )
    centre, frames = colon.line.at(arc)
    sway = way[:, :2] - gaussian_filter1d(way[:, :2], SLOW_S * motion.fps, axis=0, mode="nearest")
    sway *= np.minimum(1.0, MAX_SWAY * colon.anatomy.radius_mm / max(np.abs(sway).max(), 1e-9))
    placed = centre + frames[..., 0] * sway[:, :1] + frames[..., 1] * sway[:, 1:]
    placed = keep_off(placed, centre, colon, caster, np.full(motion.frames, motion.clearance_mm))
    goal, goal_frames = colon.line.at(arc + motion.ahead_mm)
    world_from_camera = np.tile(np.eye(4), (motion.frames, 1, 1))
    world_from_camera[:, :3, :3] = look_at(goal - placed, goal_frames[..., 1]) @ (slow.inv() * turns).as_matrix()
    world_from_camera[:, :3, 3] = placed
    return world_from_camera


def _resampled(seconds: Array, recorded: Array, motion: MotionConfig) -> tuple[Rotation, Array]:
    """Rotations and positions (N,3) at the film's frame times, to and fro along the recording."""
    length = seconds[-1] - seconds[0]
    time = np.arange(motion.frames) / motion.fps
    folded = length - np.abs(length - time % (2 * length)) + seconds[0]
    turns = Slerp(seconds, Rotation.from_matrix(recorded[:, :3, :3]))(np.clip(folded, seconds[0], seconds[-1]))
    positions = np.stack([np.interp(folded, seconds, recorded[:, axis, 3]) for axis in range(3)], axis=1)
    return turns, positions


def _smoothed(turns: Rotation, sigma: float) -> Rotation:
    """Rotations smoothed over `sigma` frames: normalised weighted mean of quaternions of one sign."""
    quaternions = turns.as_quat()
    flips = np.cumprod(np.concatenate([[1.0], np.where((quaternions[1:] * quaternions[:-1]).sum(axis=1) < 0, -1, 1)]))
    return Rotation.from_quat(gaussian_filter1d(quaternions * flips[:, None], sigma, axis=0, mode="nearest"))
