"""Pose graph: known drift comes back, false loops fall out, and SciPy finds the same optimum."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy.linalg import logm
from scipy.optimize import least_squares

from haustra.core.sim3 import scale_of
from reconstruction.robust_pose_graph import (
    Edge,
    chi2,
    consistent_loops,
    interpolate_sim3,
    residual,
    sim3_information,
    solve_pose_graph,
    with_common_error,
)
from tests.helpers.pose_circle import circle, exponential

CHAIN = np.array([0.003] * 3 + [0.01] * 3 + [0.004])  # one sigma of each odometry factor
LOOP = np.array([0.01] * 3 + [0.02] * 3 + [0.02])
TANGENTS = arrays(np.float64, 7, elements=st.floats(-0.8, 0.8))


def drifted(true: np.ndarray, seed: int = 0, growth: float = 0.003) -> tuple[np.ndarray, list[Edge]]:
    """The path as its noisy odometry factors chain up: metric nodes whose scale creeps."""
    rng = np.random.default_rng(seed)
    nodes, odometry = [true[0]], []
    for k in range(len(true) - 1):
        noise = exponential(CHAIN * rng.normal(size=7) + growth * np.eye(7)[6])
        odometry.append(Edge(k, k + 1, np.linalg.inv(true[k]) @ true[k + 1] @ noise, np.diag(CHAIN**-2)))
        nodes.append(nodes[-1] @ odometry[-1].first_from_second)
    return np.stack(nodes), odometry


def loop(true: np.ndarray, first: int, second: int) -> Edge:
    return Edge(first, second, np.linalg.inv(true[first]) @ true[second], np.diag(LOOP**-2))


def test_a_loop_takes_back_drift_in_place_and_scale():
    true = circle()
    nodes, odometry = drifted(true)
    end = np.linalg.norm(nodes[-1, :3, 3] - true[-1, :3, 3])
    solution = solve_pose_graph(nodes, odometry, [loop(true, 0, 29), loop(true, 1, 28)])
    assert solution.accepted.all()
    assert end > 0.3
    assert abs(np.log(scale_of(nodes[-1]))) > 0.07
    assert np.linalg.norm(solution.world_from_node[-1, :3, 3] - true[-1, :3, 3]) < end / 10
    assert abs(np.log(scale_of(solution.world_from_node[-1]))) < 0.03
    np.testing.assert_allclose(solution.world_from_node[0], nodes[0], atol=1e-6)


def test_false_loops_are_given_no_weight():
    true = circle()
    nodes, odometry = drifted(true)
    honest = [loop(true, 0, 29), loop(true, 1, 28), loop(true, 2, 27)]
    lies = [Edge(5, 20, np.eye(4), np.diag(LOOP**-2)), Edge(8, 24, exponential(np.full(7, 0.3)), np.diag(LOOP**-2))]
    with_lies = solve_pose_graph(nodes, odometry, [*honest, *lies])
    assert with_lies.accepted.tolist() == [True, True, True, False, False]
    without = solve_pose_graph(nodes, odometry, honest)
    np.testing.assert_allclose(with_lies.world_from_node, without.world_from_node, atol=0.01)


def test_no_loop_moves_nothing():
    nodes, odometry = drifted(circle())
    assert np.array_equal(solve_pose_graph(nodes, odometry, []).world_from_node, nodes)


def test_two_runs_agree_to_the_bit():
    true = circle()
    nodes, odometry = drifted(true)
    runs = [solve_pose_graph(nodes, odometry, [loop(true, 0, 29), loop(true, 1, 28)]).world_from_node for _ in range(2)]
    assert np.array_equal(*runs)


def test_scipy_finds_the_same_optimum():
    """SciPy minimises the same residuals written with matrix logarithms, knowing nothing of GTSAM."""
    true = circle(4)
    nodes, odometry = drifted(true, seed=3)
    edges = [*odometry, loop(true, 0, 3)]
    solved = solve_pose_graph(nodes, odometry, edges[-1:]).world_from_node

    def log(matrix: np.ndarray) -> np.ndarray:
        g = np.real(logm(matrix))
        turn = np.array([g[2, 1] - g[1, 2], g[0, 2] - g[2, 0], g[1, 0] - g[0, 1]]) / 2
        return turn, g[:3, 3], np.trace(g[:3, :3]) / 3

    def cost(x: np.ndarray) -> np.ndarray:
        moved = [nodes[0], *(n @ exponential(t) for n, t in zip(nodes[1:], x.reshape(-1, 7), strict=True))]
        left = []
        for edge in edges:
            off = np.linalg.inv(edge.first_from_second) @ np.linalg.inv(moved[edge.first]) @ moved[edge.second]
            left.append(np.sqrt(np.diag(edge.information)) * np.hstack(log(off)))
        return np.concatenate(left)

    found = least_squares(cost, np.zeros(3 * 7), method="lm", xtol=1e-12, ftol=1e-12).x.reshape(-1, 7)
    expected = np.stack([nodes[0], *(n @ exponential(t) for n, t in zip(nodes[1:], found, strict=True))])
    np.testing.assert_allclose(solved, expected, atol=2e-4)


def test_one_loop_alone_is_not_consistent():
    true = circle()
    nodes, _ = drifted(true)
    pair = [loop(true, 0, 29), loop(true, 2, 27)]
    assert consistent_loops(pair[:1], nodes, nodes, 5).tolist() == [False]
    assert consistent_loops(pair, nodes, nodes, 5).tolist() == [True, True]
    assert consistent_loops(pair, nodes, nodes, 1).tolist() == [False, False]  # too far apart to speak of each other
    lie = Edge(1, 28, pair[0].first_from_second @ exponential(np.array([0, 0.2, 0, 0, 0, 0, 0])), np.eye(7))
    assert consistent_loops([pair[0], lie], nodes, nodes, 5).tolist() == [False, False]
    same_view = Edge(0, 28, np.linalg.inv(true[0]) @ true[28], np.eye(7))
    assert consistent_loops([pair[0], same_view], nodes, nodes, 5).tolist() == [False, False]


def test_information_is_that_of_the_fitted_similarity():
    """Monte Carlo: the scatter of similarities fitted to noisy points is the inverse of the information."""
    rng = np.random.default_rng(0)
    points = rng.normal(size=(60, 3)) * [1, 1, 0.4] + [0, 0, 3]
    sigma = np.full(60, 0.01)
    information = sim3_information(points, sigma, sigma, np.full(7, 1e3))
    fitted = []
    for _ in range(200):
        noisy = points + 0.01 * rng.normal(size=points.shape)
        rows = []
        for p in points:
            turn = [[0, p[2], -p[1]], [-p[2], 0, p[0]], [p[1], -p[0], 0]]  # -[p]x
            rows.append(np.hstack([turn, np.eye(3), p[:, None]]))
        fitted.append(np.linalg.lstsq(np.concatenate(rows), (noisy - points).ravel(), rcond=None)[0])
    ratio = np.std(fitted, axis=0) / np.sqrt(np.diag(np.linalg.inv(information)))
    np.testing.assert_allclose(ratio, 1, atol=0.15)


def test_what_points_leave_free_has_next_to_no_information():
    """Points on one ray say nothing of the roll about it, and points known across their rays little of the scale."""
    points = np.array([[0, 0, 2.0], [0, 0, 3.0], [0, 0, 4.0]])
    information = sim3_information(points, np.full(3, 0.01), np.full(3, 0.01))
    assert information[2, 2] < 30 < 1e4 < information[0, 0]
    deep = sim3_information(np.array([[1, 0, 3.0], [0, 1, 3.0], [-1, -1, 3.0]]), np.full(3, 0.01), np.full(3, 1e3))
    assert np.sqrt(np.linalg.inv(deep)[6, 6]) > 0.1


def test_common_errors_limit_what_many_points_promise():
    many = np.diag(np.full(7, 1e12))
    limited = with_common_error(many, np.full(7, 0.01))
    np.testing.assert_allclose(np.diag(np.linalg.inv(limited)), 1e-4, rtol=1e-3)


@settings(max_examples=30, deadline=None)
@given(TANGENTS, TANGENTS)
def test_residual_is_zero_where_the_edge_holds_and_is_its_own_tangent(here, off):
    nodes = np.stack([exponential(here), exponential(here) @ exponential(off)])
    held = Edge(0, 1, exponential(off), np.eye(7))
    np.testing.assert_allclose(residual(nodes, held), 0, atol=1e-9)
    np.testing.assert_allclose(residual(nodes, Edge(0, 1, np.eye(4), np.eye(7))), off, atol=1e-7)
    assert chi2(nodes, Edge(0, 1, np.eye(4), np.eye(7))) == pytest.approx(off @ off, abs=1e-6)


@settings(max_examples=30, deadline=None)
@given(TANGENTS, TANGENTS, st.floats(0, 1))
def test_interpolation_runs_from_one_to_the_other(first, off, share):
    start = exponential(first)
    end = start @ exponential(off)
    np.testing.assert_allclose(interpolate_sim3(start, end, 0.0), start, atol=1e-12)
    np.testing.assert_allclose(interpolate_sim3(start, end, 1.0), end, atol=1e-8)
    np.testing.assert_allclose(interpolate_sim3(start, end, share), start @ exponential(share * off), atol=1e-8)
