"""Keyframes as Sim(3) nodes, tied by what the front end knows and by loops: GTSAM solves, and false loops fall out.

A monocular path drifts in scale too, so a node is a similarity: camera axes to world, with the scale by which the
node's depth must be multiplied. Ties of the front end are believed; a loop is kept only if graduated non-convexity
(Yang et al., "Graduated non-convexity for robust spatial perception", RA-L 2020) leaves it its weight.

Similarities are 4x4 with scale times rotation in the upper left. Tangents are rotation, translation, log scale, applied
from the right: at the `second` node of an edge, in its own axes.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from haustra.core.errors import ReconstructionError
from haustra.core.sim3 import scale_of

Array = NDArray[np.float64]

# What a tie may be off by whatever its points say, so that nothing is ever wholly free: rad, units of depth, log scale.
LOOSEST = np.array([0.2, 0.2, 0.2, 0.3, 0.3, 0.3, 0.3])
ITERATIONS = 100
# Two loops that support each other: scene units (median depths) between their ends, and what may be left of the circle.
MIN_BASELINE = 0.05
SAME_TURN, SAME_SHIFT, SAME_SCALE = np.radians(4), 0.08, 0.1


@dataclass(frozen=True)
class Edge:
    """A measured relation of two nodes: `first_from_second` (4,4), and its information (7,7)."""

    first: int
    second: int
    first_from_second: Array
    information: Array


@dataclass(frozen=True)
class Solution:
    """world_from_node (N,4,4), Sim(3); kept (L,): which loops were believed; before, after: (L,7) their residuals."""

    world_from_node: Array
    kept: NDArray[np.bool_]
    before: Array
    after: Array


def solve_pose_graph(world_from_node: Array, ties: Sequence[Edge], loops: Sequence[Edge]) -> Solution:
    """Nodes (N,4,4) moved to agree with all ties and with those loops that agree with them and each other.

    The first node stays, in place and scale. Raises ReconstructionError where GTSAM finds no solution. Without any loop
    that is kept the nodes come back as they went in.
    """
    before = np.array([residual(world_from_node, loop) for loop in loops]).reshape(-1, 7)
    nodes, kept = world_from_node, np.zeros(len(loops), bool)
    if len(loops):
        found, weights = _solve(world_from_node, ties, loops)
        kept = weights > 0.5
        nodes = found if kept.any() else nodes
    after = np.array([residual(nodes, loop) for loop in loops]).reshape(-1, 7)
    return Solution(nodes, kept, before, after)


def residual(world_from_node: Array, edge: Edge) -> Array:
    """(7,) tangent by which the nodes (N,4,4) miss the edge: rotation in rad, translation, log scale."""
    first, second = (similarity(world_from_node[k]) for k in (edge.first, edge.second))
    measured = similarity(edge.first_from_second)
    return _gtsam().Similarity3.Logmap(measured.inverse().compose(first.inverse().compose(second)))


def misfit(world_from_node: Array, edge: Edge) -> float:
    """Squared sigmas by which the nodes miss the edge; 7 on average if they are right and the edge is honest."""
    left = residual(world_from_node, edge)
    return float(left @ edge.information @ left)


def supported(loops: Sequence[Edge], first_nodes: Array, second_nodes: Array, reach: int) -> NDArray[np.bool_]:
    """(L,) whether another loop between other places nearby, on both sides, measures the same.

    Round the small circle of two loops and the path between their ends almost nothing may be left. One false likeness
    is thereby never enough, however weak the path between its ends. Ends are at most `reach` nodes apart, so that the
    path between them has hardly drifted, and at least MIN_BASELINE, since neighbours see one and the same picture.
    """
    found = np.zeros(len(loops), bool)
    for one, other in ((i, j) for i in range(len(loops)) for j in range(i)):
        if _agree(loops[one], loops[other], first_nodes, second_nodes, reach):
            found[[one, other]] = True
    return found


def _agree(one: Edge, other: Edge, first_nodes: Array, second_nodes: Array, reach: int) -> bool:
    ends = ((first_nodes, one.first, other.first), (second_nodes, one.second, other.second))
    steps = []
    for nodes, here, there in ends:
        step = np.linalg.inv(nodes[here]) @ nodes[there]
        if abs(here - there) > reach or np.linalg.norm(step[:3, 3]) < MIN_BASELINE:
            return False
        steps.append(step)
    around = np.linalg.inv(steps[0]) @ one.first_from_second @ steps[1] @ np.linalg.inv(other.first_from_second)
    left = _gtsam().Similarity3.Logmap(similarity(around))
    turn, shift = np.linalg.norm(left[:3]), np.linalg.norm(left[3:6])
    return bool(turn < SAME_TURN and shift < SAME_SHIFT and abs(left[6]) < SAME_SCALE)


def tie_information(points: Array, across: Array, along: Array, floor: Array = LOOSEST) -> Array:
    """(7,7) information on a similarity that points (N,3) in the second node's axes carry.

    across, along: (N,) one sigma of each point, square to its ray and along it, in the unit of the points. What the
    points leave free stays free up to `floor`, one sigma for each direction of the tangent.
    """
    ray = points / np.linalg.norm(points, axis=1, keepdims=True)
    by_turn = np.cross(np.eye(3)[None], points[:, None, :])  # column a of d(w x p)/dw is e_a x p
    jacobian = np.concatenate(
        [np.swapaxes(by_turn, 1, 2), np.broadcast_to(np.eye(3), (len(points), 3, 3)), points[:, :, None]], axis=2
    )
    split = ray[:, :, None] * ray[:, None, :]
    weight = (np.eye(3) - split) / (across**2)[:, None, None] + split / (along**2)[:, None, None]
    found = np.einsum("nia,nij,njb->ab", jacobian, weight, jacobian)
    return found + np.diag(floor**-2.0)


def with_common_error(information: Array, sigma: Array) -> Array:
    """Information (7,7) less what errors common to all points hide: `sigma` (7,), one of each direction, is added."""
    return np.linalg.inv(np.linalg.inv(information) + np.diag(sigma**2))


def between(first: Array, second: Array, share: float) -> Array:
    """The similarity (4,4) at `share` of the way from one to the other along a screw with growing scale."""
    if share <= 0 or np.array_equal(first, second):
        return first
    here, there = similarity(first), similarity(second)
    step = share * _gtsam().Similarity3.Logmap(here.inverse().compose(there))
    return _matrix(here.compose(_gtsam().Similarity3.Expmap(step)))


def similarity(matrix: Array) -> Any:
    """GTSAM's Similarity3, which keeps the translation before scaling."""
    scale = float(scale_of(matrix))
    return _gtsam().Similarity3(matrix[:3, :3] / scale, matrix[:3, 3] / scale, scale)


