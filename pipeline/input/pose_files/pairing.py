"""Poses of a file and frames of a film, or of a run, that are of one time; or one sentence that says why few are."""

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from haustra.core.errors import HaustraError
from haustra.core.text import counted
from reconstruction.evaluation.trajectory_metrics import associate

MIN_PAIRED = 0.5  # share of the fewer, ours or the file's, that must be of one time
FEWEST = 3
LATE = 1e5  # s from which on times are told to a millisecond: six digits would leave none behind the second

Array = NDArray[np.float64]


def paired(
    seconds: Array, file_seconds: Array, path: Path, ours: str = "poses of the run"
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Rows of our times (K,) and of the file's (K,) that are of one time: half the file's spacing apart at most, closer
    than any other. HaustraError where most have no partner: the few that have one met by chance."""
    if len(file_seconds) < FEWEST:
        raise HaustraError(f"{path} holds {counted(len(file_seconds), 'pose')}; at least {FEWEST} are needed")
    spacing = float(np.median(np.diff(file_seconds)))
    try:
        mine, theirs = associate(seconds, file_seconds, max_difference=0.5 * spacing + 1e-6)
    except HaustraError:
        mine = theirs = np.empty(0, np.int64)
    most = min(len(seconds), len(file_seconds))
    if len(mine) < max(FEWEST, MIN_PAIRED * most):
        times = f"{_clock(file_seconds)} s, ours from {_clock(seconds)} s"
        raise HaustraError(
            f"only {len(mine)} of {most} {ours} and {path} are of one time: its times go from {times}"
            f"{_reason(seconds, file_seconds, spacing)}"
        )
    return mine, theirs


def _reason(seconds: Array, file_seconds: Array, spacing: float) -> str:
    """What the file's times look like instead of our seconds."""
    pace = float(np.median(np.diff(seconds))) if len(seconds) > 1 else 0.0
    ratio = spacing / max(pace, 1e-9)
    for unit, factor in (("milliseconds", 1e3), ("microseconds", 1e6), ("nanoseconds", 1e9)):
        if spacing >= 10 and 0.1 * factor < ratio < 30 * factor:
            return f"; they look like {unit}: divide them by {factor:g}"
    if np.allclose(file_seconds, np.round(file_seconds), rtol=0, atol=1e-6):
        return "; they look like frame numbers: divide them by the film's frames a second"
    shift = file_seconds[0] - seconds[0]
    if abs(shift) < spacing:
        return "; they begin at one time and are of another length: are they of this film, at its frames a second?"
    off = f"{shift:+.3f}" if abs(shift) >= LATE else f"{shift:+.3g}"
    return f"; if both are of the same stretch of film, a clock {off} s off would explain that: subtract it"


def _clock(seconds: Array) -> str:
    """From when to when; of a clock that began long before the film, as one of the day or of Unix, to a millisecond."""
    written = "{:.3f} to {:.3f}" if abs(seconds[-1]) >= LATE else "{:g} to {:g}"
    return written.format(seconds[0], seconds[-1])
