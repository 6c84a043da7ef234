"""Sim(3) pose graph of a submap: covisibility factors and loops; frames and points move with the keyframes' nodes."""

from collections.abc import Iterable
from dataclasses import dataclass, replace
from itertools import compress, pairwise

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array, csr_array

from haustra.core.sim3 import scale_of
from pipeline.depth.completed_submap import CompletedSubmap
from pipeline.depth.sparse_depth import SparseDepthMaker
from pipeline.loop_closing.detection import LoopClosure, SubmapFeatures
from reconstruction.robust_pose_graph import (
    Edge,
    chi2,
    consistent_loops,
    interpolate_sim3,
    sim3_information,
    solve_pose_graph,
)

MIN_COVISIBLE = 20  # points that two keyframes share for a factor between them; consecutive ones always have one
PIXEL_NOISE = 0.5  # px, across
SLACK = 4.0  # factor on the sigmas of odometry factors: shared points err together along the path
CHI2_SATISFIED = (
    7.0  # 7 degrees of freedom; below it the pose graph is skipped and bundle adjustment starts from the map
)
CHI2_CLOSED = 0.5  # below it, in the median, the map has closed its loops already
REACH = 12  # keyframes within which two loops can support each other

Array = NDArray[np.float64]


@dataclass(frozen=True)
class LoopClosingResult:
    """A submap after loop closing. candidates: loops verified in both images; consistent: those of them that agree with
    another one; accepted: those that the pose graph kept.

    Where the map fulfils most of its consistent loops already, `completed` is not moved, and those that it fulfils are
    accepted: the adjustment to the images decides on the rest. Of a map that has closed its loops, none is accepted.
    """

    completed: CompletedSubmap
    candidates: int
    consistent: int
    accepted: tuple[LoopClosure, ...]
    accepted_pairs: tuple[tuple[int, int], ...]  # frame numbers of `accepted`


def close_loops(seen: SubmapFeatures, loops: list[LoopClosure]) -> LoopClosingResult:
    """Move the submap by those of its loops that the pose graph accepts; it comes back as it is if there are none."""
    completed = seen.completed
    world_from_camera = completed.submap.world_from_camera[completed.rows]
    edges = _edges(seen, seen, loops)
    is_consistent = consistent_loops(edges, world_from_camera, world_from_camera, REACH)
    edges, loops, candidates = list(compress(edges, is_consistent)), list(compress(loops, is_consistent)), len(loops)

    def result(moved: CompletedSubmap, accepted: Iterable[LoopClosure]) -> LoopClosingResult:
        accepted = tuple(accepted)
        return LoopClosingResult(moved, candidates, len(loops), accepted, _frames_of(seen, accepted))

    off = np.array([chi2(world_from_camera, edge) for edge in edges])
    typical = float(np.median(off)) if edges else 0.0
    if typical < CHI2_CLOSED:
        return result(completed, ())
    if typical < CHI2_SATISFIED:
        return result(completed, compress(loops, off < CHI2_SATISFIED))
    solution = solve_pose_graph(world_from_camera, covisibility_factors(completed), edges)
    if not solution.accepted.any():
        return result(completed, ())
    moved = deform(completed, completed.rows, solution.world_from_node)
    return result(moved, compress(loops, solution.accepted))


def _frames_of(seen: SubmapFeatures, loops: Iterable[LoopClosure]) -> tuple[tuple[int, int], ...]:
    number = seen.completed.submap.frames[seen.rows]
    return tuple((int(number[loop.match.first]), int(number[loop.match.second])) for loop in loops)


