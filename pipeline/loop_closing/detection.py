"""Loop detection: which keyframes show the same place, and the similarity between those that surely do.

A feature's depth is interpolated from the keyframe's sparse points, which are in the map's own scale. Completed depth
is off by about 2 %, so it only vetoes: a match is rejected where the two depth maps, laid on each other, contradict.
"""

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

from haustra.core.ray_table import RayTable, ray_table
from haustra.core.sim3 import scale_of
from haustra.core.threads import prefetched, single_threaded, workers
from pipeline.depth.completed_submap import CompletedSubmap
from pipeline.depth.sparse_depth import SparseDepthMaker
from pipeline.matching.keyframe_features import KeyframeFeatures, lift_features
from pipeline.matching.place_recognition import Pair, VisualWords, retrieve, retrieve_within
from pipeline.matching.sift import detect_sift
from pipeline.matching.sim3_match import Sim3Match, rows_of_pairs, verify_match
from reconstruction.fusion.depth_consistency import DepthView, agreement
from reconstruction.robust_pose_graph import sim3_information, with_common_error

MAX_SHARED = 5  # sparse points; keyframes that share more are tied by the map already
MAX_STEP = 8  # keyframes between compared ones; farther apart, two loops do not support each other (REACH of the graph)
PER_KEYFRAME = 3  # look-alikes tried for each keyframe
MIN_GAP = 5  # compared keyframes between two that may be a loop
REACH = 1.0  # scene units: median depths between cameras that should see the same
MAX_TURN = np.radians(40)  # between their views
ACROSS_PX, ALONG = 1.5, 0.03  # sigma of a matched feature's place, and of its depth as a share
COMMON = np.array([0.004, 0.004, 0.004, 0.01, 0.01, 0.01, 0.01])  # that all features of a match share
TOLERANCE, MAX_CONTRADICTED = 0.1, 0.5  # of the depth maps laid on each other
MIN_CONFIDENCE = 0.1  # of depth that may contradict

SubmapPair = tuple[CompletedSubmap, CompletedSubmap]


@dataclass(frozen=True)
class LoopClosure:
    """A verified match and its information (7,7) on `first_from_second`, in the second camera's tangent space."""

    match: Sim3Match
    information: NDArray[np.float64]


@dataclass(frozen=True)
class SubmapFeatures:
    """A submap and the features of those of its keyframes that are compared; `keyframe` is the row in the submap."""

    completed: CompletedSubmap
    features: list[KeyframeFeatures]
    rays: RayTable  # of the rectified pictures

    @property
    def rows(self) -> list[int]:
        return [features.keyframe for features in self.features]


def find_features(
    completed: CompletedSubmap, max_keyframes: int, known: dict[int, KeyframeFeatures] | None = None
) -> SubmapFeatures:
    """Features of evenly spaced keyframes of a submap: `max_keyframes`, or more where they would lie too far apart.

    known: features by the keyframe's row, which are not detected again.
    """
    return _features(completed, _compared(completed, max_keyframes), known or {}, ray_table(completed.camera))


def may_have_loops(completed: CompletedSubmap, max_keyframes: int) -> bool:
    """Whether there are keyframes of a submap that no sparse point ties; without them there is nothing to look for."""
    return bool(_untied(completed, _compared(completed, max_keyframes).tolist()).any())


def features_of_all(known: SubmapFeatures) -> SubmapFeatures:
    """Features of all keyframes of the submap; those that are known already are not detected again."""
    found = {features.keyframe: features for features in known.features}
    return _features(known.completed, known.completed.rows, found, known.rays)


def loop_candidates(seen: SubmapFeatures, words: VisualWords) -> list[Pair]:
    """Pairs of keyframes that no sparse point ties: those whose poses say that they overlap, and the most alike."""
    world_from_camera = seen.completed.submap.world_from_camera[seen.rows]
    turn = np.arccos(np.clip(world_from_camera[:, :3, 2] @ world_from_camera[:, :3, 2].T, -1, 1))
    apart = np.linalg.norm(world_from_camera[:, None, :3, 3] - world_from_camera[None, :, :3, 3], axis=2)
    similarity = words.similarities(seen.features, seen.features)
    untied = _untied(seen.completed, seen.rows)
    near = untied & (apart < REACH) & (turn < MAX_TURN)
    expected = retrieve_within(np.where(near, similarity, -np.inf), PER_KEYFRAME)
    return expected + retrieve_within(np.where(untied & ~near, similarity, -np.inf), 1)


def merge_candidates(first: SubmapFeatures, second: SubmapFeatures, words: VisualWords) -> list[Pair]:
    """Pairs of keyframes of two submaps, the most alike for each of the first."""
    return retrieve(words.similarities(first.features, second.features), PER_KEYFRAME)


