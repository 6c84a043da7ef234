"""Stage 3b: every keyframe's depth once more, by what the keyframes around it show.

A keyframe's points are few and noisy, and what is plain wall passes their noise on. Its neighbours saw the same wall
from elsewhere. Their pictures say where patches of this one fit them (`photometric_points.py`): points by which its
depth is corrected, after its own. On request, their first depths are carried over as points with errors before that
(`reconstruction.fusion.depth_transfer`), and the network refines the first depth with them. First depths are not
corrected, and stay on disk until all are refined, so that no refined one depends on another and a stopped run goes on
to the same bytes.
"""

from __future__ import annotations

import shutil
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import replace
from functools import lru_cache, partial
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from completion.confidence import error_from_confidence
from completion.inference.kriging import explained_share, towards_points
from haustra.core.progress import Progress, SilentProgress
from haustra.core.threads import prefetched, single_threaded, workers
from pipeline.config import DepthSettings
from pipeline.depth.completed_submap import CompletedSubmap
from pipeline.depth.keyframe_store import REFINED, DiskKeyframes
from pipeline.depth.photometric_points import View, photometric_points, view_of
from pipeline.depth.preparation import LoadCompleter
from pipeline.depth.sensor.joined_points import points_of
from pipeline.depth.sparse_depth import SparseDepth
from pipeline.input.frames import Frames
from pipeline.input.sensor.sensor_depth import SensorDepth, open_sensor
from pipeline.run_folder.malloc import freed_memory_kept
from pipeline.run_folder.stage import load_or_make
from pipeline.run_folder.workspace import Workspace
from reconstruction.fusion.depth_transfer import UnsureView, transferred

if TYPE_CHECKING:
    from completion.inference.completer import DepthCompleter

STAGE = REFINED
STEPS = (1, 2, 4, 8)  # keyframes before and after that are asked: near ones overlap, far ones err otherwise
CELL = 1 / 36  # of the width, side of a cell with one carried point: 9 px of 320
MAX_ERROR = 0.3  # expected relative error of a pixel that is carried over
MOST_POINTS = 1000  # own and photometric ones, by which a keyframe's depth is corrected
LEAST_CONFIDENCE = 1 / 510  # half of its smallest step on disk

Image = NDArray[np.float32]


def has_second_pass(settings: DepthSettings, sensor: SensorDepth | None) -> bool:
    """Whether the keyframes' depths are refined once all are complete. sensor: the run's, if it has one."""
    return settings.multiview or _asks_patches(settings, sensor)


def _asks_patches(settings: DepthSettings, sensor: SensorDepth | None) -> bool:
    """Whether patches correct the depth. Not where a sensor's points are used: they hold it better."""
    return settings.photometric and (sensor is None or sensor.settings.points == "none")


def refine_depth(
    frames: Frames,
    completed: list[CompletedSubmap],
    load_completer: LoadCompleter,
    settings: DepthSettings,
    workspace: Workspace,
    progress: Progress,
) -> list[CompletedSubmap]:
    """The submaps with refined depth; as they are where no first depth is left to be refined: without a second pass,
    or in a run of a version that had none."""
    if not (workspace.is_done(STAGE) or workspace.first_depth.is_dir()):
        return completed

    def make() -> None:
        completer = load_completer() if settings.multiview else None
        sensor = open_sensor(workspace, frames.camera.width)
        _refine_all(frames, completed, completer, sensor, _asks_patches(settings, sensor), workspace, progress)

    refined = DiskKeyframes(workspace)
    return load_or_make(workspace, STAGE, lambda: [replace(one, store=refined) for one in completed], make)


def _refine_all(
    frames: Frames,
    completed: list[CompletedSubmap],
    completer: DepthCompleter | None,
    sensor: SensorDepth | None,
    photometric: bool,
    workspace: Workspace,
    progress: Progress,
) -> None:
    store, at_once = DiskKeyframes(workspace), workers() if completer is None else completer.at_once
    done, total = 0, sum(len(one) for one in completed)
    with ExitStack() as stack:
        advance = stack.enter_context(progress.bar("depth from several views", total))
        stack.enter_context(freed_memory_kept())
        stack.enter_context(single_threaded() if completer is None else completer.working_side_by_side())
        for one in completed:
            # Those that the first depth was completed from; what there is to say of them was said then.
            points = points_of(one, frames, sensor, SilentProgress())
            refinement = _Refinement(one, points, completer, photometric, store)
            for _ in prefetched(refinement, range(len(one)), at_once, at_once):
                done += 1
                advance(done)
    workspace.finish(STAGE)
    shutil.rmtree(workspace.first_depth, ignore_errors=True)


