"""Depth metrics against literal loops, and the conventions against what they must not change."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy.stats import spearmanr

from completion.evaluation.metrics import average, depth_errors, simcol3d_errors
from completion.evaluation.uncertainty import PixelErrors, calibrate
from haustra.core.errors import CompletionError

DEPTHS = arrays(np.float64, (5, 6), elements=st.floats(1.0, 100.0))


@given(prediction=DEPTHS, truth=DEPTHS, holes=arrays(np.bool_, (5, 6)))
@settings(max_examples=50, deadline=None)
def test_errors_equal_a_literal_loop(prediction: np.ndarray, truth: np.ndarray, holes: np.ndarray) -> None:
    holes[0, 0] = False
    truth = np.where(holes, 0, truth)
    squares, relative, absolute, inside = [], [], [], [0, 0, 0]
    for p, g in zip(prediction.ravel(), truth.ravel()):
        if g == 0:
            continue
        squares.append((p - g) ** 2)
        absolute.append(abs(p - g))
        relative.append(abs(p - g) / g)
        for power in (1, 2, 3):
            inside[power - 1] += max(p / g, g / p) < 1.25**power
    count = len(squares)
    errors = depth_errors(prediction, truth)
    assert errors.rmse == pytest.approx(math.sqrt(math.fsum(squares) / count))
    assert errors.mae == pytest.approx(math.fsum(absolute) / count)
    assert errors.abs_rel == pytest.approx(math.fsum(relative) / count)
    assert (errors.delta_1, errors.delta_2, errors.delta_3) == pytest.approx([n / count for n in inside])
    assert (errors.pixels, errors.missing) == (count, 0)


@pytest.mark.parametrize("alignment", ["median", "least_squares", "points"])
@given(truth=DEPTHS, factor=st.floats(0.1, 10.0))
@settings(max_examples=20, deadline=None)
def test_alignment_finds_a_lost_factor(alignment: str, truth: np.ndarray, factor: float) -> None:
    errors = depth_errors(truth * factor, truth, alignment, sparse=truth)  # type: ignore[arg-type]
    assert errors.abs_rel == pytest.approx(0, abs=1e-9)
    assert errors.scale == pytest.approx(1 / factor)


def test_missing_predictions_are_counted_not_hidden() -> None:
    truth = np.full((4, 4), 10.0)
    prediction = np.full((4, 4), 11.0)
    prediction[0] = [0, -1, np.nan, np.inf]
    errors = depth_errors(prediction, truth)
    assert (errors.pixels, errors.missing) == (12, 4)
    assert errors.abs_rel == pytest.approx(0.1)


def test_per_frame_and_pooled_means_differ_as_they_should() -> None:
    small = depth_errors(np.array([[11.0]]), np.array([[10.0]]))
    large = depth_errors(np.full((1, 3), 13.0), np.full((1, 3), 10.0))
    assert average([small, large]).mae == pytest.approx(2.0)
    assert average([small, large], "pooled").mae == pytest.approx(2.5)
    assert average([small, large], "pooled").rmse == pytest.approx(math.sqrt((1 + 3 * 9) / 4))


def test_simcol3d_takes_one_scale_for_the_trajectory() -> None:
    rng = np.random.default_rng(0)
    truths = [rng.uniform(5, 50, (8, 8)) for _ in range(4)]
    errors = simcol3d_errors(lambda: [(0.5 * truth, truth) for truth in truths])
    assert (errors.scale, errors.l1, errors.rmse, errors.median_relative) == pytest.approx((2, 0, 0, 0), abs=1e-9)
    uneven = simcol3d_errors(lambda: [(truth * (1 + 0.1 * i), truth) for i, truth in enumerate(truths)])
    assert uneven.median_relative > 0.03  # a scale per frame would hide it


def pixels(predicted, actual, depth):
    """Of relative errors that are predicted and that are made, too near."""
    return PixelErrors(predicted, depth, depth / (1 - np.minimum(actual, 0.9)))


def test_calibration_of_a_perfect_and_of_a_useless_confidence() -> None:
    rng = np.random.default_rng(0)
    predicted = np.exp(rng.uniform(-7, -3, 20_000))
    actual, depth = np.abs(rng.laplace(0, predicted)), np.exp(rng.uniform(1, 4, 20_000))
    perfect = calibrate(
        [pixels(predicted[part], actual[part], depth[part]) for part in (slice(10_000), slice(10_000, None))]
    )
    assert perfect.within_one == pytest.approx(1 - math.exp(-1), abs=0.01)
    np.testing.assert_allclose(np.array(perfect.actual) / perfect.predicted, math.log(2), rtol=0.15)
    assert perfect.spearman > 0.5
    assert perfect.spearman_if_exact == pytest.approx(perfect.spearman, abs=0.02)
    useless = calibrate([pixels(predicted, rng.permutation(actual), depth)])
    assert abs(useless.spearman) < 0.03
    assert useless.spearman_if_exact == pytest.approx(perfect.spearman_if_exact)
    even = calibrate([pixels(np.exp(rng.normal(-3, 0.1, 20_000)), actual, depth)])
    assert even.spearman_if_exact < 0.15  # errors that are expected to be alike cannot be ranked


def test_error_in_the_unit_of_depth_is_ranked_by_depth_too() -> None:
    rng = np.random.default_rng(1)
    predicted, depth = np.exp(rng.normal(-5, 0.5, 20_000)), np.exp(rng.normal(3, 0.7, 20_000))
    actual = np.abs(rng.laplace(0, predicted))
    found = calibrate([pixels(predicted, actual, depth)])
    expected = spearmanr(predicted * depth, actual * depth / (1 - np.minimum(actual, 0.9))).statistic
    assert found.spearman_absolute == pytest.approx(expected)
    assert found.spearman_absolute_if_exact == pytest.approx(found.spearman_absolute, abs=0.02)
    assert found.spearman + 0.05 < found.spearman_depth_alone < found.spearman_absolute - 0.05
    elsewhere = calibrate([pixels(predicted, actual, 1000 * depth)])
    assert elsewhere.spearman_absolute == pytest.approx(found.spearman_absolute)  # whatever the unit
    # A prediction that says nothing is ranked by depth alone, and no better.
    useless = calibrate([pixels(np.full(20_000, 0.01), actual, depth)])
    assert useless.spearman_absolute == pytest.approx(useless.spearman_depth_alone)


def test_what_cannot_be_judged_is_said() -> None:
    with pytest.raises(CompletionError, match="differ in size"):
        depth_errors(np.ones((2, 2)), np.ones((3, 3)))
    with pytest.raises(CompletionError, match="no pixel"):
        depth_errors(np.ones((2, 2)), np.zeros((2, 2)))
    with pytest.raises(CompletionError, match="needs the sparse depth"):
        depth_errors(np.ones((2, 2)), np.ones((2, 2)), "points")
    with pytest.raises(CompletionError, match="no frames"):
        average([])
