"""Depth corrected by what it misses its points by: against the formula of kriging, and on fields of known errors."""

import numpy as np
import pytest

from completion.confidence import error_from_confidence
from completion.inference import completer as completer_module
from completion.inference import kriging
from completion.inference.completer import DepthCompleter
from completion.inference.kriging import EXPLAINED, UNEXPLAINED, explained_share, towards_points

SIZE = 64


def slanted_wall(height, width):
    """In mm, and what an estimate misses it by, of log depth."""
    rows, columns = np.mgrid[:height, :width]
    return (20 + 0.2 * columns + 0.1 * rows).astype(np.float32), 0.03 * np.sin(columns / 12) * np.cos(rows / 15)


ROWS, COLUMNS = np.mgrid[:SIZE, :SIZE]
WALL, WAVE = slanted_wall(SIZE, SIZE)
EXPECTED = np.full(WALL.shape, 0.02, np.float32)


def points_of(truth, count=200, noise=0.003, told=0.004, seed=0):
    """Sparse depth and its errors at random pixels."""
    rng = np.random.default_rng(seed)
    at = np.unravel_index(rng.choice(truth.size, count, replace=False), truth.shape)
    sparse, error = np.zeros((2, *truth.shape), np.float32)
    sparse[at] = truth[at] * np.exp(noise * rng.normal(size=count))
    error[at] = told
    return sparse, error


def off(depth, truth=WALL):
    return np.abs(np.log(depth / truth))


@pytest.mark.parametrize("shape", [(64, 64), (48, 96), (96, 48)])
def test_it_is_simple_kriging(monkeypatch, shape):
    """Every pixel by the formula, without the grid and with Gaussian errors of the points."""
    monkeypatch.setattr(kriging, "TAIL", 1e6)
    wall, wave = slanted_wall(*shape)
    estimate, rows, columns = (wall * np.exp(wave)).astype(np.float32), *np.indices(shape)
    sparse, error = points_of(wall, told=0.06)
    at = np.nonzero(sparse)

    def covariance(one, other):
        (y, x, z), (v, u, w) = one, other
        apart = np.hypot(y[:, None] - v[None], x[:, None] - u[None]) / max(shape)
        return (1.5 * 0.02) ** 2 * np.exp(-apart / 0.2 - np.abs(z[:, None] - w[None]) / 0.3)

    log_depth = np.log(estimate.astype(np.float64))
    points, pixels = (*at, log_depth[at]), (rows.ravel(), columns.ravel(), log_depth.ravel())
    missed = np.log(sparse[at]) - log_depth[at]
    weights = np.linalg.inv(covariance(points, points) + np.diag((0.35 * error[at].astype(float)) ** 2)) @ missed
    expected = estimate * np.exp(covariance(pixels, points) @ weights).reshape(shape)
    found = towards_points(estimate, np.full_like(wall, 0.02), sparse, error)
    assert off(found, expected).max() < 0.003  # of the grid
    assert off(found, expected).mean() < 0.04 * off(estimate, expected).mean()


@pytest.mark.parametrize(("expected", "single"), [(0.02, True), (0.1, True), (0.7, False), (1e4, False)])
def test_single_precision_says_what_double_does_and_is_used_up_to_a_limit(monkeypatch, expected, single):
    """A thousand points within 32 pixels."""
    estimate, near = (WALL * np.exp(WAVE)).astype(np.float32), (ROWS < 32) & (COLUMNS < 32)
    sparse, error = (np.where(near, image, np.float32(0)) for image in points_of(WALL, 4096, told=0.004))
    doubt = np.full_like(WALL, expected)
    found = towards_points(estimate, doubt, sparse, error, most_points=4096)
    monkeypatch.setattr(kriging, "SINGLE_PRECISION", 0)
    double = towards_points(estimate, doubt, sparse, error, most_points=4096)
    assert np.array_equal(found, double) != single
    assert off(found, double).max() < 1e-5
    assert off(double, estimate).max() > 0.02


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


