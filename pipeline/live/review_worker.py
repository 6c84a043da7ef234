"""The process that looks back now and then: loops that correct the drift, and what of the wall was not seen.

It works on the map as it is at that moment, from the beginning each time, with the stages' own loop closing and measure
of coverage. It has the lowest priority: a review that takes long delays the next one, and nothing else.
"""

import os
from dataclasses import dataclass, field, replace
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from haustra.core.ray_table import ray_table
from haustra.core.se3 import Array, inverse
from haustra.core.sim3 import transform_points
from pipeline.config import LoopClosingSettings
from pipeline.depth.completed_submap import CompletedSubmap
from pipeline.depth.keyframe_store import DiskKeyframes
from pipeline.depth.rectification import make_rectifier
from pipeline.live.dense_worker import COARSER, LiveCamera, LiveSetup
from pipeline.live.surface_part import SurfacePart
from pipeline.loop_closing.close_loops import FAILURES
from pipeline.loop_closing.detection import (
    SubmapFeatures,
    find_features,
    loop_candidates,
    merge_candidates,
    verify_loops,
)
from pipeline.loop_closing.keyframe_pose_graph import close_loops, merge_by_loops
from pipeline.mapping.submap import Submap
from pipeline.matching.keyframe_features import KeyframeFeatures
from pipeline.matching.place_recognition import VisualWords
from pipeline.run_folder.workspace import Workspace
from pipeline.surface.coverage_stage import EDGE_VOXELS, LISTED_RADII, half_field_of_view, lens_field_of_view
from reconstruction.coverage.centreline import NotATube
from reconstruction.coverage.coverage import Coverage, measure_coverage
from reconstruction.mesh.open3d_import import import_open3d
from reconstruction.mesh.surface_mesh import SurfaceMesh

MOST_REMEMBERED = 400  # keyframes whose features are kept, 40 KiB each
MOST_MAPS = 4  # the current one, and those before it in which it may be recognised
MOST_LISTED = 4  # missed places, the nearest first


@dataclass(frozen=True)
class ReviewJob:
    """A map as it is now. keyframes: frame numbers whose depth is on disk; parts: of its surface; refused: numbers of
    maps that the light contradicted, which are joined to none."""

    map_number: int
    submap: Submap
    keyframes: tuple[int, ...]
    parts: tuple[SurfacePart, ...]
    refused: frozenset[int] = frozenset()


@dataclass(frozen=True)
class MissedPlace:
    """clock: hours in (0, 12], None where it goes all round; 12 is up in the picture where the stretch begins.
    diameter: of the circle of its area, in lumen diameters. frame: that came nearest. centre (3,): in the map."""

    clock: float | None
    diameter: float
    frame: int
    centre: tuple[float, float, float]
    seconds: float = 0.0  # time of that frame, which the session knows


@dataclass(frozen=True)
class Review:
    """corrections: by the number of a part the similarity (4,4) that moves it to where the latest keyframe says that it
    is, of earlier maps those that the current one was recognised in; loops: accepted. joined: earlier maps that were
    recognised. covered: share of the wall passed that was seen, None with the `reason` where that cannot be
    told. first, last: frames that were looked at; path: camera centres at the keyframes, corrected likewise. more:
    missed places beyond those listed."""

    map_number: int
    last: int
    first: int = -1
    path: tuple[tuple[float, float, float], ...] = ()
    corrections: dict[int, Array] = field(default_factory=dict)
    loops: int = 0
    joined: int = 0
    covered: float | None = None
    reason: str = ""
    missed: tuple[MissedPlace, ...] = ()
    more: int = 0
    first_s: float = 0.0  # times of these frames, which the session knows
    last_s: float = 0.0


@dataclass(frozen=True)
class _Reviewed:
    """A map as it was reviewed last. raw: as it was tracked, which its parts lie in; seen: bent by its loops."""

    raw: CompletedSubmap
    seen: SubmapFeatures
    parts: tuple[SurfacePart, ...]


