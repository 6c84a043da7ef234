"""Averaging a frame into voxels, against the same written voxel by voxel with plain numbers."""

import numpy as np

from reconstruction.fusion.voxel_integration import average_frame

PINHOLE = np.array([40.0, 42.0, 15.5, 11.5], np.float32)
TRUNCATION = np.float32(1.5)


def literally(rows, corners, offsets, images, channels):
    """Curless and Levoy's running average, in double precision."""
    depth, weight, confidence, colour = images
    evidence, observations, tsdf, sure, mean_colour = (c.astype(np.float64) for c in channels)
    for row, corner in zip(rows, corners.astype(np.float64), strict=True):
        for v, offset in enumerate(offsets.astype(np.float64)):
            x, y, z = corner + offset
            if z <= 0:
                continue
            j, i = (int(np.floor(PINHOLE[k] * s / z + PINHOLE[k + 2] + 0.5)) for k, s in ((0, x), (1, y)))
            if not (0 <= i < depth.shape[0] and 0 <= j < depth.shape[1]):
                continue
            distance = float(depth[i, j]) - z
            if weight[i, j] == 0 or distance <= -TRUNCATION:
                continue
            old = evidence[row, v]
            evidence[row, v] = old + weight[i, j]
            observations[row, v] += distance < TRUNCATION
            for mean, value in (
                (tsdf, min(max(distance / TRUNCATION, -1), 1)), (sure, confidence[i, j]), (mean_colour, colour[i, j]),
            ):  # fmt: skip
                mean[row, v] = (old * mean[row, v] + weight[i, j] * value) / evidence[row, v]
    return evidence, observations, tsdf, sure, mean_colour


def test_it_is_the_weighted_mean_of_what_each_frame_says():
    """Blocks before, across, behind and beside the picture; frames with holes; two rows that no frame touches."""
    rng = np.random.default_rng(0)
    z, y, x = np.meshgrid(*3 * [np.arange(8, dtype=np.float32)], indexing="ij")
    offsets = 0.25 * np.stack([x, y, z], axis=-1).reshape(-1, 3)
    rows = np.array([4, 0, 5, 2, 7, 6])
    channels = [np.zeros((9, 512), np.float32) for _ in range(4)] + [np.zeros((9, 512, 3), np.float32)]
    expected = tuple(c.astype(np.float64) for c in channels)
    for _ in range(3):
        corners = (rng.uniform(-1, 1, (6, 3)) * [3, 2, 1] + [-1, -1, 8]).astype(np.float32)
        corners[4], corners[5] = [0, 0, -1], [60, 0, 8]  # through the camera, and out of the picture
        depth = rng.uniform(7, 11, (24, 32)).astype(np.float32)
        weight = (rng.uniform(0.1, 2, depth.shape) * (rng.random(depth.shape) < 0.8)).astype(np.float32)
        images = (depth, weight, rng.random(depth.shape).astype(np.float32), 255 * rng.random((24, 32, 3)).astype("f4"))
        expected = literally(rows, corners, offsets, images, expected)
        average_frame(rows, corners, offsets, PINHOLE, *images, TRUNCATION, *channels)
    for found, wanted in zip(channels, expected, strict=True):
        np.testing.assert_allclose(found, wanted, rtol=1e-4, atol=1e-4)
    evidence, observations, tsdf = channels[:3]
    assert 0 < (evidence > 0).mean() < 0.6
    assert (tsdf[evidence > 0] < 0).any()
    assert (tsdf == 1).any()
    assert observations.max() == 3
    assert not evidence[[1, 3, 8]].any()