class _Refinement:
    """Of the keyframes of a submap; called with the place of one, from several threads."""

    def __init__(
        self,
        completed: CompletedSubmap,
        points: Callable[[int], SparseDepth],
        completer: DepthCompleter | None,
        photometric: bool,
        store: DiskKeyframes,
    ) -> None:
        self.completed, self.points, self.photometric, self.store = completed, points, photometric, store
        self.completer = completer if completer is not None and completer.can_refine else None
        # A cached method would hold this object, and it the caches with their pictures, until garbage collection.
        held = lru_cache(2 * max(STEPS) + 2 + workers())
        self._unsure_view, self._view = held(partial(_unsure_view, completed)), held(partial(_view, completed))

    def __call__(self, place: int) -> None:
        """Refine one keyframe and write it, unless that was done before the run was stopped."""
        row = int(self.completed.rows[place])
        index = int(self.completed.submap.frames[row])
        if self.store.has_depth(index):
            return
        depth, confidence, _ = self.completed.depth(row)
        sparse, error = self.points(row).maps(*depth.shape)
        if self.completer is not None:
            carried = self._with_carried(place, sparse, error)
            refined, doubt = self.completer.refine(self.completed.rgb(row), *carried, depth, confidence)
            known, nothing = depth > 0, np.float32(0)
            depth, confidence = np.where(known, refined, nothing), np.where(known, doubt, nothing)
        self.store.write_depth(index, self._corrected(place, depth, confidence, sparse, error), confidence)

    def _corrected(self, place: int, depth: Image, confidence: Image, sparse: Image, error: Image) -> Image:
        """Depth (H,W) corrected by its own points (H,W), then by those and photometric ones. Whether the wall moved is
        judged once, before that, and by its own points, whose errors are known better."""
        expected = error_from_confidence(confidence, LEAST_CONFIDENCE)
        share = explained_share(depth, expected, sparse, error)
        depth = towards_points(depth, expected, sparse, error, share=share)
        if share == 0 or not self.photometric:
            return depth
        points = self._with_photometric(place, depth, sparse, error)
        return towards_points(depth, expected, *points, MOST_POINTS, share)

    def _with_carried(self, place: int, sparse: Image, error: Image) -> tuple[Image, Image]:
        """Points (H,W) and their errors, and where there is none, those that neighbours' depths give."""
        others = [self._unsure_view(other) for other in self._around(place)]
        pose = self.completed.submap.world_from_camera[self.completed.rows[place]]
        cell = max(2, round(CELL * sparse.shape[1]))
        carried, carried_error = transferred(sparse.shape, self.completed.camera.matrix, pose, others, cell)
        return np.where(sparse > 0, sparse, carried), np.where(sparse > 0, error, carried_error)

    def _with_photometric(self, place: int, depth: Image, sparse: Image, error: Image) -> tuple[Image, Image]:
        """Points (H,W) and their errors, and where there is none, those that neighbours' pictures confirm."""
        others = [self._view(other) for other in self._around(place)]
        own = replace(self._view(place), depth=depth)
        fitted, fitted_error = photometric_points(own, others, self.completed.camera.matrix).maps(*depth.shape)
        return np.where(sparse > 0, sparse, fitted), np.where(sparse > 0, error, fitted_error)

    def _around(self, place: int) -> list[int]:
        near = (place + sign * step for step in STEPS for sign in (-1, 1))
        return [other for other in near if 0 <= other < len(self.completed)]


def _unsure_view(completed: CompletedSubmap, place: int) -> UnsureView:
    """The first depth of a keyframe, without what is too unsure to be carried over."""
    depth, confidence, world_from_camera = completed.depth(int(completed.rows[place]))
    error = error_from_confidence(confidence, LEAST_CONFIDENCE)
    sure = np.where(error <= MAX_ERROR, depth, np.float32(0))
    return UnsureView(sure, error, completed.camera.matrix, world_from_camera)


def _view(completed: CompletedSubmap, place: int) -> View:
    row = int(completed.rows[place])
    depth, _, world_from_camera = completed.depth(row)
    return view_of(completed.rgb(row), completed.mask(row), depth, world_from_camera)
