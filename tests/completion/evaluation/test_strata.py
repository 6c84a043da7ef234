"""Errors by stratum on pictures whose strata are known."""

from __future__ import annotations

import math

import numpy as np
import pytest

from completion.evaluation.strata import frame_strata, merged_strata, strata_masks

SIZE = 100


def scene() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """rgb, truth, sparse: near left third, far right third beyond a step, burnt rows, one point in the middle."""
    truth = np.full((SIZE, SIZE), 20.0, np.float32)
    truth[:, :20], truth[:, 80:] = 4.0, 50.0
    rgb = np.full((SIZE, SIZE, 3), 120, np.uint8)
    rgb[:10] = (255, 250, 90)
    rgb[10:20] = (255, 120, 90)  # one channel that clips is no burn
    sparse = np.zeros((SIZE, SIZE), np.float32)
    sparse[50, 50] = 20.0
    return rgb, truth, sparse


def test_masks_are_where_the_scene_says() -> None:
    masks = strata_masks(*scene())
    assert masks["near"].sum() == 20 * SIZE
    assert masks["far"].sum() == 20 * SIZE
    np.testing.assert_array_equal(np.flatnonzero(masks["burnt"].any(axis=1)), np.arange(10))
    y, x = np.mgrid[:SIZE, :SIZE]
    np.testing.assert_array_equal(masks["over 40 px from a point"], np.hypot(y - 50, x - 50) > 40)
    edge = masks["fold edges"]
    assert edge[50, 12:28].all()
    assert edge[50, 72:88].all()
    assert not edge[50, 30:70].any()
    assert masks["border"][:5].all()
    assert not masks["border"][6:-6, 6:-6].any()


def test_a_border_is_that_of_the_truth() -> None:
    rgb, truth, sparse = scene()
    truth[:30] = 0
    border = strata_masks(rgb, truth, sparse)["border"]
    assert not border[:30].any()
    assert border[30:35].all()
    assert not border[36:90, 6:-6].any()


def test_laplace_errors_of_the_predicted_scale_are_63_percent_within_in_each_stratum() -> None:
    rng = np.random.default_rng(0)
    rgb, truth, sparse = scene()
    frames = []
    for _ in range(20):
        error = rng.uniform(0.01, 0.1, truth.shape)
        prediction = truth * (1 + error * rng.laplace(size=truth.shape))
        confidence = 0.03**2 / (0.03**2 + error**2)
        frames.append(frame_strata(rgb, truth, sparse, prediction, error, confidence))
    for name, found in merged_strata(frames).items():
        assert found.within_one == pytest.approx(1 - math.exp(-1), abs=0.02), name
        assert found.abs_rel == pytest.approx(0.055, rel=0.05), name


def test_what_is_kept_is_counted_by_its_confidence() -> None:
    rgb, truth, sparse = scene()
    confidence = np.full(truth.shape, 0.05)
    confidence[:, :20] = 0.9
    prediction = truth * np.where(np.arange(SIZE) < 10, 1.5, 1.0)[None]
    found = merged_strata([frame_strata(rgb, truth, sparse, prediction, 0.1 * np.ones_like(truth), confidence)])
    assert found["near"].kept == 1.0
    assert found["near"].kept_close == 0.5
    assert found["far"].kept == 0.0
    assert found["far"].kept_close is None
