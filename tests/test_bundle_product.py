"""The product that couples the cameras of a bundle adjustment."""

import numpy as np

from pipeline.odometry import bundle as bundle_module


def test_a_large_problem_is_split_over_two_threads_without_a_difference(monkeypatch):
    """The product that couples the cameras, against NumPy's of the full matrices."""
    rng = np.random.default_rng(0)
    cameras, points = 9, 40
    camera, point = np.nonzero(rng.random((cameras, points)) < 0.4)
    starts = np.searchsorted(camera, np.arange(cameras + 1))
    weight = rng.normal(size=(points, 3, 3))
    blocks = rng.normal(size=(len(camera), 6, 3))
    first = bundle_module._Blocks(blocks @ (weight @ weight.transpose(0, 2, 1))[point], point, starts, points)
    second = bundle_module._Blocks(blocks, point, starts, points)
    full = [np.zeros((cameras, 6, points, 3)) for _ in range(2)]
    for matrix, source in zip(full, (first, second), strict=True):
        matrix[camera, :, point] = source.data
    expected = full[0].reshape(6 * cameras, -1) @ full[1].reshape(6 * cameras, -1).T
    for limit in (bundle_module.FULL, 0):
        monkeypatch.setattr(bundle_module, "FULL", limit)
        np.testing.assert_allclose(bundle_module._product(first, second), expected, atol=1e-12)
