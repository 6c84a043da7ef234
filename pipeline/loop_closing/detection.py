"""Places seen twice: which keyframes look alike or should overlap, and the similarity between those that surely do.

A feature's depth is interpolated from the keyframe's sparse points, which are in the map's own scale; completed depth
is not, to about two percent. It has another say: both surfaces, laid on each other, must not contradict.
"""

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

from haustra.core.sim3 import scale_of
from pipeline.config import PoseGraphSettings
from pipeline.depth.completion_stage import DenseSubmap
from pipeline.depth.sparse_depth import SparseDepthMaker
from pipeline.input.frames import Frames, read_image
from pipeline.matching.keyframe_features import (
    MIN_POINTS,
    WORDS,
    inverse_depth_at,
    learn_words,
    match,
    rooted,
    sift,
    triangulated,
)
from pipeline.matching.place_recognition import vlad
from pipeline.matching.sim3_ransac import Side, refine_similarity, sure_similarity
from reconstruction.fusion.depth_consistency import DepthView, agreement
from reconstruction.pose_graph import tie_information, with_common_error

MAX_SHARED = 5  # sparse points; keyframes that share more are tied by the map already
MAX_STEP = 8  # keyframes between places; farther apart, two loops do not support each other (keyframe_graph.REACH)
MIN_GAP = 5  # keyframes between two that may be a loop
CONTRAST = 0.008  # of a feature; a fifth of OpenCV's
MIN_INLIER_SHARE = 0.4  # of the matches
REACH = 1.0  # scene units: median depths between cameras that should see the same
MAX_TURN = np.radians(40)  # between their views
ACROSS_PX, ALONG = 1.5, 0.03  # sigma of a matched feature's place, and of its depth as a share
COMMON = np.array([0.004, 0.004, 0.004, 0.01, 0.01, 0.01, 0.01])  # that all features of a link share
TOLERANCE, MAX_CONTRADICTED = 0.1, 0.5  # of the depth maps laid on each other
NOTHING: NDArray[np.int64] = np.zeros(0, np.int64)


@dataclass(frozen=True)
class Place:
    """A keyframe's features that have a depth: pixels (N,2), descriptors (N,128), points (N,3) in the camera's axes,
    sizes (N,) in pixels across."""

    row: int  # in the submap
    pixels: NDArray[np.float64]
    descriptors: NDArray[np.uint8]
    points: NDArray[np.float64]
    sizes: NDArray[np.float64]


@dataclass(frozen=True)
class Link:
    """Places (numbers in two lists) that one similarity of camera axes explains: `first_from_second` (4,4)."""

    first: int
    second: int
    first_from_second: NDArray[np.float64]
    information: NDArray[np.float64]  # (7,7)
    inliers: int
    rows: tuple[NDArray[np.int64], NDArray[np.int64]] = (NOTHING, NOTHING)  # of the matched features in the places