@pytest.mark.parametrize(("behind", "most"), [(14.0, 0.011), (20.0, 0.004), (60.0, 0.0005)])
def test_the_wall_behind_a_fold_stays_the_more_the_farther_it_is(behind, most):
    """Points of the fold alone say that it is 3 % farther; of that exp(-log(depths' ratio) / 0.3) reaches the wall."""
    fold = COLUMNS < SIZE // 2
    truth = np.where(fold, 10, behind).astype(np.float32)
    sparse, error = points_of(1.03 * truth)
    sparse[~fold] = error[~fold] = 0
    found = towards_points(truth, 2.5 * EXPECTED, sparse, error) / truth
    assert found[fold].mean() == pytest.approx(1.03, abs=0.005)
    assert 0 < found[~fold].max() - 1 < most


def test_a_point_that_the_others_contradict_moves_little():
    sparse, error = points_of(WALL, noise=0.0)
    sparse[32, 32], error[32, 32] = 1.4 * WALL[32, 32], 0.004
    assert off(towards_points(WALL, EXPECTED, sparse, error)).max() < 0.01


@pytest.mark.parametrize("count", [200, 2000])
def test_what_neither_the_points_nor_the_estimate_explain_is_left_as_it_is(count, monkeypatch):
    """As where the wall moves: points all over are off by ten times their errors. However many they are: the mean of
    merged ones is off by less."""
    sparse, error = points_of(WALL, count, noise=0.05)
    assert np.array_equal(towards_points(WALL, EXPECTED, sparse, error), WALL)
    unexplained = (EXPLAINED + UNEXPLAINED) / 2
    median = 0.6745  # of a Gaussian's deviations, in standard deviations
    between, _ = points_of(WALL, count, noise=unexplained / median * np.hypot(0.02, 0.004))
    change = np.log(towards_points(WALL, EXPECTED, between, error) / WALL)
    monkeypatch.setattr(kriging, "EXPLAINED", 1e3)
    monkeypatch.setattr(kriging, "UNEXPLAINED", 1e4)
    whole = np.log(towards_points(WALL, EXPECTED, between, error) / WALL)
    share = float(np.vdot(change, whole) / np.vdot(whole, whole))
    assert 0.05 < share < 0.95
    np.testing.assert_allclose(change, share * whole, atol=1e-6)


def test_no_depth_is_changed_by_more_than_the_most():
    """Where the network says that it does not know, and all points say that the wall is three times as far."""
    found = towards_points(WALL, np.full_like(WALL, 2), *points_of(3 * WALL)) / WALL
    assert found.max() == pytest.approx(np.exp(0.5), rel=1e-5)


@pytest.mark.parametrize("told", [np.inf, np.nan, 1e6, 1.0])
def test_points_of_unknown_error_are_left_out(told):
    estimate = (WALL * np.exp(WAVE)).astype(np.float32)
    sparse, error = points_of(WALL)
    known = COLUMNS >= 8
    found = towards_points(estimate, EXPECTED, sparse, np.where(known, error, np.float32(told)))
    assert np.array_equal(found, towards_points(estimate, EXPECTED, np.where(known, sparse, 0), error))


def test_depth_that_is_not_finite_stays_and_harms_no_other():
    estimate = (WALL * np.exp(WAVE)).astype(np.float32)
    sparse, error = points_of(WALL)
    broken = (ROWS > 30) & (ROWS < 40) & (COLUMNS > 20)
    found = towards_points(np.where(broken, np.float32(np.inf), estimate), EXPECTED, sparse, error)
    assert np.isinf(found[broken]).all()
    same = towards_points(estimate, EXPECTED, np.where(broken, 0, sparse), error)
    np.testing.assert_allclose(found[~broken], same[~broken], rtol=1e-6)


def test_of_thousands_of_points_the_merged_ones_say_the_same():
    estimate = (WALL * np.exp(WAVE)).astype(np.float32)
    sparse, error = points_of(WALL, count=2000)
    few = towards_points(estimate, EXPECTED, sparse, error)
    all_of_them = towards_points(estimate, EXPECTED, sparse, error, most_points=4000)
    assert off(few, all_of_them).mean() < 0.1 * off(estimate).mean()


