"""The cameras' part of a bundle adjustment, against NumPy's full matrices."""

import numpy as np
import pytest

from pipeline.optimization import schur
from pipeline.optimization.bundle_adjustment import _inverse_root
from pipeline.optimization.kernels import halved, onto_cameras, onto_points
from pipeline.optimization.schur import Coupling, Symmetric, check_sorted, gram, solve


def half_matrix(rng, cameras: int, reach: int, points_each: int = 12) -> tuple[np.ndarray, Coupling]:
    """Blocks, and the points of the cameras: these are seen by cameras at most `reach` numbers apart, some by one
    alone, some by none."""
    points = cameras * points_each
    home = np.arange(points) // points_each
    sees = (np.abs(np.arange(cameras)[:, None] - home) <= reach / 2) & (rng.random((cameras, points)) < 0.7)
    camera, point = (np.ascontiguousarray(k) for k in np.nonzero(sees))
    return rng.normal(size=(len(camera), 3, 6)), Coupling.of(camera, point, cameras, points)


def full(half: np.ndarray, coupling: Coupling) -> np.ndarray:
    cameras, points = len(coupling.starts) - 1, len(coupling.begins) - 1
    matrix = np.zeros((cameras, 6, points, 3))
    np.add.at(matrix, (coupling.camera, slice(None), coupling.point), half.transpose(0, 2, 1))
    return matrix.reshape(6 * cameras, -1)


def positive_definite(rng, row: np.ndarray, column: np.ndarray, cameras: int) -> Symmetric:
    """Sums of rank-one blocks that tie pairs of cameras, and a little on the diagonal."""
    diagonal, blocks = np.tile(0.1 * np.eye(6), (cameras, 1, 1)), np.zeros((len(row), 6, 6))
    for k, (one, other) in enumerate(zip(row, column, strict=True)):
        tie = rng.normal(size=(12, 14))
        square = tie @ tie.T
        diagonal[one] += square[:6, :6]
        diagonal[other] += square[6:, 6:]
        blocks[k] = square[:6, 6:]
    return Symmetric(diagonal, blocks, row, column)


@pytest.mark.parametrize("few", [0, 10**9], ids=["threads", "one thread"])
@pytest.mark.parametrize("cameras", [1, 9, 75])
def test_the_product_is_that_of_the_full_matrix(monkeypatch, few, cameras):
    half, coupling = half_matrix(np.random.default_rng(0), cameras, 20)
    monkeypatch.setattr(schur, "FEW", few)
    expected = full(half, coupling) @ full(half, coupling).T
    np.testing.assert_allclose(gram(half, coupling).full(), expected, atol=1e-10)


def test_a_camera_that_sees_nothing_leaves_zeros():
    rng = np.random.default_rng(1)
    _, coupling = half_matrix(rng, 40, 6)
    rows = coupling.camera != 35
    coupling = Coupling.of(coupling.camera[rows], coupling.point[rows], 41, len(coupling.begins) - 1)
    half = rng.normal(size=(rows.sum(), 3, 6))
    found = gram(half, coupling).full()
    np.testing.assert_allclose(found, full(half, coupling) @ full(half, coupling).T, atol=1e-10)
    assert not found[6 * 35 : 6 * 36].any()
    assert not found[6 * 40 :].any()


def test_a_camera_that_sees_one_point_twice_is_counted_twice():
    """Two tracks that became one leave two observations in a keyframe."""
    rng = np.random.default_rng(5)
    camera, point = np.array([0, 0, 0, 1, 1]), np.array([2, 0, 2, 2, 1])
    coupling, half = Coupling.of(camera, point, 2, 3), rng.normal(size=(5, 3, 6))
    expected = full(half, coupling) @ full(half, coupling).T
    np.testing.assert_allclose(gram(half, coupling).full(), expected, atol=1e-12)


@pytest.mark.parametrize(("camera", "point"), [([1, 0], [0, 1]), ([0, 2], [0, 1]), ([0, 1], [0, 3]), ([0, 1], [-1, 0])])
def test_what_the_kernels_could_not_index_is_refused(camera, point):
    with pytest.raises(ValueError, match="sorted by camera"):
        check_sorted(np.array(camera), np.array(point), 2, 3)


