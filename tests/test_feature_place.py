"""Where features are found: an error here is an error of the principal point, which bends every long path."""

import numpy as np
import pytest

from pipeline.odometry.places import sift

SIDE = 320
MASK = np.full((SIDE, SIDE), 255, np.uint8)


def blobs(centres: np.ndarray, sigma: float) -> np.ndarray:
    """A picture of Gaussian blobs, `centres` (N,2) in COLMAP's convention: a pixel's centre is at one half."""
    y, x = np.mgrid[:SIDE, :SIDE] + 0.5
    grey = np.full((SIDE, SIDE), 90.0)
    for cx, cy in centres:
        grey += 90 * np.exp(-((x - cx) ** 2 + (y - cy) ** 2) / (2 * sigma**2))
    return np.repeat(np.clip(grey.round(), 0, 255).astype(np.uint8)[:, :, None], 3, axis=2)


def lattice(seed: int) -> np.ndarray:
    cell = np.arange(30, SIDE - 30, 40)
    corners = np.stack(np.meshgrid(cell, cell), axis=-1).reshape(-1, 2)
    return corners + np.random.default_rng(seed).uniform(0, 1, corners.shape)


@pytest.mark.parametrize("sigma", [1.2, 1.8, 2.5, 4.0, 6.0])
def test_a_blob_is_found_at_its_centre(sigma):
    centres = lattice(0)
    pixels, _ = sift(blobs(centres, sigma), MASK)
    off = pixels[:, None] - centres
    nearest = np.linalg.norm(off, axis=2).argmin(axis=1)
    off = off[np.arange(len(off)), nearest]
    off = off[np.linalg.norm(off, axis=1) < 2]
    assert len(off) >= len(centres)
    assert np.abs(off.mean(axis=0)).max() < 0.03  # px; a quarter without OpenCV's precise upscaling


def test_wide_features_are_left_out():
    rgb = np.maximum(blobs(lattice(0), 1.2), np.roll(blobs(lattice(1), 6.0), 20, axis=(0, 1)))
    every, codes = sift(rgb, MASK)
    small, small_codes = sift(rgb, MASK, widest=5.0)
    assert 40 <= len(small) < len(every)
    found = {(*pixel, *code) for pixel, code in zip(every, codes, strict=True)}  # a place may have two directions
    assert {(*pixel, *code) for pixel, code in zip(small, small_codes, strict=True)} < found
    wide = np.array([p for p in every if tuple(p) not in set(map(tuple, small))])
    centres = lattice(1) + 20
    centres = centres[(centres < SIDE - 30).all(axis=1)]
    nearest = np.linalg.norm(wide[:, None] - centres, axis=2).min(axis=0)
    assert (nearest < 1).mean() > 0.9  # the wide blobs are among what was left out


def test_nothing_small_is_no_feature():
    pixels, codes = sift(blobs(lattice(0), 8.0), MASK, widest=2.0)
    assert pixels.shape == (0, 2)
    assert codes.shape == (0, 128)