def _matrix(value: Any) -> Array:
    result = np.eye(4)
    result[:3, :3] = value.scale() * value.rotation().matrix()
    result[:3, 3] = value.scale() * value.translation()
    return result


def _solve(world_from_node: Array, ties: Sequence[Edge], loops: Sequence[Edge]) -> tuple[Array, Array]:
    """Nodes, and the weight in [0,1] that each loop ends with."""
    gtsam = _gtsam()
    graph, start = gtsam.NonlinearFactorGraph(), gtsam.Values()
    for key, node in enumerate(world_from_node):
        start.insert(key, similarity(node))
    held = gtsam.noiseModel.Isotropic.Sigma(7, 1e-6)
    graph.add(gtsam.PriorFactorSimilarity3(0, similarity(world_from_node[0]), held))
    for edge in (*ties, *loops):
        noise = gtsam.noiseModel.Gaussian.Information(_symmetric(edge.information))
        measured = similarity(edge.first_from_second)
        graph.add(gtsam.BetweenFactorSimilarity3(edge.first, edge.second, measured, noise))
    lm = gtsam.LevenbergMarquardtParams()
    lm.setMaxIterations(ITERATIONS)
    params = gtsam.GncLMParams(lm)
    params.setLossType(gtsam.GncLossType.TLS)
    params.setKnownInliers(list(range(1 + len(ties))))
    try:
        optimiser = gtsam.GncLMOptimizer(graph, start, params)
        found = optimiser.optimize()
    except (RuntimeError, ValueError) as error:
        raise ReconstructionError(f"the pose graph has no solution: {str(error).splitlines()[0]}") from error
    nodes = np.stack([_matrix(found.atSimilarity3(key)) for key in range(len(world_from_node))])
    if not np.isfinite(nodes).all() or (scale_of(nodes) <= 0).any():
        raise ReconstructionError("the pose graph has no finite solution")
    return nodes, np.asarray(optimiser.getWeights())[1 + len(ties) :]


def _symmetric(matrix: Array) -> Array:
    return 0.5 * (matrix + matrix.T)


def _gtsam() -> Any:
    import gtsam

    return gtsam
