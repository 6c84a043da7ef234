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
FAILED_ATE_MM, FAILED_SCORE = 25.0, 56.25  # of a clip that does not: 25 mm, no frame tracked, the worst time factor


@dataclass(frozen=True)
class RelativeError:
    """Mean error of the motion over an interval of frames, within submaps; NaN where no two poses are so far apart."""

    frames: int
    translation_mm: float
    rotation_deg: float
    count: int  # pairs of poses


@dataclass(frozen=True)
class ClimbErrors:
    """CLiMB's figures of one clip. `time_factor` and `score` are None where the time of the frame loop is unknown."""

    ate_mean_mm: float  # mean distance of camera centres; of each submap after its Sim(3), weighted by matched poses
    ate_median_mm: float  # likewise, of the submaps' medians
    relative: tuple[RelativeError, ...]
    tracked_fraction: float  # matched poses over frames of the reference
    matched: int
    reference: int
    submaps: int  # that count
    submaps_left_out: int  # that share too few frames with the reference, or do not move
    seconds_per_frame: float | None
    time_factor: float | None
    score: float | None  # mm-like, lower is better

    def to_dict(self) -> dict[str, Any]:
        return asdict(self)

    def __str__(self) -> str:
        if not self.submaps:
            return self._nothing_counts()
        lines = [
            f"CLiMB       ATE mean {self.ate_mean_mm:.3f}, median {self.ate_median_mm:.3f} mm (one Sim(3) a submap; "
            f"{counted(self.submaps, 'submap')}, {self.matched} of {self.reference} frames = "
            f"{100 * self.tracked_fraction:.1f} % tracked)"
        ]
        lines += [
            f"RPE @{r.frames:<6} translation {r.translation_mm:.3f} mm, rotation {r.rotation_deg:.3f} deg "
            f"(means of {r.count} pairs)"
            if r.count
            else f"RPE @{r.frames:<6} no two frames of the reference that one submap poses are so far apart"
            for r in self.relative
        ]
        if self.score is None:
            lines.append("score       not given: the run does not say how long its frame loop took")
        else:
            failed = (
                "" if self.tracked_fraction > MIN_TRACKED else "; FAILED: no more than half of the frames are tracked"
            )
            lines.append(
                f"score       {self.score:.3f}, lower is better (time factor {self.time_factor:.3f} at "
                f"{self.seconds_per_frame:.4f} s a frame{failed})"
            )
        if self.submaps_left_out:
            left_out = counted(self.submaps_left_out, "submap")
            lines.append(f"            not counted: {left_out} with too few frames of the reference, or without motion")
        return "\n".join(lines)

    def _nothing_counts(self) -> str:
        score = "" if self.score is None else f", score {FAILED_SCORE:g} (lower is better)"
        none = "there is no submap with poses at frames"
        if self.submaps_left_out:
            none = f"none of {counted(self.submaps_left_out, 'submap')} has enough poses (--min-common) at frames"
        return (
            f"CLiMB       {none} of the reference, which has {self.reference} frames; by the protocol the clip has "
            f"FAILED: ATE {FAILED_ATE_MM:g} mm{score}"
        )


def climb_errors(
    submaps: Sequence[tuple[Frames, Array]],
    reference: tuple[Frames, Array],
    fps: float,
    seconds_per_frame: float | None = None,
    min_common: int = MIN_COMMON,
) -> ClimbErrors:
    """Errors of submaps against a reference, each as frame numbers (N,) and world_from_camera (N,4,4), mm.

    A frame in several submaps belongs to the first of them. `fps` is the clip's, `seconds_per_frame` the frame loop's
    wall time. Raises ReconstructionError for a reference of fewer than two poses.
    """
    frames, truth = np.asarray(reference[0], np.int64), checked_poses(reference[1])
    if len(frames) < 2 or len(np.unique(frames)) != len(frames):
        raise ReconstructionError(f"the reference needs two or more frames, each once; it has {len(frames)}")
    long_enough = [one for one in submaps if len(np.intersect1d(one[0], frames)) >= max(min_common, 3)]
    counted = [
        _submap_errors(*mine, true)
        for mine, true in _matched(long_enough, frames, truth)
        if len(true) >= 3 and all(np.ptp(poses[:, :3, 3], axis=0).any() for poses in (mine[1], true))
    ]
    matched = sum(len(distance) for distance, _ in counted)
    tracked = matched / len(frames)
    weights = np.array([len(distance) for distance, _ in counted]) / max(matched, 1)
    ate = float(weights @ [distance.mean() for distance, _ in counted]) if counted else FAILED_ATE_MM
    median = float(weights @ [np.median(distance) for distance, _ in counted]) if counted else FAILED_ATE_MM
    factor = None if seconds_per_frame is None else 1 + 0.5 * float(np.clip(seconds_per_frame * fps - 1, 0, 1))
    score = None if factor is None else ate * (1 + 0.5 * (1 - tracked)) * factor
    if score is not None and tracked <= MIN_TRACKED:
        score = FAILED_SCORE
    relative = _averaged([motions for _, motions in counted], weights)
    left_out = len(submaps) - len(counted)
    return ClimbErrors(
        ate_mean_mm=ate,
        ate_median_mm=median,
        relative=relative,
        tracked_fraction=tracked,
        matched=matched,
        reference=len(frames),
        submaps=len(counted),
        submaps_left_out=left_out,
        seconds_per_frame=seconds_per_frame,
        time_factor=factor,
        score=score,
    )


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
