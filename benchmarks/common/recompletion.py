"""Depth of a run's keyframes completed once more, from other sparse points than the run had."""

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from benchmarks.common.living_truth import true_depth
from haustra.core.errors import HaustraError
from haustra.core.progress import no_progress
from haustra.core.sim3 import scale_of
from pipeline.depth.completed_submap import CompletedSubmap
from pipeline.depth.completion_stage import MIN_POINTS, inside_of
from pipeline.depth.keyframe_store import KeyframeStore
from pipeline.depth.preparation import load_completer
from pipeline.depth.sparse_depth import SparseDepth, SparseDepthMaker
from pipeline.finished_run import Run
from pipeline.frontend.odometry.frame_io import frame_features, frame_reader
from pipeline.frontend.point_refinement import refine_points
from pipeline.mapping.feature_triangulation import triangulate_again
from reconstruction.evaluation.trajectory_io import read_tum
from reconstruction.evaluation.trajectory_metrics import align_poses

Depth = NDArray[np.float32]
Points = Callable[[int], SparseDepth]  # of the frame at a row of the submap


@dataclass(frozen=True)
class MemoryKeyframes:
    """Pictures as another store has them; depth and confidence of a few keyframes in memory."""

    pictures: KeyframeStore
    depths: dict[int, Depth] = field(default_factory=dict)
    confidences: dict[int, Depth] = field(default_factory=dict)

    def rgb(self, frame: int) -> NDArray[np.uint8]:
        return self.pictures.rgb(frame)

    def mask(self, frame: int) -> NDArray[np.uint8]:
        return self.pictures.mask(frame)

    def depth(self, frame: int) -> Depth:
        return self.depths[frame].copy()

    def confidence(self, frame: int) -> Depth:
        return self.confidences[frame].copy()


def completed_from(made: Run, completed: CompletedSubmap, points: Points) -> CompletedSubmap:
    """The submap with depth from these points, as the run's network completes it, corrected by them alone and not by
    the neighbours' pictures; without keyframes that have too few points.

    HaustraError where closed loops moved its depths, which the points then no longer fit, or no keyframe is left.
    """
    if completed.depth_scale is not None:
        raise HaustraError(
            f"{made.folder}: closed loops moved the depth, so that it cannot be completed from points again"
        )
    config, frames = made.workspace.config, completed.submap.frames
    completer = load_completer(config.model, config.device, config.depth.iterations)
    content = completed.rectifier.mask(made.frames.content)
    inside, store, kept = inside_of(content), MemoryKeyframes(completed.store), []
    for row in map(int, completed.rows):
        sparse = points(row)
        if len(sparse.depth) < MIN_POINTS:
            continue
        depth, confidence = completer(completed.rgb(row), *sparse.maps(*content.shape))
        store.depths[int(frames[row])] = np.where(inside, depth, np.float32(0))
        store.confidences[int(frames[row])] = np.where(inside, confidence, np.float32(0))
        kept.append(row)
    if not kept:
        raise HaustraError(f"{made.folder}: no keyframe has {MIN_POINTS} points to complete its depth from")
    return replace(completed, rows=np.array(kept, np.int64), store=store)


def from_true_points(film: Path, made: Run) -> CompletedSubmap:
    """Completed from the run's own points, each put at the true depth of its pixel in that frame, which takes perfect
    knowledge of the motion; with true poses, by which neighbours are then compared."""
    completed = made.completed_submaps[0]
    maker = SparseDepthMaker(completed.submap, completed.camera)
    poses, mm_per_unit = _true_poses(film, completed)

    def points(row: int) -> SparseDepth:
        found = maker.sparse_depth(row)
        truth = true_depth(film, int(completed.submap.frames[row]), completed.rectifier)
        x, y = np.floor(found.pixels).astype(int).T
        depth, known = truth[y, x] / mm_per_unit, truth[y, x] > 0
        return SparseDepth(found.pixels[known], depth[known], found.error[known])

    again = completed_from(made, completed, points)
    return replace(again, submap=replace(again.submap, world_from_camera=poses))


def from_true_poses(film: Path, made: Run) -> CompletedSubmap:
    """Completed from the features that the true poses triangulate, found and refined as the run finds its own: what a
    still map has at best where the wall moves. Without corners that were tracked: those lie where the run's poses have
    them."""
    completed = made.completed_submaps[0]
    (poses, _), camera, workspace = _true_poses(film, completed), made.frames.camera, made.workspace
    motion_px = workspace.config.front_end_settings.odometry.keyframe_motion * camera.width
    with frame_features(workspace) as features:
        submap = replace(completed.submap, world_from_camera=poses).without_points(completed.submap.is_klt)
        found = triangulate_again(submap, camera, motion_px, features, no_progress)
    refined = refine_points(submap if found is None else found.submap, camera, frame_reader(workspace))
    moved = replace(completed, submap=refined)
    return completed_from(made, moved, SparseDepthMaker(refined, completed.camera).sparse_depth)


def _true_poses(film: Path, completed: CompletedSubmap) -> tuple[NDArray[np.float64], float]:
    """(N,4,4) of the submap's frames, in its axes and unit, and how many mm that unit is."""
    truth = read_tum(film / "trajectory.txt")[1][completed.submap.frames]
    truth_from_run = align_poses(completed.submap.world_from_camera, truth)
    mm_per_unit = float(scale_of(truth_from_run))
    poses = np.linalg.inv(truth_from_run) @ truth
    poses[:, :3, :3] *= mm_per_unit
    return np.asarray(poses), mm_per_unit
