"""Bundle adjustment of a submap over its loops: SIFT features of all keyframes, matched along the path and over loops.

KLT corners drift along the direction of motion and bend the scale of the path, the same on the way out and back, so
that no loop shows it. Features detected anew in each keyframe do not drift; only they take part. The pose graph's
solution is where the adjustment starts.
"""

from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array

from haustra.core.sim3 import scale_of
from pipeline.depth.completed_submap import CompletedSubmap
from pipeline.loop_closing.detection import SubmapFeatures, features_of_all
from pipeline.loop_closing.keyframe_pose_graph import LoopClosingResult, deform, nodes_of
from pipeline.mapping.final_adjustment import widest_narrow
from pipeline.mapping.map_adjustment import FINAL_DAMPING, FINAL_TOLERANCE
from pipeline.matching.descriptor_matching import match_descriptors
from pipeline.matching.feature_tracks import FeatureTracks, both_narrow, join_features
from pipeline.matching.keyframe_features import KeyframeFeatures
from pipeline.matching.sim3_match import Sim3Match
from pipeline.optimization.bundle_adjustment import Bundle, adjust
from reconstruction.robust_pose_graph import Edge, chi2

AHEAD = 12  # keyframes with which each one's features are compared: longer tracks drift less (docs/lab/loop_tracks.md)
MAX_OFF_PX = 6.0  # of a feature from where the map has it, in another keyframe
LOSS_SCHEDULE = ((5.0, 12.0), (2.0, 5.0), (0.8, 2.0), (0.8, 2.0))  # loss and largest error that is kept, pixels
ITERATIONS = 25
MIN_FEATURES = 20  # features of a keyframe in the bundle; another keyframe follows those beside it
MIN_TYPICAL_FEATURES = (
    150  # features of the median keyframe; pale films have about 100 and gain nothing, others over 300
)
MIN_SHARED = 12  # features that hold consecutive keyframes of the bundle together
MAX_GAP = 5  # keyframes in a row that may follow

Array = NDArray[np.float64]
Matches = tuple[list[tuple[int, int]], list[NDArray[np.int64]]]  # pairs of keyframes, and rows (K,2) of each


def adjust_loops(seen: SubmapFeatures, closed: LoopClosingResult) -> CompletedSubmap | None:
    """The submap adjusted to its images, from the pose graph's result `closed`.

    None if too few features constrain it, or if the adjusted map fulfils its loops no better than before."""
    completed, every = seen.completed, features_of_all(seen).features
    number = np.searchsorted(completed.rows, seen.rows)
    matches = [
        replace(k.match, first=int(number[k.match.first]), second=int(number[k.match.second])) for k in closed.accepted
    ]
    found = adjust_nodes(completed, every, matches, nodes_of(completed, closed.completed))
    if found is None:
        return None
    adjusted = deform(completed, completed.rows[found[0]], found[1])
    edges = [
        Edge(match.first, match.second, match.first_from_second, loop.information)
        for match, loop in zip(matches, closed.accepted, strict=True)
    ]
    before, after = (
        np.median([chi2(nodes, edge) for edge in edges])
        for nodes in (completed.submap.world_from_camera[completed.rows], nodes_of(completed, adjusted))
    )
    return adjusted if after < before else None


def adjust_nodes(
    completed: CompletedSubmap, keyframes: list[KeyframeFeatures], loops: Sequence[Sim3Match], world_from_node: Array
) -> tuple[NDArray[np.int64], Array] | None:
    """Numbers of keyframes and their nodes (.,4,4), Sim(3), adjusted to the images; None if too few features constrain
    them.

    keyframes: features of all keyframes of the submap, as it was before the pose graph. loops: accepted matches between
    them. world_from_node (K,4,4): the pose graph's solution.
    """
    found = _constraining_tracks(completed, keyframes, loops, world_from_node)
    if found is None:
        return None
    tracks, number = found
    scale = scale_of(world_from_node)
    world_from_camera = world_from_node.copy()
    world_from_camera[:, :3, :3] /= scale[:, None, None]
    camera = np.full(len(keyframes), -1)
    camera[number] = np.arange(len(number))
    used = np.flatnonzero(camera[tracks.place] >= 0)
    used = used[np.argsort(tracks.place[used], kind="stable")]
    keyframe, feature = tracks.place[used], tracks.feature[used]
    rotation = np.swapaxes(world_from_camera[number, :3, :3], 1, 2)
    local = _all(keyframes, keyframe, feature)
    bundle = Bundle(
        rotation,
        -np.einsum("nij,nj->ni", rotation, world_from_camera[number, :3, 3]),
        tracks.points,
        camera[keyframe],
        tracks.track[used],
        local[:, :2] / local[:, 2:],
        np.broadcast_to(np.diag(completed.camera.focal), (len(used), 2, 2)),
        np.arange(len(number)) == 0,
    )
    bundle, depth = _at(bundle, local[:, 2], np.arange(len(used)))
    for loss_px, max_error_px in LOSS_SCHEDULE:
        bundle = adjust(bundle, ITERATIONS, loss_px, FINAL_TOLERANCE, FINAL_DAMPING)
        bundle, depth = _at(bundle, depth, np.flatnonzero(bundle.errors() < max_error_px))
    return _nodes(bundle, depth, number)


