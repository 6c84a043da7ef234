"""What would explain a bad comparison: true times of another clock, true lengths in another unit.

Nothing is corrected: a figure under a clock that was fitted would hide a wrong one. It is said what fits better.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from haustra.core.errors import HaustraError
from haustra.core.sim3 import umeyama
from reconstruction.evaluation.trajectory_metrics import associate

Array = NDArray[np.float64]
BAD_FIT = 0.05  # of the path's own spread: better ones are not asked about
BETTER = 0.4  # of the residual as given: what another clock must bring it to
MOST_SHIFTS = 400
UNITS = ((1.0, "metres"), (10.0, "centimetres"))  # a length in mm over the number that stands for it / 1000
SHORTEST_MM = 1.0  # a path over which nothing could be triangulated: its numbers are of another unit


@dataclass(frozen=True)
class Timed:
    """A path: times (N,) s, ascending, and camera centres (N,3)."""

    seconds: Array
    centres: Array


def clock_hint(run: Timed, truth: Timed) -> str:
    """A sentence on the shift of the true times under which the path fits far better; "" where there is none."""
    spacing = float(np.median(np.diff(truth.seconds)))
    residual, count = _residual(run, truth, 0.0, spacing)
    if residual < BAD_FIT:
        return ""
    reach = min(run.seconds[-1] - run.seconds[0], truth.seconds[-1] - truth.seconds[0]) / 2
    step = spacing * max(1, round(2 * reach / spacing / MOST_SHIFTS))
    shifts = step * np.arange(-int(reach / step), int(reach / step) + 1)
    fits = [(*_residual(run, truth, shift, spacing), shift) for shift in shifts if shift]
    fits = [fit for fit in fits if fit[1] >= max(3, count // 2)]
    if not fits:
        return ""
    best, _, shift = min(fits)
    if best > BETTER * residual:
        return ""
    return (
        f"the path fits {residual / max(best, 1e-6):.0f} times better with the true times {shift:+.3g} s: the clocks "
        "may be off by that"
    )


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
