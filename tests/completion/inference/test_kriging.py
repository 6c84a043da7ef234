"""Depth corrected by what it misses its points by: against the formula of kriging, and on fields of known errors."""

import numpy as np
import pytest

from completion.inference import completer as completer_module
from completion.inference import kriging
from completion.inference.completer import DepthCompleter
from completion.inference.kriging import towards_points

SIZE = 64
ROWS, COLUMNS = np.mgrid[:SIZE, :SIZE]
WALL = (20 + 0.2 * COLUMNS + 0.1 * ROWS).astype(np.float32)  # mm, slanted
WAVE = 0.03 * np.sin(COLUMNS / 12) * np.cos(ROWS / 15)  # of log depth: what an estimate misses the wall by
EXPECTED = np.full(WALL.shape, 0.02, np.float32)


def points_of(truth, count=200, noise=0.003, told=0.004, seed=0):
    """Sparse depth and its errors at random pixels."""
    rng = np.random.default_rng(seed)
    at = np.unravel_index(rng.choice(SIZE * SIZE, count, replace=False), (SIZE, SIZE))
    sparse, error = np.zeros((2, SIZE, SIZE), np.float32)
    sparse[at] = truth[at] * np.exp(noise * rng.normal(size=count))
    error[at] = told
    return sparse, error


def off(depth, truth=WALL):
    return np.abs(np.log(depth / truth))


def test_it_is_simple_kriging(monkeypatch):
    """Every pixel by the formula, without the grid and with Gaussian errors of the points."""
    monkeypatch.setattr(kriging, "TAIL", 1e6)
    estimate = (WALL * np.exp(WAVE)).astype(np.float32)
    sparse, error = points_of(WALL, told=0.02)
    at = np.nonzero(sparse)

    def covariance(one, other):
        (y, x, z), (v, u, w) = one, other
        apart = np.hypot(y[:, None] - v[None], x[:, None] - u[None]) / SIZE
        return (1.5 * 0.02) ** 2 * np.exp(-apart / 0.2 - np.abs(z[:, None] - w[None]) / 0.3)

    log_depth = np.log(estimate.astype(np.float64))
    points, pixels = (*at, log_depth[at]), (ROWS.ravel(), COLUMNS.ravel(), log_depth.ravel())
    missed = np.log(sparse[at]) - log_depth[at]
    weights = np.linalg.inv(covariance(points, points) + np.diag(error[at].astype(float) ** 2)) @ missed
    expected = estimate * np.exp(covariance(pixels, points) @ weights).reshape(SIZE, SIZE)
    found = towards_points(estimate, EXPECTED, sparse, error)
    assert off(found, expected).max() < 0.003  # of the grid
    assert off(found, expected).mean() < 0.02 * off(estimate, expected).mean()


def test_an_estimate_that_is_off_smoothly_comes_near_the_wall():
    estimate = (WALL * np.exp(WAVE)).astype(np.float32)
    found = towards_points(estimate, EXPECTED, *points_of(WALL))
    assert off(found).mean() < 0.35 * off(estimate).mean()
    assert found.dtype == np.float32


@pytest.mark.parametrize("factor", [0.0123, 1000.0])
@pytest.mark.parametrize("count", [200, 2000])
def test_it_has_no_unit(factor, count):
    estimate = (WALL * np.exp(WAVE)).astype(np.float32)
    sparse, error = points_of(WALL, count)
    scaled = towards_points(np.float32(factor) * estimate, EXPECTED, np.float32(factor) * sparse, error)
    np.testing.assert_allclose(scaled, factor * towards_points(estimate, EXPECTED, sparse, error), rtol=2e-5)


def test_the_wall_behind_a_fold_stays():
    """Points of the fold alone say that it is 3 % farther."""
    fold = COLUMNS < SIZE // 2
    truth = np.where(fold, 10, 60).astype(np.float32)
    sparse, error = points_of(1.03 * truth)
    sparse[~fold] = error[~fold] = 0
    found = towards_points(truth, 2.5 * EXPECTED, sparse, error) / truth
    assert found[fold].mean() == pytest.approx(1.03, abs=0.005)
    assert np.abs(found[~fold] - 1).max() < 0.003


def test_a_point_that_the_others_contradict_moves_little():
    sparse, error = points_of(WALL, noise=0.0)
    sparse[32, 32], error[32, 32] = 1.4 * WALL[32, 32], 0.004
    assert off(towards_points(WALL, EXPECTED, sparse, error)).max() < 0.01


def test_what_neither_the_points_nor_the_estimate_explain_is_left_as_it_is():
    """As where the wall moves: points all over are off by ten times their errors."""
    sparse, error = points_of(WALL, noise=0.05)
    assert np.array_equal(towards_points(WALL, EXPECTED, sparse, error), WALL)
    half, _ = points_of(WALL, noise=0.0230)  # between `EXPLAINED` and `UNEXPLAINED`
    full = off(towards_points(WALL, 10 * EXPECTED, half, error)).mean()
    assert 0 < off(towards_points(WALL, EXPECTED, half, error)).mean() < full


def test_of_thousands_of_points_the_merged_ones_say_the_same(monkeypatch):
    estimate = (WALL * np.exp(WAVE)).astype(np.float32)
    sparse, error = points_of(WALL, count=2000)
    few = towards_points(estimate, EXPECTED, sparse, error)
    monkeypatch.setattr(kriging, "MOST_POINTS", 4000)
    all_of_them = towards_points(estimate, EXPECTED, sparse, error)
    assert off(few, all_of_them).mean() < 0.1 * off(estimate).mean()


@pytest.mark.parametrize("count", [0, 2])
def test_without_points_nothing_changes(count):
    assert np.array_equal(towards_points(WALL, EXPECTED, *points_of(1.1 * WALL, count)), WALL)


def test_where_there_is_no_depth_there_is_none_afterwards():
    estimate = np.where(ROWS < 20, 0, WALL * np.exp(WAVE)).astype(np.float32)
    found = towards_points(estimate, EXPECTED, *points_of(WALL))
    assert np.array_equal(found > 0, estimate > 0)


def test_a_completer_follows_points_whose_errors_are_told(monkeypatch):
    completer = DepthCompleter.load("mscsa", "cpu", "fp32", iterations=1)
    rgb = np.clip(4e4 / WALL**2, 0, 255)[..., None].repeat(3, 2).astype(np.uint8)
    sparse, error = points_of(WALL)
    told, untold = completer(rgb, sparse, error), completer(rgb, sparse)
    assert np.median(off(told[0])) < np.median(off(untold[0]))
    monkeypatch.setattr(completer_module, "towards_points", lambda depth, *_: depth)
    assert np.array_equal(completer(rgb, sparse)[0], untold[0])
    assert not np.array_equal(completer(rgb, sparse, error)[0], told[0])
    assert np.array_equal(completer(rgb, sparse, error)[1], told[1])  # the confidence stays the network's
