"""Bootstrap intervals beside the normal approximation, and reductions that are known."""

import numpy as np
import pytest

from benchmarks.paper.intervals import by_mesh, mean_interval, reduction_interval


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


def test_frames_are_averaged_within_their_mesh():
    np.testing.assert_allclose(by_mesh([1.0, 2.0, 6.0, 4.0], [7, 3, 7, 3]), [3.0, 3.5])
