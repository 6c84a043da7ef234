"""What would explain a bad comparison: true poses of another convention, another clock, another unit.

Nothing is corrected: a figure under a clock that was fitted would hide a wrong one. It is said what fits better.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from haustra.core.errors import HaustraError
from haustra.core.sim3 import umeyama
from pipeline.frontend.known_poses.pose_check import MIRROR, Y_UP, inverted, scalar_first
from pipeline.input.sensor.usual_distances import FARTHEST_MM
from pipeline.mapping.readjustment import path_difference
from reconstruction.evaluation.trajectory_metrics import associate, trajectory_errors

Array = NDArray[np.float64]
FEW_POSES = 10  # to which the seven numbers of a Sim(3) are fitted
BAD_FIT = 0.05  # of the path's own spread: better ones are not asked about
BETTER = 0.4  # of the residual as given: what another clock must bring it to
MOST_SHIFTS = 400
RATES = (1 / 2, 2.0, 24 / 25, 25 / 24, 24 / 30, 30 / 24, 25 / 30, 30 / 25)  # of a film's frames/s and those assumed
UNITS = ((1.0, "metres"), (10.0, "centimetres"))  # a length in mm over the number that stands for it / 1000
BAD_TURN_DEG = 15.0  # between a run's rotations and the true ones, where the centres fit
NO_FIT, NO_TURN_DEG = 0.25, 45.0  # from which on a path is none of this film, or wrong
SMALLEST = 0.1  # of the path, below which no wall has been seen along it
SHORTEST_MM = 1.0  # a path over which nothing could be triangulated: its numbers are of another unit


@dataclass(frozen=True)
class Timed:
    """A path: times (N,) s, ascending, and camera centres (N,3)."""

    seconds: Array
    centres: Array


def path_hints(run: Timed, truth: Timed, estimated: Array, true: Array, scale: float, in_mm: bool) -> tuple[str, ...]:
    """All sentences on why a path fits badly, or says little by fitting well; none where it fits.

    run, truth: the two paths, each by its own times; estimated, true: their poses that are of one time (K,4,4) each.
    scale: from the run's path to the true one; in_mm: whether the run has millimetres of its own.
    """
    fit = pose_hint(estimated, true) or clock_hint(run, truth) or misfit_hint(estimated, true)
    return tuple(hint for hint in (few_hint(len(true)), fit, unit_hint(truth, scale, in_mm)) if hint)


def clock_hint(run: Timed, truth: Timed) -> str:
    """A sentence on the shift or the pace of the true times under which the path fits far better; "" where there is
    none."""
    spacing = float(np.median(np.diff(truth.seconds)))
    residual, count = _residual(run, truth, 0.0, spacing)
    if residual < BAD_FIT:
        return ""
    reach = min(run.seconds[-1] - run.seconds[0], truth.seconds[-1] - truth.seconds[0]) / 2
    step = spacing * max(1, round(2 * reach / spacing / MOST_SHIFTS))
    shifts = step * np.arange(-int(reach / step), int(reach / step) + 1)
    fits = [(*_residual(run, truth, shift, spacing), shift) for shift in shifts if shift]
    truths = [(rate, replace(truth, seconds=rate * truth.seconds)) for rate in RATES]
    paced = [(*_residual(run, at_rate, 0.0, rate * spacing), rate) for rate, at_rate in truths]
    (best, shift), (best_paced, rate) = _best_of(fits, count), _best_of(paced, count)
    if min(best, best_paced) > BETTER * residual:
        return ""
    better = f"the path fits {residual / max(min(best, best_paced), 1e-6):.0f} times better with the true times"
    if best_paced < best:
        return f"{better} times {rate:.3g}: they may be of another frame rate"
    return f"{better} {shift:+.3g} s: the clocks may be off by that"


def _best_of(fits: list[tuple[float, int, float]], count: int) -> tuple[float, float]:
    """Residual and change of the best of (residual, pairs, change) that pairs half of `count` at least."""
    enough = [(residual, change) for residual, pairs, change in fits if pairs >= max(3, count // 2)]
    return min(enough, default=(np.inf, 0.0))


def pose_hint(estimated: Array, true: Array) -> str:
    """A sentence on another reading of the true poses, paired with ours (K,4,4) each, under which they fit where they
    do not as given; "" where there is none."""
    given = _misfit(estimated, true)
    if given[0] < BAD_FIT and given[1] < BAD_TURN_DEG:
        return ""
    fits = ((*_misfit(estimated, meaning(true)), reading) for reading, meaning in READINGS.items())
    better = [fit for fit in fits if fit[0] < BAD_FIT and fit[1] < BETTER * max(given[1], BAD_TURN_DEG)]
    if not better:
        return ""
    off, turned, reading = min(better, key=lambda fit: fit[1])  # more than one may do better than half a turn off
    return (
        f"the poses fit if the truth's {reading}: rotation median {turned:.2g} deg for {given[1]:.3g}, centres "
        f"{100 * off:.2g} % of their spread off for {100 * given[0]:.2g} %"
    )


def few_hint(count: int) -> str:
    """A sentence where a path is compared at few poses, to which the Sim(3) is fitted, too; "" otherwise."""
    if count >= FEW_POSES:
        return ""
    return (
        f"the path is compared at {count} poses alone: the Sim(3) that is fitted to them takes much of the error away; "
        "give a truth with more"
    )


def misfit_hint(estimated: Array, true: Array) -> str:
    """A sentence where the poses hardly resemble the true ones, paired with ours (K,4,4) each; "" otherwise.

    The rotation is that after a fit in which the axes have a say: by the centres alone a straight path may be turned
    about itself.
    """
    off, turned = _misfit(estimated, true)[0], path_difference(estimated, true).angle_deg
    if off < NO_FIT and turned < NO_TURN_DEG:
        return ""
    return (
        f"the paths hardly resemble each other: rotation median {turned:.3g} deg after a fit of centres and axes, "
        f"centres off by {100 * off:.2g} % of their spread; either this is the truth of another film, or the "
        "run is wrong"
    )


def _misfit(estimated: Array, true: Array) -> tuple[float, float]:
    """RMS of centres after Sim(3) over the true ones' spread, and the median angle between rotations, degrees."""
    spread = float(np.sqrt(true[:, :3, 3].var(axis=0).sum()))
    try:
        errors = trajectory_errors(estimated, true, "sim3", "mm")
    except HaustraError:
        return np.inf, np.inf
    return errors.ate_rmse / spread, errors.rotation_median_deg


