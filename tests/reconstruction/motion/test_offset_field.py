"""The deformation graph against SciPy's splines and a dense least-squares solution."""

import numpy as np
import pytest
from scipy.interpolate import BSpline
from scipy.sparse import csr_array

from reconstruction.motion.offset_field import fit_offsets, make_field


def wall(rng, count=200):
    return np.column_stack([rng.uniform(-1, 1, (count, 2)), 1 + 0.1 * rng.standard_normal(count)])


def test_weights_are_shares():
    rng = np.random.default_rng(0)
    points, seconds = wall(rng), np.sort(rng.uniform(2, 9, 200))
    field = make_field(points, seconds, 12, 0.5)
    weights = field.weights(points, seconds)
    assert weights.shape == (200, field.size)
    assert np.allclose(weights.sum(axis=1), 1)
    assert weights.data.min() >= 0


def test_a_node_moves_as_scipys_spline():
    rng = np.random.default_rng(1)
    points = wall(rng)
    field = make_field(points, np.array([0.0, 4.0]), 1, 0.5)
    coefficients, times = rng.standard_normal((field.size, 3)), np.linspace(0, 4, 33)
    expected = BSpline(field.knots, coefficients, 3)(np.minimum(times, 4 - 1e-12))
    assert np.allclose(field.weights(points[:33], times) @ coefficients, expected)


def test_nodes_lie_apart_and_leave_wild_points_out():
    rng = np.random.default_rng(2)
    points = np.concatenate([wall(rng), [[900.0, 0, 0], [0, -700.0, 0]]])
    field = make_field(points, np.array([0.0, 4.0]), 20, 0.5)
    assert len(field.nodes) == 20
    assert np.abs(field.nodes).max() < 2
    assert field.spacing > 0.2  # of 20 on a square of side 2


def test_points_far_from_all_nodes_move_with_the_nearest():
    field = make_field(wall(np.random.default_rng(3)), np.array([0.0, 4.0]), 20, 0.5)
    far = 1e4 * (field.nodes[7] - field.nodes.mean(axis=0)) + field.nodes[7]
    nearest = np.argmin(np.linalg.norm(field.nodes - far, axis=1))
    weights = field.node_weights(far[None]).toarray()[0]
    assert np.isfinite(weights).all()
    assert np.argmax(weights) == nearest


@pytest.mark.parametrize("sigma", [0.05, 10.0])
def test_the_fit_is_that_of_dense_least_squares(sigma):
    rng = np.random.default_rng(4)
    count, size = 80, 5
    weights = csr_array(rng.dirichlet(np.ones(size), count))
    jacobian, residual, weight = rng.standard_normal((count, 2, 3)), rng.standard_normal((count, 2)), rng.random(count)
    root = np.sqrt(weight)[:, None]
    rows = np.einsum("ms,mik->misk", weights.toarray() * root, jacobian).reshape(2 * count, -1)
    system = np.concatenate([rows, np.eye(3 * size) / sigma])
    side = np.concatenate([-(residual * root).ravel(), np.zeros(3 * size)])
    expected = np.linalg.lstsq(system, side, rcond=None)[0].reshape(size, 3)
    assert np.allclose(fit_offsets(weights, jacobian, residual, weight, sigma), expected, atol=1e-2)
