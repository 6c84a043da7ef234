"""Trajectory metrics: association by time, alignment (Umeyama), ATE, RTE and rotation errors.

Trajectories are `world_from_camera` (N,4,4): the camera's centre is the last column.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from haustra.core.errors import ReconstructionError
from haustra.core.sim3 import scale_of, umeyama
from reconstruction.evaluation.trajectory_io import checked_poses

Array = NDArray[np.float64]
Alignment = Literal["sim3", "se3", "none"]

COLLINEAR = 1e-9  # second over first singular value of the centres' covariance, below which they lie on one line


def associate(
    first_seconds: Array, second_seconds: Array, max_difference: float = 0.01
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Rows (K,), (K,) of the times (N,), (M,) that are mutually nearest and at most `max_difference` seconds apart."""
    first, second = np.asarray(first_seconds, float), np.asarray(second_seconds, float)
    if not first.size or not second.size:
        raise ReconstructionError("there are no poses to associate")
    partner = _nearest(first, second)
    index = np.arange(len(first))
    mutual = _nearest(second, first)[partner] == index
    close = mutual & (np.abs(first - second[partner]) <= max_difference)
    if not close.any():
        raise ReconstructionError(f"no two poses lie within {max_difference} s of each other")
    return index[close], partner[close]


def _nearest(query: Array, ascending: Array) -> NDArray[np.int64]:
    """Index (N,) of the value of `ascending` (M,) nearest to each value of `query` (N,)."""
    right = np.searchsorted(ascending, query).clip(1, max(1, len(ascending) - 1))
    right = np.minimum(right, len(ascending) - 1)
    left = np.maximum(right - 1, 0)
    return np.where(query - ascending[left] <= ascending[right] - query, left, right)


@dataclass(frozen=True)
class SimCol3DErrors:
    """Errors by the SimCol3D challenge: motions chained from the true first pose, one scale, no rotation fitted."""

    ate_median: float  # in `unit`; median distance of the chained camera centres
    rte_median: float  # in `unit`; median length of the error of a one-frame motion
    rot_median_deg: float  # median angle of the error of a one-frame motion
    scale: float
    unit: str
    count: int  # motions compared


@dataclass(frozen=True)
class TrajectoryErrors:
    """Absolute trajectory error after `alignment`, all frames weighing the same."""

    ate_rmse: float  # in `unit`, of distances of camera centres
    ate_mean: float
    ate_median: float
    rotation_median_deg: float
    rotation_max_deg: float
    scale: float  # the factor that the alignment put on the estimate
    alignment: Alignment
    unit: str
    count: int  # poses compared


def trajectory_errors(
    estimated: Array, truth: Array, alignment: Alignment = "sim3", unit: str = "mm"
) -> TrajectoryErrors:
    """ATE of `world_from_camera` (N,4,4) after a Sim(3), an SE(3) or no fit (evo: `-as`, `-a`, none)."""
    estimated, truth = _paired(estimated, truth)
    if alignment not in get_args(Alignment):
        raise ReconstructionError(f"alignment is one of {', '.join(get_args(Alignment))}, not {alignment!r}")
    truth_from_estimate = np.eye(4) if alignment == "none" else _align_poses(estimated, truth, alignment == "sim3")
    return _errors_after(truth_from_estimate, estimated, truth, alignment, unit)


def _errors_after(
    truth_from_estimate: Array, estimated: Array, truth: Array, alignment: Alignment, unit: str
) -> TrajectoryErrors:
    """Errors of the trajectory moved by `truth_from_estimate` (4,4)."""
    scale = float(scale_of(truth_from_estimate))
    aligned = truth_from_estimate @ estimated
    distance = np.linalg.norm(aligned[:, :3, 3] - truth[:, :3, 3], axis=1)
    angle = _angle_deg(np.swapaxes(truth[:, :3, :3], 1, 2) @ (aligned[:, :3, :3] / scale))
    return TrajectoryErrors(
        ate_rmse=float(np.sqrt(np.mean(distance**2))),
        ate_mean=float(distance.mean()),
        ate_median=float(np.median(distance)),
        rotation_median_deg=float(np.median(angle)),
        rotation_max_deg=float(angle.max()),
        scale=scale,
        alignment=alignment,
        unit=unit,
        count=len(truth),
    )


