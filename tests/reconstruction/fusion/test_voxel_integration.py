"""Averaging a frame into voxels, against the same written voxel by voxel with plain numbers."""

import numpy as np
import pytest

from reconstruction.fusion.voxel_integration import COLOUR_STEPS, CONFIDENCE_STEPS, average_frame

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
    shapes = (9, 512), (9, 512), (9, 512), (9, 512), (9, 512, 3)
    kinds = np.float32, np.uint16, np.float32, np.uint16, np.uint16
    channels = [np.zeros(shape, kind) for shape, kind in zip(shapes, kinds, strict=True)]
    expected = tuple(c.astype(np.float64) for c in channels)
    for _ in range(3):
        corners = (rng.uniform(-1, 1, (6, 3)) * [3, 2, 1] + [-1, -1, 8]).astype(np.float32)
        corners[4], corners[5] = [0, 0, -1], [60, 0, 8]  # through the camera, and out of the picture
        depth = rng.uniform(7, 11, (24, 32)).astype(np.float32)
        weight = (rng.uniform(0.1, 2, depth.shape) * (rng.random(depth.shape) < 0.8)).astype(np.float32)
        images = (depth, weight, rng.random(depth.shape).astype(np.float32), 255 * rng.random((24, 32, 3)).astype("f4"))
        expected = literally(rows, corners, offsets, images, expected)
        average_frame(rows, corners, offsets, PINHOLE, *images, TRUNCATION, *channels)
    steps, halves = (1, 1, 1, CONFIDENCE_STEPS, COLOUR_STEPS), 3 * 0.5  # of a step in each frame, at most
    for found, wanted, of_one in zip(channels, expected, steps, strict=True):
        rounded = halves / of_one if of_one > 1 else 0
        np.testing.assert_allclose(found / of_one, wanted, rtol=1e-4, atol=1e-4 + rounded)
    evidence, observations, tsdf = channels[:3]
    assert 0 < (evidence > 0).mean() < 0.6
    assert (tsdf[evidence > 0] < 0).any()
    assert (tsdf == 1).any()
    assert observations.max() == 3
    assert not evidence[[1, 3, 8]].any()


def show(channels, colour, weight=1.0, confidence=1.0):
    """A frame of one pixel, of one voxel."""
    one = np.ones((1, 1), np.float32)
    images = 2 * one, np.float32(weight) * one, np.float32(confidence) * one, colour
    place = np.zeros(1, np.int64), np.array([[0, 0, 2]], "f4"), np.zeros((1, 3), "f4"), np.array([1, 1, 0, 0], "f4")
    average_frame(*place, *images, TRUNCATION, *channels)


@pytest.mark.parametrize(("first", "weight", "count"), [(1.0, 1.0, 1000), (500.0, 0.5, 2000)])
def test_where_a_mean_stalls_it_is_off_by_no_more_than_one_grey_level(first, weight, count):
    """Light that drifts, and weak views after a sure one, move it by less than half a step each."""
    values = [np.zeros((1, 1), kind) for kind in (np.float32, np.uint16, np.float32, np.uint16)]
    channels = [*values, np.zeros((1, 1, 3), np.uint16)]
    shades = np.concatenate([[100.0], np.linspace(100.5, 108, count)])
    weights = np.concatenate([[first], np.full(count, weight)])
    for shade, of in zip(shades, weights, strict=True):
        show(channels, np.full((1, 1, 3), shade, np.float32), of)
    expected = np.average(shades, weights=weights)
    np.testing.assert_allclose(channels[4] / COLOUR_STEPS, expected, atol=1.0)


def test_a_confidence_that_rounding_puts_past_one_does_not_wrap():
    values = [np.zeros((1, 1), kind) for kind in (np.float32, np.uint16, np.float32, np.uint16)]
    channels = [*values, np.zeros((1, 1, 3), np.uint16)]
    show(channels, np.full((1, 1, 3), 255, np.float32), confidence=1.0001)
    assert channels[3] == CONFIDENCE_STEPS


def test_means_in_steps_stay_true_over_many_frames():
    """White stays white, a sure voxel sure, and of many frames the mean is that of all."""
    rng = np.random.default_rng(1)
    values = [np.zeros((1, 1), kind) for kind in (np.float32, np.uint16, np.float32, np.uint16)]
    channels = [*values, np.zeros((1, 1, 3), np.uint16)]
    shown = 40 + 60 * rng.random((500, 1, 1, 3)).astype("f4")
    shown[..., 0] = 255
    for colour in shown:
        show(channels, colour)
    assert channels[1] == 500
    assert channels[3] == CONFIDENCE_STEPS
    np.testing.assert_allclose(channels[4][0, 0] / COLOUR_STEPS, shown.mean(axis=0)[0, 0], atol=0.3)
    assert channels[4][0, 0, 0] == 255 * COLOUR_STEPS
