"""Where features are found: an error here is an error of the principal point, which bends every long path."""

import numpy as np
import pytest

from pipeline.matching.feature_matching import MatchedFeatures
from pipeline.matching.keyframe_features import KeyframeFeatures
from pipeline.matching.sift import detect_sift

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
    pixels = detect_sift(blobs(centres, sigma), MASK).pixels
    off = pixels[:, None] - centres
    nearest = np.linalg.norm(off, axis=2).argmin(axis=1)
    off = off[np.arange(len(off)), nearest]
    off = off[np.linalg.norm(off, axis=1) < 2]
    assert len(off) >= len(centres)
    assert np.abs(off.mean(axis=0)).max() < 0.03  # px; a quarter without OpenCV's precise upscaling


@pytest.mark.parametrize("sigma", [1.2, 2.5, 6.0])
def test_the_size_of_a_feature_is_that_of_its_blob(sigma):
    assert np.median(detect_sift(blobs(lattice(0), sigma), MASK).sizes) == pytest.approx(2 * sigma, rel=0.2)


def place(seed: int, points: np.ndarray, sizes: np.ndarray) -> KeyframeFeatures:
    return KeyframeFeatures(
        seed, points[:, :2], np.zeros((len(points), 128), np.uint8), points, sizes, np.zeros(len(points), bool)
    )


def test_only_matches_of_narrow_features_may_move_the_map():
    points = np.random.default_rng(0).normal(size=(6, 3))
    sizes = np.array([[2.0, 5.0, 5.1, 9.0, 3.0, 20.0], [2.0, 4.0, 5.0, 9.0, 6.0, 4.0]])
    rows = np.repeat(np.arange(6)[:, None], 2, axis=1)
    features = [place(k, points, s) for k, s in enumerate(sizes)]
    matched = MatchedFeatures(features, [(0, 1)], [rows])
    narrow, wide = (matched.tracks([points, points], wide, widest=5.0) for wide in (False, True))
    assert sorted(narrow.feature[narrow.place == 0]) == [0, 1]  # both are at most five pixels across
    assert sorted(wide.feature[wide.place == 0]) == [2, 3, 4, 5]


def test_a_black_picture_has_no_features():
    nothing = detect_sift(np.zeros((SIDE, SIDE, 3), np.uint8), MASK)
    assert nothing.pixels.shape == (0, 2)
    assert nothing.descriptors.shape == (0, 128)
    assert nothing.sizes.shape == (0,)