class ReviewWork:
    """Reviews of one camera's maps."""

    def __init__(self, seen: LiveCamera, folder: Path, settings: LoopClosingSettings, seed: int) -> None:
        self.settings, self.seed, self.content = settings, seed, seen.content
        self.rectifier = make_rectifier(seen.camera)
        self._store = DiskKeyframes(Workspace(folder))
        self._known: dict[int, KeyframeFeatures] = {}  # by frame
        self._reviewed: dict[int, _Reviewed] = {}  # the latest maps, by number
        rays = ray_table(seen.camera)
        self._fields = rays, lens_field_of_view(rays, seen.content)

    def __call__(self, job: ReviewJob) -> Review:
        rows = np.flatnonzero(np.isin(job.submap.frames, job.keyframes))
        last = int(job.submap.frames[rows[-1]]) if len(rows) else -1
        if len(rows) < 2 or not job.parts:
            return Review(job.map_number, last, reason="too little was seen yet")
        completed = CompletedSubmap(job.submap, self.rectifier, rows, self._store)
        seen, loops = self._loops_closed(completed)
        corrections = corrections_of(completed, seen.completed, job.parts)
        for number in (job.refused | {job.map_number}) & self._reviewed.keys():
            del self._reviewed[number]
        before = self._found_again(job, completed, seen)
        self._reviewed[job.map_number] = _Reviewed(completed, seen, job.parts)
        while len(self._reviewed) > MOST_MAPS:
            del self._reviewed[next(iter(self._reviewed))]
        shown = _from_latest(corrections) | {number: move for found in before for number, move in found.items()}
        path = path_of(seen.completed, corrections[max(corrections)])
        first = int(job.submap.frames[0])
        review = Review(job.map_number, last, first, path, shown, loops, len(before))
        return self._covered(review, job, seen.completed, corrections)

    def _loops_closed(self, completed: CompletedSubmap) -> tuple[SubmapFeatures, int]:
        """The map, bent by its loops, with its features; and the number of loops."""
        frames = completed.submap.frames
        number = {int(frame): row for row, frame in enumerate(frames.tolist())}
        known = {
            number[frame]: replace(features, keyframe=number[frame])
            for frame, features in self._known.items()
            if frame in number
        }
        seen = find_features(completed, self.settings.max_keyframes, known)
        self._known = {int(frames[one.keyframe]): one for one in seen.features[-MOST_REMEMBERED:]}
        if not self.settings.enabled:
            return seen, 0
        try:
            candidates = loop_candidates(seen, VisualWords.of(seen.features, self.seed))
            loops = verify_loops(seen, seen, candidates, self.seed)
            closed = close_loops(seen, loops)
        except FAILURES:
            return seen, 0
        return replace(seen, completed=closed.completed), len(closed.accepted)

    def _found_again(self, job: ReviewJob, raw: CompletedSubmap, seen: SubmapFeatures) -> list[dict[int, Array]]:
        """Of each earlier map that shows the same places, surely: where its parts are, as the latest keyframe sees
        them."""
        found: list[dict[int, Array]] = []
        for earlier in self._reviewed.values() if self.settings.merge_submaps else ():
            try:
                words = VisualWords.of([*seen.features, *earlier.seen.features], self.seed)
                pairs = merge_candidates(seen, earlier.seen, words)
                merged = merge_by_loops((seen, earlier.seen), verify_loops(seen, earlier.seen, pairs, self.seed))
            except FAILURES:
                continue
            if merged is not None:
                latest = corrections_of(raw, merged, job.parts[-1:])[job.parts[-1].number]
                moved = corrections_of(earlier.raw, merged, earlier.parts)
                found.append({part: inverse_sim3(latest) @ move for part, move in moved.items()})
        return found

    def _covered(self, review: Review, job: ReviewJob, moved: CompletedSubmap, corrections: dict[int, Array]) -> Review:
        rays, field_of_view = self._fields
        world_from_camera = moved.submap.world_from_camera
        try:
            half = half_field_of_view(rays, self.rectifier.camera, self.content)
            edge = EDGE_VOXELS / COARSER * max(part.voxel for part in job.parts)
            mesh = _joined([(part, corrections[part.number]) for part in job.parts])
            coverage = measure_coverage(mesh, world_from_camera, half, "scene units", edge, field_of_view)
        except NotATube as reason:
            return replace(review, reason=str(reason))
        latest_from_map = inverse_sim3(corrections[max(corrections)])
        missed = _missed(coverage, job.submap.frames, latest_from_map)
        listed = missed[:MOST_LISTED]
        return replace(review, covered=coverage.share, missed=listed, more=len(missed) - len(listed))