@pytest.mark.parametrize(("count", "changes"), [(0, False), (1, False), (2, False), (3, True)])
def test_fewer_than_three_points_change_nothing(count, changes):
    found = towards_points(WALL, EXPECTED, *points_of(1.01 * WALL, count))
    assert np.array_equal(found, WALL) != changes


def test_where_there_is_no_depth_there_is_none_afterwards():
    estimate = np.where(ROWS < 20, 0, WALL * np.exp(WAVE)).astype(np.float32)
    found = towards_points(estimate, EXPECTED, *points_of(WALL))
    assert np.array_equal(found > 0, estimate > 0)


@pytest.mark.parametrize("told", [np.inf, np.nan, 1e30])
def test_a_completer_corrects_nothing_by_points_of_unknown_error(told, monkeypatch):
    """Neither do they explain what the others miss: a third of the points contradict the network, and are sure."""
    completer = DepthCompleter.load("mscsa", "cpu", "fp32", iterations=1)
    rgb = np.clip(4e4 / WALL**2, 0, 255)[..., None].repeat(3, 2).astype(np.uint8)
    sparse, error = points_of(WALL, noise=0.5)
    unsure = np.where(COLUMNS % 3, np.float64(told), error)
    corrected = completer(rgb, sparse, unsure)
    monkeypatch.setattr(completer_module, "towards_points", lambda depth, *_: depth)
    assert np.isfinite(corrected[0]).all()
    assert np.array_equal(corrected[0], completer(rgb, sparse, unsure)[0])


def test_an_expected_error_that_is_no_number_harms_no_other():
    estimate = (WALL * np.exp(WAVE)).astype(np.float32)
    sparse, error = points_of(WALL)
    unknown = COLUMNS < 8
    found = towards_points(estimate, np.where(unknown, np.float32(np.nan), EXPECTED), sparse, error)
    assert np.array_equal(found, towards_points(estimate, EXPECTED, np.where(unknown, 0, sparse), error))


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


def test_a_share_that_is_given_is_applied_whatever_the_points_say():
    """Judged by every second point; of all of them the others contradict the network, and are sure."""
    estimate = (WALL * np.exp(WAVE)).astype(np.float32)
    sparse, error = points_of(WALL)
    wild, _ = points_of(WALL, noise=0.05)
    left = COLUMNS % 2 == 0
    mixed = np.where(left, sparse, wild)
    assert explained_share(estimate, EXPECTED, np.where(left, sparse, 0), error) == 1
    assert explained_share(estimate, EXPECTED, np.where(left, 0, wild), error) == 0
    whole, half = (np.log(towards_points(estimate, EXPECTED, mixed, error, share=s) / estimate) for s in (1.0, 0.5))
    np.testing.assert_allclose(half, whole / 2, atol=1e-6)
    assert np.abs(whole).max() > 0.01
    assert np.array_equal(towards_points(estimate, EXPECTED, sparse, error, share=0.0), estimate)
    nothing = np.zeros_like(sparse)
    assert np.array_equal(towards_points(estimate, EXPECTED, nothing, nothing, share=1.0), estimate)


def test_a_completer_leaves_the_correction_to_the_caller_where_it_is_asked_to():
    completer = DepthCompleter.load("mscsa", "cpu", "fp32", iterations=1)
    rgb = np.clip(4e4 / WALL**2, 0, 255)[..., None].repeat(3, 2).astype(np.uint8)
    frame = [array[None] for array in (rgb, *points_of(WALL))]
    plain, confidence = completer.batch(*frame, corrected=False)
    expected = error_from_confidence(confidence[0], 1e-6)
    corrected, same = completer.batch(*frame)
    assert np.array_equal(same, confidence)
    np.testing.assert_allclose(towards_points(plain[0], expected, *(a[0] for a in frame[1:])), corrected[0], rtol=1e-3)
    assert not np.allclose(plain, corrected, rtol=1e-3)