def simcol3d_errors(estimated: Array, truth: Array, unit: str = "mm") -> SimCol3DErrors:
    """ATE, RTE and ROT of (N,4,4) as the SimCol3D challenge defines them (repository anitarau/simcol, evaluation/)."""
    estimated, truth = _paired(estimated, truth)
    motion, true_motion = _one_frame_motions(estimated), _one_frame_motions(truth)
    length_squared = np.sum(motion[:, :3, 3] ** 2)
    if not length_squared > 0:
        raise ReconstructionError("the estimated camera does not move, so SimCol3D's scale is not defined")
    scale = np.sum(true_motion[:, :3, 3] * motion[:, :3, 3]) / length_squared
    motion[:, :3, 3] *= scale
    chained = [truth[0]]
    for step in motion:
        chained.append(chained[-1] @ step)
    drift = np.linalg.norm(np.stack(chained)[:, :3, 3] - truth[:, :3, 3], axis=1)
    residual = np.linalg.inv(true_motion) @ motion
    return SimCol3DErrors(
        ate_median=float(np.median(drift)),
        rte_median=float(np.median(np.linalg.norm(residual[:, :3, 3], axis=1))),
        rot_median_deg=float(np.median(_angle_deg(residual[:, :3, :3]))),
        scale=float(scale),
        unit=unit,
        count=len(motion),
    )


def _align_poses(estimated: Array, truth: Array, with_scale: bool) -> Array:
    """`truth_from_estimate` (4,4): Umeyama on the centres; of collinear ones the orientations fix the roll."""
    centres, true_centres = estimated[:, :3, 3], truth[:, :3, 3]
    truth_from_estimate = umeyama(centres, true_centres, with_scale)
    pivot = true_centres.mean(axis=0)
    directions, spread, _ = np.linalg.svd((true_centres - pivot).T @ (centres - centres.mean(axis=0)))
    if spread[1] > COLLINEAR * spread[0]:
        return truth_from_estimate
    rotations = truth_from_estimate[:3, :3] @ estimated[:, :3, :3]
    roll = _best_roll(directions[:, 0], rotations, truth[:, :3, :3])
    about_the_line = np.eye(4)
    about_the_line[:3, :3] = roll
    about_the_line[:3, 3] = pivot - roll @ pivot
    return about_the_line @ truth_from_estimate


def align_poses(estimated: Array, truth: Array, with_scale: bool = True) -> Array:
    """The Sim(3) `truth_from_estimate` (4,4), or the SE(3), that fits centres and orientations of (N,4,4) together.

    Centres of a nearly straight path hardly constrain the roll about it, and a surface 20 mm off the path would move by
    millimetres. So Umeyama also gets the tips of each camera's three axes, as long as the true centres' spread.
    """
    estimated, truth = _paired(estimated, truth)
    from_centres = umeyama(estimated[:, :3, 3], truth[:, :3, 3], with_scale)
    scale = float(scale_of(from_centres))
    reach = float(np.sqrt(truth[:, :3, 3].var(axis=0).sum()))
    return umeyama(_centres_and_tips(estimated, reach / scale), _centres_and_tips(truth, reach), with_scale)


def _centres_and_tips(world_from_camera: Array, length: float) -> Array:
    """Centres (N,3) of cameras (N,4,4), and the tips of their axes of that length: (4 N,3)."""
    centres = world_from_camera[:, :3, 3]
    return np.concatenate([centres, *(centres + length * world_from_camera[:, :3, axis] for axis in range(3))])


def _best_roll(axis: Array, rotations: Array, true_rotations: Array) -> Array:
    """The rotation about `axis` that brings `rotations` (N,3,3) nearest to the true ones, by the sum of traces.

    trace(R(angle) M) = cos(angle) (trace M - a'Ma) + sin(angle) trace([a]x M) + a'Ma, by Rodrigues' formula.
    """
    m = np.einsum("nij,nkj->ik", rotations, true_rotations)
    cosine_part = np.trace(m) - axis @ m @ axis
    sine_part = np.trace(np.cross(np.eye(3), axis) @ m)  # row i of [a]x is e_i x a
    return Rotation.from_rotvec(np.arctan2(sine_part, cosine_part) * axis).as_matrix()


def _one_frame_motions(world_from_camera: Array) -> Array:
    """`camera_from_next` (N-1,4,4) of consecutive cameras (N,4,4)."""
    return np.linalg.inv(world_from_camera[:-1]) @ world_from_camera[1:]


def _angle_deg(rotations: Array) -> Array:
    """Angle (N,) of rotations (N,3,3) in degrees; by the quaternion, as arccos of the trace loses digits near 0."""
    return np.degrees(Rotation.from_matrix(rotations).magnitude())


def _paired(estimated: Array, truth: Array) -> tuple[Array, Array]:
    """Both as float64 (N,4,4); `ReconstructionError` unless there are two or more pairs."""
    estimated, truth = checked_poses(estimated), checked_poses(truth)
    if len(estimated) != len(truth) or len(truth) < 2:
        raise ReconstructionError(f"two or more pairs of poses are needed, got {len(estimated)} and {len(truth)}")
    return estimated, truth
