"""Bootstrap intervals beside the normal approximation, and reductions that are known."""

import numpy as np
import pytest

from benchmarks.paper.intervals import (
    Interval,
    apart_interval,
    by_mesh,
    mean_interval,
    reduction_interval,
    reductions_apart_interval,
)


@pytest.mark.parametrize("shape", [(1, 300), (300, 1)])
def test_the_interval_of_many_meshes_or_seeds_is_the_normal_one(shape):
    table = np.random.default_rng(1).gamma(3.0, 2.0, shape)
    found = mean_interval(table)
    half = 1.96 * table.std() / np.sqrt(table.size)
    assert found.value == pytest.approx(table.mean())
    assert found.low == pytest.approx(table.mean() - half, abs=0.15 * half)
    assert found.high == pytest.approx(table.mean() + half, abs=0.15 * half)


def test_both_seeds_and_meshes_widen_the_interval():
    rng = np.random.default_rng(2)
    seeds, meshes = rng.standard_normal((20, 1)), rng.standard_normal((1, 30))
    found = mean_interval(10 + seeds + meshes)
    half = 1.96 * np.sqrt(seeds.var() / 20 + meshes.var() / 30)
    assert (found.high - found.low) / 2 == pytest.approx(half, rel=0.1)


def test_a_reduction_on_every_mesh_alike_is_known_exactly():
    beside = np.random.default_rng(3).uniform(1, 9, (3, 12))
    found = reduction_interval(0.6 * beside, beside)
    assert (found.low, found.value, found.high) == pytest.approx((0.4, 0.4, 0.4))
    with pytest.raises(ValueError, match="one shape"):
        reduction_interval(beside[:2], beside)


def test_a_difference_of_other_meshes_is_as_wide_as_both_together():
    rng = np.random.default_rng(4)
    table, other = rng.normal(5, 2, (1, 200)), rng.normal(3, 1, (1, 300))
    found = apart_interval(table, other)
    half = 1.96 * np.sqrt(table.var() / 200 + other.var() / 300)
    assert found.value == pytest.approx(table.mean() - other.mean())
    assert (found.high - found.low) / 2 == pytest.approx(half, rel=0.1)
    assert apart_interval(table, table).high > 0.2, "meshes of equal number are not drawn in pairs"


def test_reductions_of_other_meshes_are_compared_without_pairs():
    rng = np.random.default_rng(5)
    first, second = rng.uniform(1, 9, (3, 12)), rng.uniform(1, 9, (3, 12))
    known = reductions_apart_interval((0.6 * first, first), (0.9 * second, second))
    assert (known.low, known.value, known.high) == pytest.approx((0.3, 0.3, 0.3))
    noisy = first * rng.uniform(0.5, 0.7, first.shape)
    single = reduction_interval(noisy, first)
    both = reductions_apart_interval((noisy, first), (noisy, first))
    assert both.value == 0
    assert both.high - both.low == pytest.approx(np.sqrt(2) * (single.high - single.low), rel=0.2)


def test_a_claim_without_a_figure_follows_the_sign():
    words = [Interval(0.0, low, high).finding for low, high in ((0.1, 0.2), (-0.1, 0.2), (-0.2, -0.1))]
    assert words == ["reproduced", "not decided", "not reproduced"]


def test_frames_are_averaged_within_their_mesh():
    np.testing.assert_allclose(by_mesh([1.0, 2.0, 6.0, 4.0], [7, 3, 7, 3]), [3.0, 3.5])