def test_vectors_go_through_the_same_matrix():
    rng = np.random.default_rng(6)
    half, of = half_matrix(rng, 12, 6)
    matrix, cameras, points = full(half, of), 12, len(of.begins) - 1
    values = rng.normal(size=(points, 3))
    found = onto_cameras(half, of.camera, of.point, values, cameras)
    np.testing.assert_allclose(found.ravel(), matrix @ values.ravel(), atol=1e-12)
    values = rng.normal(size=(cameras, 6))
    found = onto_points(half, of.camera, of.point, values, points)
    np.testing.assert_allclose(found.ravel(), matrix.T @ values.ravel(), atol=1e-12)


def test_blocks_are_multiplied_by_the_root_of_their_point():
    rng = np.random.default_rng(7)
    cross, root = rng.normal(size=(20, 6, 3)), np.triu(rng.normal(size=(5, 3, 3)))
    point = rng.integers(0, 5, 20)
    np.testing.assert_allclose(halved(cross, root, point).transpose(0, 2, 1), cross @ root[point], atol=1e-12)


def test_the_inverse_of_a_block_is_its_root_times_the_roots_transpose():
    rng = np.random.default_rng(4)
    blocks = rng.normal(size=(200, 3, 5)) * np.exp(rng.uniform(-8, 8, (200, 1, 1)))
    blocks = blocks @ blocks.transpose(0, 2, 1)
    root = _inverse_root(blocks)
    np.testing.assert_allclose(root @ root.transpose(0, 2, 1) @ blocks, np.tile(np.eye(3), (200, 1, 1)), atol=1e-6)
    assert np.isnan(_inverse_root(-np.eye(3)[None])).any()


@pytest.mark.parametrize("ties", ["chain", "circle", "everything", "apart"])
def test_it_solves_whatever_the_cameras_are_tied_to(ties):
    """A chain and a circle go through the banded solver, everything tied to everything through the full one."""
    rng, cameras = np.random.default_rng(2), 40
    one, other = np.triu_indices(cameras, 1)
    near = {
        "chain": other - one <= 3,
        "circle": np.minimum(other - one, cameras - other + one) <= 2,
        "everything": np.ones(len(one), bool),
        "apart": (other - one <= 2) & ((one < 20) == (other < 20)),
    }[ties]
    shuffled = rng.permutation(cameras)  # the order of the cameras does not help
    row, column = np.sort(shuffled[np.stack([one[near], other[near]])], axis=0)
    matrix = positive_definite(rng, row, column, cameras)
    side = rng.normal(size=(cameras, 6))
    expected = np.linalg.solve(matrix.full(), side.ravel()).reshape(-1, 6)
    found = solve(matrix, side)
    assert found is not None
    np.testing.assert_allclose(found, expected, rtol=1e-7, atol=1e-9)


def test_a_film_that_comes_back_stays_in_a_narrow_band():
    """A circle of cameras, laid flat: twice the width of a chain, however long it is."""
    cameras = np.arange(500)
    row, column = np.sort(np.stack([cameras, (cameras + 1) % 500]), axis=0)
    matrix = Symmetric(np.tile(np.eye(6), (500, 1, 1)), np.zeros((500, 6, 6)), row, column)
    place = matrix.ordered()
    assert sorted(place) == list(range(500))
    assert np.abs(place[row] - place[column]).max() <= 2


def test_some_of_the_cameras_alone():
    rng = np.random.default_rng(3)
    matrix = positive_definite(rng, np.array([0, 1, 2, 0]), np.array([1, 2, 3, 3]), 4)
    kept = np.array([0, 2, 3])
    expected = matrix.full().reshape(4, 6, 4, 6)[kept][:, :, kept].reshape(18, 18)
    np.testing.assert_array_equal(matrix.among(kept).full(), expected)


@pytest.mark.parametrize("cameras", [2, 30])
def test_what_is_not_positive_definite_is_refused(cameras):
    one = np.arange(cameras - 1)
    matrix = Symmetric(-np.tile(np.eye(6), (cameras, 1, 1)), np.zeros((cameras - 1, 6, 6)), one, one + 1)
    assert solve(matrix, np.ones((cameras, 6))) is None
