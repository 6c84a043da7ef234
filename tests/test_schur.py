"""The cameras' part of a bundle adjustment, against NumPy's full matrices."""

import numpy as np
import pytest

from pipeline.odometry import schur
from pipeline.odometry.bundle import _inverse_root
from pipeline.odometry.schur import Blocks, Symmetric, gram, solve


def half_matrix(rng, cameras: int, reach: int, points_each: int = 12) -> Blocks:
    """Of points that are seen by cameras at most `reach` numbers apart, some by one alone."""
    points = cameras * points_each
    home = np.arange(points) // points_each
    sees = (np.abs(np.arange(cameras)[:, None] - home) <= reach / 2) & (rng.random((cameras, points)) < 0.7)
    camera, point = np.nonzero(sees)
    starts = np.searchsorted(camera, np.arange(cameras + 1))
    return Blocks(rng.normal(size=(len(camera), 6, 3)), point, starts, points)


def full(of: Blocks) -> np.ndarray:
    matrix = np.zeros((of.cameras, 6, of.points, 3))
    matrix[np.repeat(np.arange(of.cameras), np.diff(of.starts)), :, of.point] = of.data
    return matrix.reshape(6 * of.cameras, -1)


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


@pytest.mark.parametrize("limit", [schur.FULL, 0], ids=["full", "sparse"])
@pytest.mark.parametrize("cameras", [1, 9, 75])
def test_the_product_is_that_of_the_full_matrix(monkeypatch, limit, cameras):
    half = half_matrix(np.random.default_rng(0), cameras, 20)
    monkeypatch.setattr(schur, "FULL", limit)
    np.testing.assert_allclose(gram(half).full(), full(half) @ full(half).T, atol=1e-10)


def test_a_camera_that_sees_nothing_leaves_zeros(monkeypatch):
    half = half_matrix(np.random.default_rng(1), 40, 6)
    blind = np.insert(half.starts, 35, half.starts[35])  # one more, between the others, in the last lot
    half = Blocks(half.data, half.point, blind, half.points)
    for limit in (0, schur.FULL):
        monkeypatch.setattr(schur, "FULL", limit)
        found = gram(half).full()
        np.testing.assert_allclose(found, full(half) @ full(half).T, atol=1e-10)
        assert not found[6 * 35 : 6 * 36].any()


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