def corrections_of(before: CompletedSubmap, after: CompletedSubmap, parts: tuple[SurfacePart, ...]) -> dict[int, Array]:
    """For each part the similarity (4,4) by which its middle keyframe moved, with its depth; both submaps pose it."""
    found = {}
    for part in parts:
        middle = sum(part.frames) / 2
        row = int(before.rows[np.abs(before.submap.frames[before.rows] - middle).argmin()])
        there = int(np.searchsorted(after.submap.frames, before.submap.frames[row]))
        scale = _scale(after, there) / _scale(before, row)
        similar = after.submap.world_from_camera[there].copy()
        similar[:3, :3] *= scale
        found[part.number] = similar @ inverse(before.submap.world_from_camera[row])
    return found


def path_of(completed: CompletedSubmap, latest: Array) -> tuple[tuple[float, float, float], ...]:
    """Camera centres at the keyframes of a corrected submap, with the latest part where it is."""
    centres = transform_points(inverse_sim3(latest), completed.submap.world_from_camera[completed.rows][:, :3, 3])
    return tuple((x, y, z) for x, y, z in np.round(centres, 5).tolist())


def _scale(completed: CompletedSubmap, row: int) -> float:
    """Of a frame's depth over what is stored."""
    return 1.0 if completed.depth_scale is None else float(completed.depth_scale[row])


def inverse_sim3(similarity: Array) -> Array:
    """Inverse of a similarity (4,4)."""
    return np.asarray(np.linalg.inv(similarity))


def _from_latest(corrections: dict[int, Array]) -> dict[int, Array]:
    """The same with the latest part where it is: what grows must not jump."""
    latest = inverse_sim3(corrections[max(corrections)])
    return {number: latest @ correction for number, correction in corrections.items()}


def _joined(parts: list[tuple[SurfacePart, Array]]) -> SurfaceMesh:
    offsets = np.cumsum([0] + [len(part.vertices) for part, _ in parts])
    vertices = np.concatenate([transform_points(move, part.vertices.astype(np.float64)) for part, move in parts])
    faces = np.concatenate([part.faces.astype(np.int64) + at for (part, _), at in zip(parts, offsets[:-1])])
    return SurfaceMesh.from_triangles(vertices, faces)


def _missed(coverage: Coverage, frames: NDArray[np.int64], latest_from_map: Array) -> tuple[MissedPlace, ...]:
    """Those worth listing, the nearest to the end of the path first."""
    worth = [region for region in coverage.regions if region.diameter >= LISTED_RADII * coverage.radius]
    worth.sort(key=lambda region: -region.frame)
    places = []
    for region in worth:
        x, y, z = transform_points(latest_from_map, np.array([region.centre]))[0].tolist()
        diameter = region.diameter / (2 * coverage.radius)
        places.append(MissedPlace(region.clock, diameter, int(frames[region.frame]), (x, y, z)))
    return tuple(places)


class ReviewWorker:
    """What the process calls with each job: the camera once, then maps. On one thread: processors belong to others."""

    def __init__(self, setup: LiveSetup) -> None:
        cv2.setNumThreads(1)
        os.environ["OMP_NUM_THREADS"] = "1"  # Open3D reads it when it is loaded
        import_open3d()  # before the film begins: it takes seconds
        self._setup = setup
        self._work: ReviewWork | None = None

    def __call__(self, job: LiveCamera | ReviewJob) -> Review | None:
        if isinstance(job, LiveCamera):
            self._work = ReviewWork(job, self._setup.folder, self._setup.config.loop_closing, self._setup.config.seed)
            return None
        assert self._work is not None
        return self._work(job)