def merge_by_loops(seen: tuple[SubmapFeatures, SubmapFeatures], loops: list[LoopClosure]) -> CompletedSubmap | None:
    """The second submap in the frame and scale of the first, both bent to agree; None without enough evidence."""
    submaps = first, second = seen[0].completed, seen[1].completed
    if first.camera != second.camera or first.submap.camera_params != second.submap.camera_params:
        return None  # one pinhole may stand for two lenses, where the field of view is cut
    nodes = [completed.submap.world_from_camera[completed.rows] for completed in submaps]
    edges = _edges(*seen, loops)
    good = list(compress(edges, consistent_loops(edges, nodes[0], nodes[1], REACH)))
    if not good:
        return None
    start = first_from_second(good, nodes[0], nodes[1])
    offset = len(nodes[0])
    odometry_factors = covisibility_factors(first) + [
        replace(factor, first=factor.first + offset, second=factor.second + offset)
        for factor in covisibility_factors(second)
    ]
    shifted = [replace(edge, second=edge.second + offset) for edge in good]
    solution = solve_pose_graph(np.concatenate([nodes[0], start @ nodes[1]]), odometry_factors, shifted)
    if solution.accepted.sum() < 2:
        return None
    first, second = (
        deform(first, first.rows, solution.world_from_node[:offset]),
        deform(second, second.rows, solution.world_from_node[offset:]),
    )
    return concatenate(first, second)


def first_from_second(loops: list[Edge], first_nodes: Array, second_nodes: Array) -> Array:
    """`first_from_second` (4,4) of the two worlds by the loop that most others agree with, in scale and shift."""
    guesses = np.stack(
        [first_nodes[e.first] @ e.first_from_second @ np.linalg.inv(second_nodes[e.second]) for e in loops]
    )
    centres = second_nodes[[e.second for e in loops]][:, :3, 3]
    landed = np.einsum("gij,nj->gni", guesses[:, :3, :3], centres) + guesses[:, None, :3, 3]
    off = np.linalg.norm(landed[:, None] - landed[None], axis=3).mean(axis=2)
    return guesses[int(np.median(off, axis=1).argmin())]


def covisibility_factors(completed: CompletedSubmap) -> list[Edge]:
    """Relations of keyframes as the map has them, with the information of the points that both saw.

    A point of m keyframes ties m (m - 1) / 2 pairs, but links m frames: each pair has 2 / m of it. Its sigma along
    the ray is the depth error that its triangulation left.
    """
    submap = completed.submap
    maker = SparseDepthMaker(submap, completed.camera)
    seen = [np.unique(maker.seen_by(int(row))) for row in completed.rows]
    times = np.bincount(np.concatenate(seen), minlength=len(submap.points))
    odometry_factors = []
    for one, other in _covisible_pairs(seen, len(submap.points)):
        shared = np.intersect1d(seen[one], seen[other], assume_unique=True)
        rows = int(completed.rows[one]), int(completed.rows[other])
        points = submap.points_in_camera(rows[1], submap.points[shared])
        distance = np.maximum(np.linalg.norm(points, axis=1), 1e-9)
        less = SLACK * np.sqrt(times[shared] / 2) * distance
        across = PIXEL_NOISE / float(np.mean(completed.camera.focal)) * less
        information = sim3_information(points, across, np.maximum(maker.scatter[shared], 1e-4) * less)
        relation = np.linalg.inv(submap.world_from_camera[rows[0]]) @ submap.world_from_camera[rows[1]]
        odometry_factors.append(Edge(one, other, relation, information))
    return odometry_factors


def _covisible_pairs(seen: list[NDArray[np.int64]], points: int) -> list[tuple[int, int]]:
    """Pairs of keyframes that share `MIN_COVISIBLE` points, and all consecutive ones; `seen`: the points of each."""
    starts = np.concatenate([[0], np.cumsum([len(s) for s in seen])])
    table = csr_array((np.ones(starts[-1], np.int64), np.concatenate(seen), starts), shape=(len(seen), points))
    shared = coo_array(table @ table.T)
    one, other = shared.coords
    enough = (shared.data >= MIN_COVISIBLE) & (one < other)
    pairs = set(zip(one[enough].tolist(), other[enough].tolist(), strict=True))
    return sorted(pairs | set(pairwise(range(len(seen)))))