def find_places(part: DenseSubmap, frames: Frames, settings: PoseGraphSettings) -> list[Place]:
    """Evenly spaced keyframes of a submap, with their features."""
    maker = SparseDepthMaker(part.submap, part.camera, part.workspace.config.sparse)
    step = max(1, min(-(-len(part) // settings.max_places), MAX_STEP))
    return [_place(part, maker, int(row), frames) for row in part.rows[::step]]


def every_place(part: DenseSubmap, places: list[Place], frames: Frames) -> list[Place]:
    """All keyframes of the submap; those that are known already are not looked at again."""
    known = {place.row: place for place in places}
    maker = SparseDepthMaker(part.submap, part.camera, part.workspace.config.sparse)
    return [known.get(row) or _place(part, maker, row, frames) for row in map(int, part.rows)]


def loop_candidates(part: DenseSubmap, places: list[Place], settings: PoseGraphSettings, seed: int) -> list[tuple]:
    """Pairs of places that no sparse point ties: those whose poses say that they overlap, and the most alike."""
    poses = part.submap.world_from_camera[[place.row for place in places]]
    turn = np.arccos(np.clip(poses[:, :3, 2] @ poses[:, :3, 2].T, -1, 1))
    apart = np.linalg.norm(poses[:, None, :3, 3] - poses[None, :, :3, 3], axis=2)
    likeness = _likeness(places, places, seed)
    number = np.arange(len(places))
    open_ = (np.abs(number[:, None] - number) >= MIN_GAP) & (_shared(part, places) <= MAX_SHARED)
    near = open_ & (apart < REACH) & (turn < MAX_TURN)
    expected = _best(np.where(near, likeness, -np.inf), settings.per_place, True)
    return expected + _best(np.where(open_ & ~near, likeness, -np.inf), 1, True)


def join_candidates(first: list[Place], second: list[Place], settings: PoseGraphSettings, seed: int) -> list[tuple]:
    """Pairs of places of two submaps, most alike for each of the first."""
    return _best(_likeness(first, second, seed), settings.per_place, False)


def find_links(
    parts: tuple[DenseSubmap, DenseSubmap], places: tuple[list[Place], list[Place]], pairs: list[tuple], seed: int
) -> list[Link]:
    """The links of those pairs that hold."""
    rng = np.random.default_rng(seed)
    tried = [_link(parts, (places[0][i], places[1][j]), (i, j), rng) for i, j in pairs]
    return [link for link in tried if link is not None]


def _place(part: DenseSubmap, maker: SparseDepthMaker, row: int, frames: Frames) -> Place:
    """Features within the hull of the sparse points."""
    index = int(part.submap.frames[row])
    rgb = part.rectifier.image(read_image(part.workspace.image_path(index)))
    stored = cv2.imread(str(part.workspace.mask_path(index)), cv2.IMREAD_GRAYSCALE)
    mask = part.rectifier.mask(frames.content if stored is None else stored)
    found = sift(rgb, cv2.erode(mask, np.ones((5, 5), np.uint8)), CONTRAST)
    pixels = np.asarray(found.pixels, np.float64)
    sparse = maker.sparse_depth(row)
    inverse = inverse_depth_at(pixels, triangulated(sparse.pixels), sparse.depth)
    good = np.isfinite(inverse)
    plane = _on_plane(part, pixels[good])
    points = np.column_stack([plane, np.ones(len(plane))]) / inverse[good, None]
    return Place(row, pixels[good], found.descriptors[good], points, found.sizes[good].astype(np.float64))


def _link(
    parts: tuple[DenseSubmap, DenseSubmap],
    pair: tuple[Place, Place],
    numbers: tuple[int, int],
    rng: np.random.Generator,
) -> Link | None:
    first, second = pair
    if min(len(first.points), len(second.points)) < MIN_POINTS:
        return None
    pairs = match(rooted(first.descriptors), rooted(second.descriptors))
    sides = [
        Side(
            place.points[rows],
            np.eye(4),
            _on_plane(part, place.pixels[rows]),
            np.broadcast_to(np.diag(part.camera.focal), (len(rows), 2, 2)),
        )
        for part, place, rows in zip(parts, pair, pairs.T, strict=True)
    ]
    pixels = second.pixels[pairs[:, 1]], first.pixels[pairs[:, 0]]
    found = sure_similarity(sides[1], sides[0], pixels, parts[0].camera.width, rng, MIN_INLIER_SHARE)
    if found is None:
        return None
    start, inlier = found
    refined = refine_similarity(start, [(sides[1].at(inlier), sides[0].at(inlier))])
    first_from_second = np.asarray(refined, np.float64)
    if _contradict(parts, pair, first_from_second):
        return None
    points = np.asarray(sides[1].points[inlier], np.float64)
    distance = np.linalg.norm(points, axis=1)
    across = ACROSS_PX / np.mean(parts[1].camera.focal) * distance
    information = with_common_error(tie_information(points, across, ALONG * distance), COMMON)
    rows = pairs[inlier, 0], pairs[inlier, 1]
    return Link(*numbers, first_from_second, information, int(inlier.sum()), rows)


def _contradict(
    parts: tuple[DenseSubmap, DenseSubmap], pair: tuple[Place, Place], first_from_second: NDArray[np.float64]
) -> bool:
    """Whether either completed surface lies in the space that the other looks through, in most of the overlap."""
    scale = float(scale_of(first_from_second))
    rigid = first_from_second.copy()
    rigid[:3, :3] /= scale
    views = []
    for part, place, factor, pose in zip(parts, pair, (1.0, scale), (np.eye(4), rigid), strict=True):
        depth, confidence, _ = part.depth(place.row)
        believed = np.where(confidence < 0.1, np.float32(0), depth * np.float32(factor))
        views.append(DepthView(believed, part.camera.matrix, pose))
    for one, other in (views, views[::-1]):
        votes = agreement(one, [other], TOLERANCE, stride=4)
        if votes.voters == 0 or votes.contradicted_share > MAX_CONTRADICTED:
            return True
    return False


def _on_plane(part: DenseSubmap, pixels: NDArray[np.float64]) -> NDArray[np.float64]:
    return (pixels - np.array(part.camera.centre)) / np.array(part.camera.focal)


def _shared(part: DenseSubmap, places: list[Place]) -> NDArray[np.int64]:
    """(P,P) number of sparse points that two places both observed."""
    number = np.full(len(part.submap.frames), -1)
    number[[place.row for place in places]] = np.arange(len(places))
    frame, point = part.submap.observations.T
    mine = number[frame] >= 0
    pairs = np.unique(np.column_stack([number[frame[mine]], point[mine]]), axis=0)
    shape = (len(places), len(part.submap.points))
    seen = csr_array((np.ones(len(pairs), np.int64), tuple(pairs.T)), shape=shape)
    return (seen @ seen.T).toarray()


def _likeness(first: list[Place], second: list[Place], seed: int) -> NDArray[np.float32]:
    """(F,S) product of the places' signatures; minus infinity where one has too few features."""
    if not first or not second:
        return np.zeros((len(first), len(second)), np.float32)
    descriptors = np.concatenate([place.descriptors for place in first + second])
    enough = [np.array([len(p.points) >= MIN_POINTS for p in places], bool) for places in (first, second)]
    if len(descriptors) < WORDS:
        return np.full((len(first), len(second)), -np.inf, np.float32)
    words = learn_words(descriptors, seed)
    one, other = (np.stack([vlad(rooted(p.descriptors), words) for p in places]) for places in (first, second))
    return np.where(enough[0][:, None] & enough[1], one @ other.T, -np.inf).astype(np.float32)


def _best(likeness: NDArray[np.float32], per_place: int, one_list: bool) -> list[tuple]:
    """Pairs of each row's most alike columns; within one list, smaller number first and each pair once."""
    order = np.argsort(-likeness, axis=1, kind="stable")[:, :per_place]
    pairs = {(i, int(j)) for i in range(len(order)) for j in order[i] if np.isfinite(likeness[i, j])}
    return sorted({(min(pair), max(pair)) for pair in pairs} if one_list else pairs)
