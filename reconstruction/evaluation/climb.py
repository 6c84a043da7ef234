"""Trajectory errors by the protocol of CLiMB, the Colonoscopy Localization and Mapping Benchmark (MICCAI 2026).

Each submap is aligned to the reference by its own Sim(3). What is averaged over submaps weighs by their matched poses.
Definitions: repository EndoCartoScope/climb-challenge, README.md and evaluation/ at 9bd1bff.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from haustra.core.errors import ReconstructionError
from haustra.core.sim3 import scale_of, umeyama
from haustra.core.text import counted
from reconstruction.evaluation.trajectory_io import checked_poses

Array = NDArray[np.float64]
Frames = NDArray[np.int64]
INTERVALS = (1, 10, 20, 40)  # frames, of the relative pose errors
MIN_COMMON = 100  # frames that a submap must share with the reference to count (the public evaluator's)
MIN_TRACKED = 0.5  # share of the reference's frames above which a clip succeeds
# A clip that does not counts with these and no frame tracked, which gives 25 x 1.5 x 1.5.
FAILED_ATE_MM, FAILED_TIME_FACTOR, FAILED_SCORE = 25.0, 1.5, 56.25


@dataclass(frozen=True)
class RelativeError:
    """Mean error of the motion over an interval of frames, within submaps; NaN where no two poses are so far apart."""

    frames: int
    translation_mm: float
    rotation_deg: float
    count: int  # pairs of poses


@dataclass(frozen=True)
class ClimbErrors:
    """CLiMB's figures of one clip.

    `ate_mean_mm`, `tracked_fraction`, `time_factor` and `score` are those that the protocol counts: of a clip that has
    `failed` 25 mm, 0, 1.5 and 56.25. What was measured of it is in the `measured_` fields; the relative errors are
    measured in any case. Of other clips `time_factor` and `score` are None where the time of the frame loop is unknown.
    `notes`: sentences on the reference; `hints`: on poses, clocks and units that would explain a bad fit.
    """

    failed: bool
    ate_mean_mm: float
    tracked_fraction: float
    time_factor: float | None
    score: float | None  # mm-like, lower is better
    measured_ate_mean_mm: float | None  # of camera centres, of each submap after its Sim(3), by matched poses; or None
    measured_ate_median_mm: float | None  # likewise, of the submaps' medians
    measured_tracked_fraction: float  # matched poses over frames of the reference
    measured_time_factor: float | None
    relative: tuple[RelativeError, ...]
    matched: int
    interpolated: int  # of the matched poses
    reference: int
    submaps: int  # that count
    submaps_left_out: int  # that share too few frames with the reference, or do not move
    seconds_per_frame: float | None
    notes: tuple[str, ...] = ()
    hints: tuple[str, ...] = ()

    def to_dict(self) -> dict[str, Any]:
        return asdict(self)

    def __str__(self) -> str:
        lines = self._measured() if self.submaps else [self._nothing_counts()]
        lines += [f"reference   {note}" for note in self.notes]
        lines += [f"CAUTION     {hint}" for hint in self.hints]
        return "\n".join(lines)

    def _measured(self) -> list[str]:
        made = f", {self.interpolated} of them interpolated" if self.interpolated else ""
        lines = [
            f"CLiMB       ATE mean {self.measured_ate_mean_mm:.3f}, median {self.measured_ate_median_mm:.3f} mm (one "
            f"Sim(3) a submap; {counted(self.submaps, 'submap')}, {self.matched} of {self.reference} frames = "
            f"{100 * self.measured_tracked_fraction:.1f} % tracked{made})"
        ]
        lines += [
            f"RPE @{r.frames:<6} translation {r.translation_mm:.3f} mm, rotation {r.rotation_deg:.3f} deg "
            f"(means of {r.count} pairs)"
            if r.count
            else f"RPE @{r.frames:<6} no two frames of the reference that one submap poses are so far apart"
            for r in self.relative
        ]
        if self.failed:
            lines.append(
                f"score       {self.score:.3f}, lower is better; FAILED: no more than half of the frames are tracked, "
                f"and such a clip counts with ATE {FAILED_ATE_MM:g} mm, no frame tracked and time factor "
                f"{FAILED_TIME_FACTOR:g}"
            )
        elif self.score is None:
            lines.append("score       not given: the run does not say how long its frame loop took")
        else:
            lines.append(
                f"score       {self.score:.3f}, lower is better (time factor {self.time_factor:.3f} at "
                f"{self.seconds_per_frame:.4f} s a frame)"
            )
        if self.submaps_left_out:
            left_out = counted(self.submaps_left_out, "submap")
            lines.append(f"            not counted: {left_out} with too few frames of the reference, or without motion")
        return lines

    def _nothing_counts(self) -> str:
        none = "there is no submap with poses at frames"
        if self.submaps_left_out:
            none = f"none of {counted(self.submaps_left_out, 'submap')} has enough poses (--min-common) at frames"
        return (
            f"CLiMB       {none} of the reference, which has {self.reference} frames; by the protocol the clip has "
            f"FAILED: ATE {FAILED_ATE_MM:g} mm, score {FAILED_SCORE:g} (lower is better)"
        )


def climb_errors(
    submaps: Sequence[tuple[Frames, Array]],
    reference: tuple[Frames, Array],
    fps: float,
    seconds_per_frame: float | None = None,
    min_common: int = MIN_COMMON,
    interpolated: Sequence[NDArray[np.bool_]] | None = None,
) -> ClimbErrors:
    """Errors of submaps against a reference, each as frame numbers (N,) and world_from_camera (N,4,4), mm.

    A frame in several submaps belongs to the first of them. `fps` is the clip's, `seconds_per_frame` the frame loop's
    wall time. `interpolated`: of each submap, which of its poses (N,) are; they are judged as the others, and counted.
    Raises ReconstructionError for a reference of fewer than two poses.
    """
    frames, truth = np.asarray(reference[0], np.int64), checked_poses(reference[1])
    if len(frames) < 2 or len(np.unique(frames)) != len(frames):
        raise ReconstructionError(f"the reference needs two or more frames, each once; it has {len(frames)}")
    enough = [k for k, one in enumerate(submaps) if len(np.intersect1d(one[0], frames)) >= max(min_common, 3)]
    pairs = zip(enough, _matched([submaps[k] for k in enough], frames, truth), strict=True)
    moving = [(k, mine, true) for k, (mine, true) in pairs if len(true) >= 3 and _moves(mine[1]) and _moves(true)]
    measured = _Measured.of([_submap_errors(*mine, true) for _, mine, true in moving], len(frames))
    made = 0
    if interpolated is not None:
        made = sum(int(np.isin(mine[0], submaps[k][0][interpolated[k]]).sum()) for k, mine, _ in moving)
    failed = measured.tracked <= MIN_TRACKED
    factor = None if seconds_per_frame is None else 1 + 0.5 * float(np.clip(seconds_per_frame * fps - 1, 0, 1))
    ate, tracked, counted_factor = measured.ate_mean, measured.tracked, factor
    if failed or ate is None:
        ate, tracked, counted_factor = FAILED_ATE_MM, 0.0, FAILED_TIME_FACTOR
    return ClimbErrors(
        failed=failed,
        ate_mean_mm=ate,
        tracked_fraction=tracked,
        time_factor=counted_factor,
        score=None if counted_factor is None else ate * (1 + 0.5 * (1 - tracked)) * counted_factor,
        measured_ate_mean_mm=measured.ate_mean,
        measured_ate_median_mm=measured.ate_median,
        measured_tracked_fraction=measured.tracked,
        measured_time_factor=factor,
        relative=measured.relative,
        matched=measured.matched,
        interpolated=made,
        reference=len(frames),
        submaps=len(moving),
        submaps_left_out=len(submaps) - len(moving),
        seconds_per_frame=seconds_per_frame,
    )


def _moves(world_from_camera: Array) -> bool:
    return bool(np.ptp(world_from_camera[:, :3, 3], axis=0).any())


@dataclass(frozen=True)
class _Measured:
    """What submaps show, whatever the protocol makes of it; the errors are None where no submap counts."""

    matched: int
    tracked: float
    ate_mean: float | None
    ate_median: float | None
    relative: tuple[RelativeError, ...]

    @staticmethod
    def of(errors: list[tuple[Array, list[tuple[Array, Array]]]], reference: int) -> _Measured:
        distances = [distance for distance, _ in errors]
        matched = sum(map(len, distances))
        weights = np.array([len(distance) for distance in distances]) / max(matched, 1)
        mean = float(weights @ [distance.mean() for distance in distances]) if errors else None
        median = float(weights @ [np.median(distance) for distance in distances]) if errors else None
        relative = _averaged([motions for _, motions in errors], weights)
        return _Measured(matched, matched / reference, mean, median, relative)


def _matched(
    submaps: Sequence[tuple[Frames, Array]], frames: Frames, truth: Array
) -> list[tuple[tuple[Frames, Array], Array]]:
    """Of each submap the frames that the reference has and no submap before it, its poses and the true ones."""
    row_of, claimed, found = {int(frame): row for row, frame in enumerate(frames)}, set[int](), []
    for numbers, world_from_camera in submaps:
        world_from_camera = checked_poses(world_from_camera)
        rows = [k for k, frame in enumerate(numbers) if int(frame) in row_of and int(frame) not in claimed]
        claimed |= {int(numbers[k]) for k in rows}
        theirs = [row_of[int(numbers[k])] for k in rows]
        found.append(((np.asarray(numbers, np.int64)[rows], world_from_camera[rows]), truth[theirs]))
    return found


def _submap_errors(frames: Frames, world_from_camera: Array, truth: Array) -> tuple[Array, list[tuple[Array, Array]]]:
    """Distances (N,) of the centres after the submap's Sim(3); per interval, errors of motions in mm and degrees."""
    truth_from_estimate = umeyama(world_from_camera[:, :3, 3], truth[:, :3, 3], with_scale=True)
    scale = float(scale_of(truth_from_estimate))
    aligned = truth_from_estimate @ world_from_camera
    aligned[:, :3, :3] /= scale
    distance = np.linalg.norm(aligned[:, :3, 3] - truth[:, :3, 3], axis=1)
    row_of = {int(frame): row for row, frame in enumerate(frames)}
    motions = []
    for interval in INTERVALS:
        begin = [row for frame, row in row_of.items() if frame + interval in row_of]
        end = [row_of[int(frames[row]) + interval] for row in begin]
        true = np.linalg.inv(truth[begin]) @ truth[end]
        error = np.linalg.inv(true) @ (np.linalg.inv(aligned[begin]) @ aligned[end])
        turned = np.degrees(Rotation.from_matrix(error[:, :3, :3]).magnitude()) if begin else np.empty(0)
        motions.append((np.linalg.norm(error[:, :3, 3], axis=1), turned))
    return distance, motions


def _averaged(submaps: list[list[tuple[Array, Array]]], weights: Array) -> tuple[RelativeError, ...]:
    """Means over each submap's motions, averaged over submaps by their matched poses.

    A submap without two poses that far apart is left out, where the benchmark's evaluator counts it as without error.
    """
    errors = []
    for number, interval in enumerate(INTERVALS):
        some = [(motions[number], weight) for motions, weight in zip(submaps, weights) if len(motions[number][0])]
        total = sum(weight for _, weight in some)
        means = [
            sum(float(pair[which].mean()) * weight for pair, weight in some) / total if some else float("nan")
            for which in (0, 1)
        ]
        errors.append(RelativeError(interval, means[0], means[1], sum(len(pair[0]) for pair, _ in some)))
    return tuple(errors)