def deform(completed: CompletedSubmap, rows: NDArray[np.int64], world_from_node: Array) -> CompletedSubmap:
    """The submap with those of its frames at the nodes (K,4,4), Sim(3); what else it holds follows.

    A frame between two nodes follows both, by its share of the way; a point follows the nearest frame that saw it.
    """
    submap = completed.submap
    change = world_from_node @ np.linalg.inv(submap.world_from_camera[rows])
    of_frame = _spread(change, rows, len(submap.frames))
    scale = scale_of(of_frame)
    world_from_camera = of_frame @ submap.world_from_camera
    world_from_camera[:, :3, :3] /= scale[:, None, None]
    frame, point = submap.observations.T
    distance = np.linalg.norm(submap.points[point] - submap.centres[frame], axis=1)
    order = np.lexsort((distance, point))
    first = np.unique(point[order], return_index=True)
    guide = np.zeros(len(submap.points), np.int64)
    guide[first[0]] = frame[order][first[1]]
    points = np.einsum("nij,nj->ni", of_frame[guide, :3, :3], submap.points) + of_frame[guide, :3, 3]
    before = np.ones(len(scale)) if completed.depth_scale is None else completed.depth_scale
    return replace(
        completed,
        submap=replace(submap, world_from_camera=world_from_camera, points=points),
        depth_scale=before * scale,
    )


def nodes_of(before: CompletedSubmap, after: CompletedSubmap) -> Array:
    """(K,4,4) Sim(3) nodes at which `deform` put the keyframes of `after`."""
    nodes = after.submap.world_from_camera[before.rows].copy()
    if after.depth_scale is not None:
        was = 1.0 if before.depth_scale is None else before.depth_scale[before.rows]
        nodes[:, :3, :3] *= (after.depth_scale[before.rows] / was)[:, None, None]
    return nodes


def concatenate(first: CompletedSubmap, second: CompletedSubmap) -> CompletedSubmap:
    """Two submaps of one frame, scale and camera as one, frames in order."""
    one, other = first.submap, second.submap
    frames = np.concatenate([one.frames, other.frames])
    order = np.argsort(frames, kind="stable")
    place = np.empty_like(order)
    place[order] = np.arange(len(order))
    observations = np.concatenate([one.observations, other.observations + np.array([len(one.frames), len(one.points)])])
    observations[:, 0] = place[observations[:, 0]]
    submap = replace(
        one,
        frames=frames[order],
        world_from_camera=np.concatenate([one.world_from_camera, other.world_from_camera])[order],
        points=np.concatenate([one.points, other.points]),
        error_px=np.concatenate([one.error_px, other.error_px]),
        observations=observations,
        pixels=np.concatenate([one.pixels, other.pixels]),
        klt=np.concatenate([one.is_klt, other.is_klt]),
        depth_error=np.concatenate([one.known_depth_error, other.known_depth_error]),
    )
    scales = [np.ones(len(p.submap.frames)) if p.depth_scale is None else p.depth_scale for p in (first, second)]
    rows = np.sort(place[np.concatenate([first.rows, second.rows + len(one.frames)])])
    return replace(first, submap=submap, rows=rows, depth_scale=np.concatenate(scales)[order])


def _spread(change: Array, rows: NDArray[np.int64], count: int) -> Array:
    """(count,4,4) change of each frame from those of the keyframes (K,4,4) at `rows`."""
    result = np.empty((count, 4, 4))
    result[: rows[0]], result[rows[-1] :] = change[0], change[-1]
    for k, (begin, end) in enumerate(pairwise(rows)):
        for row in range(begin, end):
            result[row] = interpolate_sim3(change[k], change[k + 1], (row - begin) / (end - begin))
    return result


def _edges(first: SubmapFeatures, second: SubmapFeatures, loops: list[LoopClosure]) -> list[Edge]:
    """Loop closures as edges between keyframe numbers."""
    here, there = (np.searchsorted(seen.completed.rows, seen.rows) for seen in (first, second))
    return [
        Edge(int(here[k.match.first]), int(there[k.match.second]), k.match.first_from_second, k.information)
        for k in loops
    ]
