"""Sim(3) pose graph of keyframes: odometry factors, loop closures, and GNC by GTSAM that rejects outlier loops.

A monocular path drifts in scale too, so a node is a similarity: camera axes to world, with the scale by which the
node's depth must be multiplied. Odometry factors are known inliers; a loop is accepted if graduated non-convexity
(Yang et al., "Graduated non-convexity for robust spatial perception", RA-L 2020) leaves it its weight.

Similarities are (4,4) with scale times rotation in the upper left. Tangents (7,) are rotation, translation, log scale,
applied from the right: at the `second` node of an edge, in its own axes.
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

# Upper bound on an odometry factor's sigma, so that no direction is unconstrained: rad, units of depth, log scale.
MAX_ODOMETRY_SIGMA = np.array([0.2, 0.2, 0.2, 0.3, 0.3, 0.3, 0.3])
MAX_ITERATIONS = 100  # of Levenberg-Marquardt, in each round of GNC
MIN_WEIGHT = 0.5  # final GNC weight in [0,1] from which a loop is accepted
# Consistency of two loops: least distance between their ends, and largest error around the cycle they form.
MIN_BASELINE = 0.05  # scene units (median depths)
MAX_CYCLE_ROTATION, MAX_CYCLE_TRANSLATION, MAX_CYCLE_LOG_SCALE = np.radians(4), 0.08, 0.1  # rad, scene units, log


@dataclass(frozen=True)
class Edge:
    """A factor between two nodes: odometry or loop."""

    first: int  # row of the node
    second: int
    first_from_second: Array  # (4,4) measured
    information: Array  # (7,7)


@dataclass(frozen=True)
class Solution:
    """Optimised nodes, and what became of the loops."""

    world_from_node: Array  # (N,4,4) Sim(3)
    accepted: NDArray[np.bool_]  # (L,) loops that GNC counts as inliers
    before: Array  # (L,7) residuals of the loops before
    after: Array  # (L,7) and after


def solve_pose_graph(world_from_node: Array, odometry: Sequence[Edge], loops: Sequence[Edge]) -> Solution:
    """Maximum a posteriori nodes (N,4,4) given all odometry factors and those loops that GNC accepts.

    The first node stays, in place and scale. Without an accepted loop the nodes are returned unchanged. Raises
    `ReconstructionError` where GTSAM finds no solution.
    """
    before = np.array([residual(world_from_node, loop) for loop in loops]).reshape(-1, 7)
    nodes, accepted = world_from_node, np.zeros(len(loops), bool)
    if len(loops):
        found, weights = _optimise(world_from_node, odometry, loops)
        accepted = weights > MIN_WEIGHT
        nodes = found if accepted.any() else nodes
    after = np.array([residual(nodes, loop) for loop in loops]).reshape(-1, 7)
    return Solution(nodes, accepted, before, after)


def residual(world_from_node: Array, edge: Edge) -> Array:
    """Residual (7,) of an edge at nodes (N,4,4): rotation in rad, translation, log scale."""
    first, second = (similarity(world_from_node[k]) for k in (edge.first, edge.second))
    measured = similarity(edge.first_from_second)
    return _gtsam().Similarity3.Logmap(measured.inverse().compose(first.inverse().compose(second)))


def chi2(world_from_node: Array, edge: Edge) -> float:
    """Squared Mahalanobis norm of an edge's residual: 7 degrees of freedom, so 7 on average for right nodes."""
    error = residual(world_from_node, edge)
    return float(error @ edge.information @ error)


def consistent_loops(
    loops: Sequence[Edge], first_nodes: Array, second_nodes: Array, max_separation: int
) -> NDArray[np.bool_]:
    """(L,) whether each loop forms a consistent cycle with another one: pairwise consistency.

    Around the cycle of two loops and the odometry between their ends almost no error may be left, so that one false
    match is never enough, however weak the odometry between its ends. Ends are at most `max_separation` nodes apart,
    so that the odometry between them has hardly drifted, and at least MIN_BASELINE, since neighbours see one image.
    first_nodes, second_nodes: (N,4,4) world_from_node of the loops' first and second ends.
    """
    consistent = np.zeros(len(loops), bool)
    for one, other in ((i, j) for i in range(len(loops)) for j in range(i)):
        if _are_consistent(loops[one], loops[other], first_nodes, second_nodes, max_separation):
            consistent[[one, other]] = True
    return consistent


def _are_consistent(one: Edge, other: Edge, first_nodes: Array, second_nodes: Array, max_separation: int) -> bool:
    """Whether the cycle of two loops and the odometry between their ends closes within the MAX_CYCLE limits."""
    ends = ((first_nodes, one.first, other.first), (second_nodes, one.second, other.second))
    one_from_other = []
    for world_from_node, here, there in ends:
        step = np.linalg.inv(world_from_node[here]) @ world_from_node[there]
        if abs(here - there) > max_separation or np.linalg.norm(step[:3, 3]) < MIN_BASELINE:
            return False
        one_from_other.append(step)
    first, second = one_from_other
    cycle = np.linalg.inv(first) @ one.first_from_second @ second @ np.linalg.inv(other.first_from_second)
    error = _gtsam().Similarity3.Logmap(similarity(cycle))
    rotation, translation = np.linalg.norm(error[:3]), np.linalg.norm(error[3:6])
    return bool(
        rotation < MAX_CYCLE_ROTATION and translation < MAX_CYCLE_TRANSLATION and abs(error[6]) < MAX_CYCLE_LOG_SCALE
    )