def _mirrored_centres(poses: Array, axis: int) -> Array:
    read = poses.copy()
    read[:, axis, 3] *= -1
    return read


READINGS: dict[str, Callable[[Array], Array]] = {
    "quaternions are w x y z, and x y z w is read": scalar_first,
    "camera has OpenGL's axes (y up, z backwards), and OpenCV's are read": lambda poses: poses @ Y_UP,
    "poses are camera_from_world, and world_from_camera is read": inverted,
    "world is left-handed, as Unity's": lambda poses: MIRROR @ poses @ MIRROR,
} | {
    f"{name} of the centres has the other sign": partial(_mirrored_centres, axis=axis)
    for axis, name in enumerate("xyz")
}


def _residual(run: Timed, truth: Timed, shift: float, spacing: float) -> tuple[float, int]:
    """Of centres after Sim(3), RMS over the paired true centres' own spread, and the number of pairs; infinite for
    fewer than three."""
    try:
        mine, theirs = associate(run.seconds, truth.seconds + shift, max_difference=0.5 * spacing)
        true = truth.centres[theirs]
        spread = float(np.sqrt(((true - true.mean(axis=0)) ** 2).sum(axis=1).mean()))
        if len(mine) < 3 or not spread > 0:
            return np.inf, 0
        fit = umeyama(run.centres[mine], true, True)
    except HaustraError:
        return np.inf, 0
    off = run.centres[mine] @ fit[:3, :3].T + fit[:3, 3] - true
    return float(np.sqrt((off**2).sum(axis=1).mean())) / spread, len(mine)


def surface_hint(wall: Array, centres: Array) -> str:
    """A sentence where the true wall, points (N,3) in mm, cannot be what cameras at `centres` (M,3) saw: none of it is
    near any of them, or it is far smaller than their path. "" where it can."""
    size, way = (float(np.linalg.norm(np.ptp(points, axis=0))) for points in (wall, centres))
    if size < SMALLEST * way:
        return f"the true wall is {size:.3g} mm in size and the true path {way:.3g} mm: is it in metres?"
    nearest = float(cKDTree(wall).query(centres)[0].min())
    if nearest > FARTHEST_MM:
        return f"no true camera is nearer than {nearest:.0f} mm to the true wall: it has another frame or unit"
    return ""


def unit_hint(truth: Timed, scale: float, in_mm: bool) -> str:
    """A sentence on the true lengths' unit where they can hardly be mm; scale: from the run's path to the true one;
    in_mm: whether the run has millimetres of its own."""
    length = float(np.linalg.norm(np.diff(truth.centres, axis=0), axis=1).sum())
    stated = f"the true path is {length:.3g} long; taken for mm, as all lengths here"
    if in_mm:
        for factor, name in UNITS:
            if 0.5 < 1000 * scale / factor < 2:
                return f"{stated}, but the run's own millimetres say {name}: multiply the truth by {1000 / factor:g}"
        return ""
    if length < SHORTEST_MM:
        return f"{stated}, but so short a path gives no depth: if it is in metres, multiply the truth by 1000"
    return ""
