"""A submap as a pose graph: its keyframes tied by the points they share, and everything else moved with them."""

from collections.abc import Iterable
from dataclasses import dataclass, replace
from itertools import compress, pairwise

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array, csr_array

from haustra.core.sim3 import scale_of
from pipeline.depth.completion_stage import DenseSubmap
from pipeline.depth.sparse_depth import SparseDepthMaker
from pipeline.loop_closing.detection import LoopClosure, SubmapFeatures
from reconstruction.pose_graph import Edge, chi2, consistent_loops, interpolate_sim3, sim3_information, solve_pose_graph

MIN_TIE = 20  # points that two keyframes share; consecutive ones are tied by however few
PIXEL_NOISE = 0.5  # px, across
SLACK = 4.0  # on the sigmas of ties: points that keyframes share err together along the path
FULFILLED = 7.0  # squared sigmas in seven directions: a map that misses a loop by less knows better than the loop
SETTLED = 0.5  # the same: a map that misses its loops by less than this has closed them itself
REACH = 12  # keyframes within which two loops can support each other

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Closed:
    """A submap after its loops: `proposed` links fitted two images, `supported` had company, `links` were believed.

    `part` did not move where the map fulfils most of its supported loops already; those that it fulfils are believed,
    and what is left between them is for the images to say. Of a map that has closed its loops itself there are none.
    """

    part: DenseSubmap
    proposed: int
    supported: int
    links: tuple[LoopClosure, ...]
    kept: tuple[tuple[int, int], ...]  # frame numbers of `links`


def close_loops(seen: SubmapFeatures, links: list[LoopClosure]) -> Closed:
    """Move the submap by those of its own links that can be believed; it comes back as it is if there are none."""
    part = seen.part
    poses = part.submap.world_from_camera[part.rows]
    loops = _edges(seen, seen, links)
    company = consistent_loops(loops, poses, poses, REACH)
    good, theirs = list(compress(loops, company)), list(compress(links, company))
    off = np.array([chi2(poses, loop) for loop in good])
    missed = float(np.median(off)) if good else 0.0
    if missed < SETTLED:
        return Closed(part, len(links), len(good), (), ())
    if missed < FULFILLED:
        near = tuple(compress(theirs, off < FULFILLED))
        return Closed(part, len(links), len(good), near, _frames_of(seen, near))
    solution = solve_pose_graph(poses, point_ties(part), good)
    believed = tuple(compress(theirs, solution.accepted))
    if not believed:
        return Closed(part, len(links), len(good), (), ())
    after = moved(part, part.rows, solution.world_from_node)
    return Closed(after, len(links), len(good), believed, _frames_of(seen, believed))


def _frames_of(seen: SubmapFeatures, links: Iterable[LoopClosure]) -> tuple[tuple[int, int], ...]:
    number = seen.part.submap.frames[seen.rows]
    return tuple((int(number[link.match.first]), int(number[link.match.second])) for link in links)


def merge(seen: tuple[SubmapFeatures, SubmapFeatures], links: list[LoopClosure]) -> DenseSubmap | None:
    """The second submap in the frame and scale of the first, both bent to agree; None without enough evidence."""
    parts = first, second = seen[0].part, seen[1].part
    if first.camera != second.camera or first.submap.camera_params != second.submap.camera_params:
        return None  # one pinhole may stand for two lenses, where the field of view is cut
    nodes = [part.submap.world_from_camera[part.rows] for part in parts]
    loops = _edges(*seen, links)
    good = [loop for loop, yes in zip(loops, consistent_loops(loops, nodes[0], nodes[1], REACH), strict=True) if yes]
    if not good:
        return None
    start = first_from_second(good, nodes[0], nodes[1])
    offset = len(nodes[0])
    ties = point_ties(first) + [
        replace(tie, first=tie.first + offset, second=tie.second + offset) for tie in point_ties(second)
    ]
    shifted = [replace(loop, second=loop.second + offset) for loop in good]
    solution = solve_pose_graph(np.concatenate([nodes[0], start @ nodes[1]]), ties, shifted)
    if solution.accepted.sum() < 2:
        return None
    first, second = (
        moved(first, first.rows, solution.world_from_node[:offset]),
        moved(second, second.rows, solution.world_from_node[offset:]),
    )
    return united(first, second)


def first_from_second(loops: list[Edge], first_nodes: Array, second_nodes: Array) -> Array:
    """`first_from_second` (4,4) of the two worlds by the loop that most others agree with, in scale and shift."""
    guesses = np.stack(
        [first_nodes[e.first] @ e.first_from_second @ np.linalg.inv(second_nodes[e.second]) for e in loops]
    )
    centres = second_nodes[[e.second for e in loops]][:, :3, 3]
    landed = np.einsum("gij,nj->gni", guesses[:, :3, :3], centres) + guesses[:, None, :3, 3]
    off = np.linalg.norm(landed[:, None] - landed[None], axis=3).mean(axis=2)
    return guesses[int(np.median(off, axis=1).argmin())]