def sim3_information(points: Array, across: Array, along: Array, max_sigma: Array = MAX_ODOMETRY_SIGMA) -> Array:
    """Fisher information (7,7) on first_from_second from points (N,3) that both nodes see, in the second node's axes.

    across, along: (N,) sigma of each point, square to its ray and along it, in the unit of the points. `max_sigma` (7,)
    bounds the sigma of directions that the points leave unconstrained.
    """
    ray = points / np.linalg.norm(points, axis=1, keepdims=True)
    by_rotation = np.cross(np.eye(3)[None], points[:, None, :])  # column a of d(w x p)/dw is e_a x p
    jacobian = np.concatenate(
        [np.swapaxes(by_rotation, 1, 2), np.broadcast_to(np.eye(3), (len(points), 3, 3)), points[:, :, None]], axis=2
    )
    outer = ray[:, :, None] * ray[:, None, :]
    weight = (np.eye(3) - outer) / (across**2)[:, None, None] + outer / (along**2)[:, None, None]
    found = np.einsum("nia,nij,njb->ab", jacobian, weight, jacobian)
    return found + np.diag(max_sigma**-2.0)


def with_common_error(information: Array, sigma: Array) -> Array:
    """Information (7,7) with a covariance diag(sigma^2), sigma (7,), added for errors common to all points."""
    return np.linalg.inv(np.linalg.inv(information) + np.diag(sigma**2))


def interpolate_sim3(first: Array, second: Array, share: float) -> Array:
    """Geodesic interpolation (4,4) between two similarities (4,4); `share` 0 gives `first`, 1 gives `second`."""
    if share <= 0 or np.array_equal(first, second):
        return first
    start, end = similarity(first), similarity(second)
    step = share * _gtsam().Similarity3.Logmap(start.inverse().compose(end))
    return _matrix(start.compose(_gtsam().Similarity3.Expmap(step)))


def similarity(matrix: Array) -> Any:
    """GTSAM's Similarity3 of a matrix (4,4); it keeps the translation before scaling."""
    scale = float(scale_of(matrix))
    return _gtsam().Similarity3(matrix[:3, :3] / scale, matrix[:3, 3] / scale, scale)


def _matrix(value: Any) -> Array:
    """Matrix (4,4) of a GTSAM Similarity3."""
    result = np.eye(4)
    result[:3, :3] = value.scale() * value.rotation().matrix()
    result[:3, 3] = value.scale() * value.translation()
    return result


def _optimise(world_from_node: Array, odometry: Sequence[Edge], loops: Sequence[Edge]) -> tuple[Array, Array]:
    """Nodes (N,4,4) by GNC, and the final weight in [0,1] of each loop (L,)."""
    gtsam = _gtsam()
    graph, initial = _factor_graph(world_from_node, (*odometry, *loops))
    known_inliers = list(range(1 + len(odometry)))  # the prior comes first
    try:
        optimiser = gtsam.GncLMOptimizer(graph, initial, _gnc_parameters(known_inliers))
        found = optimiser.optimize()
    except (RuntimeError, ValueError) as error:
        raise ReconstructionError(f"the pose graph has no solution: {str(error).splitlines()[0]}") from error
    nodes = np.stack([_matrix(found.atSimilarity3(key)) for key in range(len(world_from_node))])
    if not np.isfinite(nodes).all() or (scale_of(nodes) <= 0).any():
        raise ReconstructionError("the pose graph has no finite solution")
    return nodes, np.asarray(optimiser.getWeights())[len(known_inliers) :]


def _factor_graph(world_from_node: Array, edges: Sequence[Edge]) -> tuple[Any, Any]:
    """GTSAM's factor graph, with a prior that holds the first node, and its initial values."""
    gtsam = _gtsam()
    graph, initial = gtsam.NonlinearFactorGraph(), gtsam.Values()
    for key, node in enumerate(world_from_node):
        initial.insert(key, similarity(node))
    fixed = gtsam.noiseModel.Isotropic.Sigma(7, 1e-6)
    graph.add(gtsam.PriorFactorSimilarity3(0, similarity(world_from_node[0]), fixed))
    for edge in edges:
        noise = gtsam.noiseModel.Gaussian.Information(_symmetric(edge.information))
        measured = similarity(edge.first_from_second)
        graph.add(gtsam.BetweenFactorSimilarity3(edge.first, edge.second, measured, noise))
    return graph, initial


def _gnc_parameters(known_inliers: list[int]) -> Any:
    """GNC with truncated least squares over Levenberg-Marquardt; factors of `known_inliers` keep their weight."""
    gtsam = _gtsam()
    lm = gtsam.LevenbergMarquardtParams()
    lm.setMaxIterations(MAX_ITERATIONS)
    params = gtsam.GncLMParams(lm)
    params.setLossType(gtsam.GncLossType.TLS)
    params.setKnownInliers(known_inliers)
    return params


def _symmetric(matrix: Array) -> Array:
    return 0.5 * (matrix + matrix.T)


def _gtsam() -> Any:
    import gtsam

    return gtsam
