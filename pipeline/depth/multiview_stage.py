"""Stage 3b: every keyframe's depth once more, from its own points and from what its neighbours' depths say about it.

A keyframe's points are few and noisy, and what is plain wall passes their noise on. Its neighbours saw the same wall
from elsewhere: their first depths are carried over as points with errors (`reconstruction.fusion.depth_transfer`), and
the network refines the keyframe's own first depth with them. First depths stay on disk until all are refined, so that
no refined one depends on another and a stopped run goes on to the same bytes.
"""

from __future__ import annotations

import shutil
from collections.abc import Callable
from dataclasses import replace
from functools import lru_cache
from typing import TYPE_CHECKING

import numpy as np

from completion.confidence import error_from_confidence
from completion.inference.kriging import towards_points
from haustra.core.progress import Progress, SilentProgress
from pipeline.config import DepthSettings
from pipeline.depth.completed_submap import CompletedSubmap
from pipeline.depth.keyframe_store import REFINED, DiskKeyframes
from pipeline.depth.preparation import LoadCompleter
from pipeline.depth.sensor.joined_points import points_of
from pipeline.depth.sparse_depth import SparseDepth
from pipeline.input.frames import Frames
from pipeline.input.sensor.sensor_depth import open_sensor
from pipeline.run_folder.malloc import freed_memory_kept
from pipeline.run_folder.stage import load_or_make
from pipeline.run_folder.workspace import Workspace
from reconstruction.fusion.depth_transfer import UnsureView, transferred

if TYPE_CHECKING:
    from completion.inference.completer import DepthCompleter

STAGE = REFINED
STEPS = (1, 2, 4, 8)  # keyframes before and after that are asked: near ones overlap, far ones err otherwise
CELL = 1 / 36  # of the width, side of a cell with one point: 9 px of 320
MAX_ERROR = 0.3  # expected relative error of a pixel that is carried over
LEAST_CONFIDENCE = 1 / 510  # half of its smallest step on disk
CACHED = 2 * max(STEPS) + 2  # first depths in memory


def refine_depth(
    frames: Frames,
    completed: list[CompletedSubmap],
    load_completer: LoadCompleter,
    settings: DepthSettings,
    workspace: Workspace,
    progress: Progress,
) -> list[CompletedSubmap]:
    """The submaps with refined depth; without `multiview`, or with a network of one iteration, as they are."""
    if not settings.multiview:
        return completed

    def make() -> None:
        _refine_all(frames, completed, load_completer(), workspace, progress)

    refined = DiskKeyframes(workspace)
    return load_or_make(workspace, STAGE, lambda: [replace(one, store=refined) for one in completed], make)


def _refine_all(
    frames: Frames,
    completed: list[CompletedSubmap],
    completer: DepthCompleter,
    workspace: Workspace,
    progress: Progress,
) -> None:
    store, sensor = DiskKeyframes(workspace), open_sensor(workspace, frames.camera.width)
    done, total = 0, sum(len(one) for one in completed)
    with freed_memory_kept(), progress.bar("depth from several views", total) as advance:
        for one in completed:
            # Those that the first depth was completed from; what there is to say of them was said then.
            points, first = points_of(one, frames, sensor, SilentProgress()), _first_views(one)
            for place in range(len(one)):
                _refine(one, place, points, first, completer, store)
                done += 1
                advance(done)
    workspace.finish(STAGE)
    shutil.rmtree(workspace.first_depth, ignore_errors=True)


def _first_views(completed: CompletedSubmap) -> Callable[[int], UnsureView]:
    """The first depth of the keyframe at a place among the submap's rows, without what is too unsure; the last ones
    asked for are kept."""

    @lru_cache(CACHED)
    def view(place: int) -> UnsureView:
        depth, confidence, world_from_camera = completed.depth(int(completed.rows[place]))
        error = error_from_confidence(confidence, LEAST_CONFIDENCE)
        sure = np.where(error <= MAX_ERROR, depth, np.float32(0))
        return UnsureView(sure, error, completed.camera.matrix, world_from_camera)

    return view


def _refine(
    completed: CompletedSubmap,
    place: int,
    points: Callable[[int], SparseDepth],
    first: Callable[[int], UnsureView],
    completer: DepthCompleter,
    store: DiskKeyframes,
) -> None:
    """Refine one keyframe and write it, unless that was done before the run was stopped."""
    row = int(completed.rows[place])
    index = int(completed.submap.frames[row])
    if store.has_depth(index):
        return
    depth, confidence, world_from_camera = completed.depth(row)
    refined, doubt = depth, confidence
    if completer.can_refine:
        near = (place + sign * step for step in STEPS for sign in (-1, 1))
        others = [first(other) for other in near if 0 <= other < len(completed)]
        cell = max(2, round(CELL * depth.shape[1]))
        carried, carried_error = transferred(depth.shape, completed.camera.matrix, world_from_camera, others, cell)
        sparse, error = points(row).maps(*depth.shape)
        measured = sparse > 0
        known = np.where(measured, sparse, carried), np.where(measured, error, carried_error)
        refined, doubt = completer.refine(completed.rgb(row), *known, depth, confidence)
        refined = towards_points(refined, error_from_confidence(doubt, LEAST_CONFIDENCE), sparse, error)
    nothing = np.float32(0)
    store.write_depth(index, np.where(depth > 0, refined, nothing), np.where(depth > 0, doubt, nothing))