def verify_loops(first: SubmapFeatures, second: SubmapFeatures, pairs: list[Pair], seed: int) -> list[LoopClosure]:
    """The loop closures of those pairs whose features agree and whose completed depths do not contradict."""
    rng = np.random.default_rng(seed)
    with single_threaded():
        alike = rows_of_pairs(first.features, second.features, pairs, drop_static=False)
        tried = [_verified(first, second, pair, rows, rng) for pair, rows in zip(pairs, alike, strict=True)]
    return [loop for loop in tried if loop is not None]


def _features(
    completed: CompletedSubmap, rows: NDArray[np.int64], known: dict[int, KeyframeFeatures], rays: RayTable
) -> SubmapFeatures:
    maker = SparseDepthMaker(completed.submap, completed.camera)

    def of_row(row: int) -> KeyframeFeatures:
        return known[row] if row in known else _lifted(completed, maker, rays, row)

    with single_threaded():
        features = list(prefetched(of_row, rows.tolist(), workers(), workers()))
    return SubmapFeatures(completed, features, rays)


def _lifted(completed: CompletedSubmap, maker: SparseDepthMaker, rays: RayTable, row: int) -> KeyframeFeatures:
    """Features of one rectified picture, within the hull of its sparse points."""
    mask = cv2.erode(completed.mask(row), np.ones((5, 5), np.uint8))
    found, sparse = detect_sift(completed.rgb(row), mask), maker.sparse_depth(row)
    return lift_features(row, found, rays, sparse.pixels, sparse.depth)


def _verified(
    first: SubmapFeatures, second: SubmapFeatures, pair: Pair, rows: NDArray[np.int64], rng: np.random.Generator
) -> LoopClosure | None:
    """rows (K,2): features of the pair that look alike."""
    here, there = first.features[pair[0]], second.features[pair[1]]
    match = verify_match(pair, here, there, (first.rays, second.rays), rng, rows)
    submaps, frames = (first.completed, second.completed), (here.keyframe, there.keyframe)
    if match is None or _contradict(submaps, frames, np.asarray(match.first_from_second, np.float64)):
        return None
    points = np.asarray(there.points[match.rows[:, 1]], np.float64)
    distance = np.linalg.norm(points, axis=1)
    across = ACROSS_PX / np.mean(second.completed.camera.focal) * distance
    return LoopClosure(match, with_common_error(sim3_information(points, across, ALONG * distance), COMMON))


def _contradict(submaps: SubmapPair, rows: tuple[int, int], first_from_second: NDArray[np.float64]) -> bool:
    """Whether either completed surface lies in the space that the other looks through, in most of the overlap."""
    scale = float(scale_of(first_from_second))
    rigid = first_from_second.copy()
    rigid[:3, :3] /= scale
    views = []
    for completed, row, factor, world_from_camera in zip(submaps, rows, (1.0, scale), (np.eye(4), rigid), strict=True):
        depth, confidence, _ = completed.depth(row)
        accepted = np.where(confidence < MIN_CONFIDENCE, np.float32(0), depth * np.float32(factor))
        views.append(DepthView(accepted, completed.camera.matrix, world_from_camera))
    for one, other in (views, views[::-1]):
        votes = agreement(one, [other], TOLERANCE, stride=4)
        if votes.voters == 0 or votes.contradicted_share > MAX_CONTRADICTED:
            return True
    return False


def _compared(completed: CompletedSubmap, max_keyframes: int) -> NDArray[np.int64]:
    step = max(1, min(-(-len(completed) // max_keyframes), MAX_STEP))
    return completed.rows[::step]


def _untied(completed: CompletedSubmap, rows: list[int]) -> NDArray[np.bool_]:
    """(P,P) whether two of the compared keyframes are far apart in time and share hardly a sparse point."""
    number = np.arange(len(rows))
    return (np.abs(number[:, None] - number) >= MIN_GAP) & (_shared(completed, rows) <= MAX_SHARED)


def _shared(completed: CompletedSubmap, rows: list[int]) -> NDArray[np.int64]:
    """(P,P) number of sparse points that two frames `rows` of the submap both observed."""
    number = np.full(len(completed.submap.frames), -1)
    number[rows] = np.arange(len(rows))
    frame, point = completed.submap.observations.T
    mine = number[frame] >= 0
    pairs = np.unique(np.column_stack([number[frame[mine]], point[mine]]), axis=0)
    shape = (len(rows), len(completed.submap.points))
    seen = csr_array((np.ones(len(pairs), np.int64), tuple(pairs.T)), shape=shape)
    return (seen @ seen.T).toarray()