def point_ties(part: DenseSubmap) -> list[Edge]:
    """Relations of keyframes as the map has them, with the information of the points that both saw.

    A point of m keyframes ties m (m - 1) / 2 pairs, but links m frames: each pair has 2 / m of it. Its sigma along
    the ray is the depth error that its triangulation left.
    """
    submap = part.submap
    maker = SparseDepthMaker(submap, part.camera, part.workspace.config.sparse)
    seen = [np.unique(maker.seen_by(int(row))) for row in part.rows]
    times = np.bincount(np.concatenate(seen), minlength=len(submap.points))
    ties = []
    for one, other in _tied(seen, len(submap.points)):
        shared = np.intersect1d(seen[one], seen[other], assume_unique=True)
        rows = int(part.rows[one]), int(part.rows[other])
        points = submap.points_in_camera(rows[1], submap.points[shared])
        distance = np.maximum(np.linalg.norm(points, axis=1), 1e-9)
        less = SLACK * np.sqrt(times[shared] / 2) * distance
        across = PIXEL_NOISE / float(np.mean(part.camera.focal)) * less
        information = sim3_information(points, across, np.maximum(maker.scatter[shared], 1e-4) * less)
        relation = np.linalg.inv(submap.world_from_camera[rows[0]]) @ submap.world_from_camera[rows[1]]
        ties.append(Edge(one, other, relation, information))
    return ties


def _tied(seen: list[NDArray[np.int64]], points: int) -> list[tuple[int, int]]:
    """Pairs of keyframes that share `MIN_TIE` points, and all that follow each other; `seen`: the points of each."""
    starts = np.concatenate([[0], np.cumsum([len(s) for s in seen])])
    table = csr_array((np.ones(starts[-1], np.int64), np.concatenate(seen), starts), shape=(len(seen), points))
    shared = coo_array(table @ table.T)
    one, other = shared.coords
    enough = (shared.data >= MIN_TIE) & (one < other)
    pairs = set(zip(one[enough].tolist(), other[enough].tolist(), strict=True))
    return sorted(pairs | set(pairwise(range(len(seen)))))


def moved(part: DenseSubmap, rows: NDArray[np.int64], world_from_node: Array) -> DenseSubmap:
    """The submap with those of its frames at the nodes (K,4,4), Sim(3); what else it holds follows.

    A frame between two nodes follows both, by its share of the way; a point follows the nearest frame that saw it.
    """
    submap = part.submap
    change = world_from_node @ np.linalg.inv(submap.world_from_camera[rows])
    of_frame = _spread(change, rows, len(submap.frames))
    scale = scale_of(of_frame)
    poses = of_frame @ submap.world_from_camera
    poses[:, :3, :3] /= scale[:, None, None]
    frame, point = submap.observations.T
    distance = np.linalg.norm(submap.points[point] - submap.centres[frame], axis=1)
    order = np.lexsort((distance, point))
    first = np.unique(point[order], return_index=True)
    guide = np.zeros(len(submap.points), np.int64)
    guide[first[0]] = frame[order][first[1]]
    points = np.einsum("nij,nj->ni", of_frame[guide, :3, :3], submap.points) + of_frame[guide, :3, 3]
    before = np.ones(len(scale)) if part.depth_scale is None else part.depth_scale
    return replace(part, submap=replace(submap, world_from_camera=poses, points=points), depth_scale=before * scale)


def nodes_of(before: DenseSubmap, after: DenseSubmap) -> Array:
    """(K,4,4) Sim(3) nodes at which `moved` put the keyframes of `after`."""
    nodes = after.submap.world_from_camera[before.rows].copy()
    if after.depth_scale is not None:
        was = 1.0 if before.depth_scale is None else before.depth_scale[before.rows]
        nodes[:, :3, :3] *= (after.depth_scale[before.rows] / was)[:, None, None]
    return nodes


def united(first: DenseSubmap, second: DenseSubmap) -> DenseSubmap:
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
        followed=np.concatenate([one.is_followed, other.is_followed]),
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


def _edges(first: SubmapFeatures, second: SubmapFeatures, links: list[LoopClosure]) -> list[Edge]:
    """Loop closures as edges between keyframe numbers."""
    here, there = (np.searchsorted(seen.part.rows, seen.rows) for seen in (first, second))
    return [
        Edge(int(here[k.match.first]), int(there[k.match.second]), k.match.first_from_second, k.information)
        for k in links
    ]