def _constraining_tracks(
    completed: CompletedSubmap, keyframes: list[KeyframeFeatures], loops: Sequence[Sim3Match], world_from_node: Array
) -> tuple[FeatureTracks, NDArray[np.int64]] | None:
    """Tracks of narrow features, since wide ones slide and bend the scale (docs/lab/front_end.md); of all where those
    are too few; None if these are, too. And numbers of the keyframes that they constrain."""
    matches = match_keyframes(completed, keyframes, loops)
    for widest in (widest_narrow(completed.camera.width), np.inf):
        tracks = feature_tracks(keyframes, matches, world_from_node, widest)
        number = well_constrained(tracks, len(keyframes))
        if len(number) >= 2 and is_held(tracks, number, len(keyframes)):
            return tracks, number
    return None


def match_keyframes(
    completed: CompletedSubmap, keyframes: list[KeyframeFeatures], loops: Sequence[Sim3Match]
) -> Matches:
    """Pairs of keyframes, and of each the features (K,2) that look alike and lie where the map has them, or that a loop
    matched."""
    pairs, matches = [(k.first, k.second) for k in loops], [k.rows for k in loops]
    for one in range(len(keyframes)):
        for other in range(one + 1, min(len(keyframes), one + AHEAD + 1)):
            pairs.append((one, other))
            matches.append(_match_near(completed, keyframes[one], keyframes[other]))
    return pairs, matches


def feature_tracks(
    keyframes: list[KeyframeFeatures], matches: Matches, world_from_node: Array, widest: float = np.inf
) -> FeatureTracks:
    """Tracks of matched features of at most `widest` pixels across: each track is one point."""
    narrow = both_narrow([keyframe.sizes for keyframe in keyframes], *matches, widest)
    chosen = [rows[good] for rows, good in zip(matches[1], narrow, strict=True)]
    world = [p.points @ node[:3, :3].T + node[:3, 3] for p, node in zip(keyframes, world_from_node, strict=True)]
    return join_features(world, matches[0], chosen)


def well_constrained(tracks: FeatureTracks, count: int) -> NDArray[np.int64]:
    """Numbers of the keyframes that enough tracks constrain."""
    return np.flatnonzero(np.bincount(tracks.place, minlength=count) >= MIN_FEATURES)


def is_held(tracks: FeatureTracks, number: NDArray[np.int64], count: int) -> bool:
    """Whether tracks are many, connect each keyframe to the one before, and leave no long stretch out."""
    if np.median(np.bincount(tracks.place, minlength=count)[number]) < MIN_TYPICAL_FEATURES:
        return False
    if np.diff(np.concatenate([[-1], number, [count]])).max() > MAX_GAP + 1:
        return False
    seen = coo_array((np.ones(len(tracks.track)), (tracks.place, tracks.track)), shape=(count, len(tracks.points)))
    seen = seen.tocsr()[number]
    return bool((seen[1:].multiply(seen[:-1]).sum(axis=1) >= MIN_SHARED).all())


def _match_near(completed: CompletedSubmap, here: KeyframeFeatures, there: KeyframeFeatures) -> NDArray[np.int64]:
    """(K,2) features of two near keyframes that look alike and lie where the map says."""
    pairs = match_descriptors(here.rootsift, there.rootsift)
    if len(pairs) == 0:
        return pairs
    world_from_camera = completed.submap.world_from_camera[here.keyframe]
    world = here.points[pairs[:, 0]] @ world_from_camera[:3, :3].T + world_from_camera[:3, 3]
    local = completed.submap.points_in_camera(there.keyframe, world)
    front = local[:, 2] > 1e-6
    local[:, 2] = np.where(front, local[:, 2], 1.0)
    off = np.linalg.norm(completed.camera.project(local) - there.pixels[pairs[:, 1]], axis=1)
    return pairs[front & (off < MAX_OFF_PX)]


def _all(keyframes: list[KeyframeFeatures], keyframe: NDArray[np.int64], feature: NDArray[np.int64]) -> Array:
    """(M,3) points of features in their cameras' axes."""
    starts = np.concatenate([[0], np.cumsum([len(p.points) for p in keyframes])])
    return np.concatenate([p.points for p in keyframes])[starts[keyframe] + feature]


def _at(bundle: Bundle, depth: Array, rows: NDArray[np.int64]) -> tuple[Bundle, Array]:
    """The same cameras and points with some of the observations; a point that one alone would hold loses it too."""
    times = np.bincount(bundle.point[rows], minlength=len(bundle.points))
    rows = rows[times[bundle.point[rows]] >= 2]
    kept = replace(
        bundle,
        camera=bundle.camera[rows],
        point=bundle.point[rows],
        xy=bundle.xy[rows],
        jacobian=bundle.jacobian[rows],
    )
    return kept, depth[rows]


def _nodes(bundle: Bundle, depth: Array, number: NDArray[np.int64]) -> tuple[NDArray[np.int64], Array] | None:
    """Nodes of the keyframes that are still well seen: the scale is the median of adjusted over mapped depth."""
    world_from_camera = np.swapaxes(bundle.rotation, 1, 2)
    local = np.einsum("mij,mj->mi", bundle.rotation[bundle.camera], bundle.points[bundle.point])
    found = local[:, 2] + bundle.translation[bundle.camera, 2]
    starts = np.searchsorted(bundle.camera, np.arange(len(number) + 1))
    kept, nodes = [], []
    for camera, (begin, end) in enumerate(pairwise(starts)):
        if end - begin < MIN_FEATURES:
            continue
        node = np.eye(4)
        scale = np.exp(np.median(np.log(np.maximum(found[begin:end], 1e-9) / depth[begin:end])))
        node[:3, :3] = scale * world_from_camera[camera]
        node[:3, 3] = -world_from_camera[camera] @ bundle.translation[camera]
        kept.append(camera)
        nodes.append(node)
    if len(kept) < 2 or np.diff(number[kept]).max() > MAX_GAP + 1:
        return None
    return number[kept], np.stack(nodes)
