"""Points of corners that were followed from frame to frame: told apart, trusted less, and replaced where others are."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_array_equal

from pipeline.camera import Camera
from pipeline.config import SparseSettings
from pipeline.odometry.colmap_text import write_model
from pipeline.odometry.self_calibration import _without_points
from pipeline.sparse_depth import FOLLOWED_ERROR, SparseDepthMaker, reliable_points
from pipeline.submap import Submap, read_submap

CAMERA = Camera("PINHOLE", 320, 320, (160.0, 160.0, 160.0, 160.0), True)
FRAMES = 6


def wall(pixels, followed):
    """A wall 20 ahead, which six cameras side by side all see; pixels: (P,2) of its points in the first camera."""
    points = np.column_stack([(np.asarray(pixels) - 160) / 160 * 20, np.full(len(pixels), 20.0)])
    poses = np.tile(np.eye(4), (FRAMES, 1, 1))
    poses[:, 0, 3] = 0.5 * np.arange(FRAMES)
    observations = np.array([(row, point) for row in range(FRAMES) for point in range(len(points))])
    seen = np.concatenate([CAMERA.project(points - pose[:3, 3]) for pose in poses])
    error = np.full(len(points), 0.3)
    return Submap(np.arange(FRAMES), poses, points, error, observations, seen, CAMERA.params, followed=followed)


def test_a_followed_point_errs_by_more_than_its_parallax_says():
    pixels = np.random.default_rng(0).uniform(20, 300, (40, 2))
    followed = np.arange(40) % 2 == 0
    _, plain = reliable_points(wall(pixels, None), 160.0, SparseSettings())
    _, error = reliable_points(wall(pixels, followed), 160.0, SparseSettings())
    assert_array_equal(error[~followed], plain[~followed])
    np.testing.assert_allclose(error[followed], FOLLOWED_ERROR * plain[followed])


@pytest.mark.parametrize(("found", "kept"), [(3, 1), (2, 2)])
def test_a_followed_point_stays_only_where_few_others_are(found, kept):
    """A tenth of the width is 32 px: of two followed points, one stands among those that were found."""
    among = np.array([[200.0, 160.0], [210.0, 170.0], [190.0, 170.0]])[:found]
    pixels = np.concatenate([among, [[200.0, 165.0], [60.0, 160.0]]])
    submap = wall(pixels, np.arange(len(pixels)) >= found)
    sparse = SparseDepthMaker(submap, CAMERA, SparseSettings()).sparse_depth(0)
    assert len(sparse.depth) == found + kept
    assert 60.0 in sparse.pixels[:, 0].round(6)


def test_nothing_changes_where_no_point_was_followed():
    pixels = np.random.default_rng(1).uniform(20, 300, (60, 2))
    plain, none = wall(pixels, None), wall(pixels, np.zeros(60, dtype=bool))
    one, other = (SparseDepthMaker(s, CAMERA, SparseSettings()).sparse_depth(2) for s in (plain, none))
    assert_array_equal(one.depth, other.depth)
    assert_array_equal(one.error, other.error)


def test_it_is_known_after_writing_reading_and_thinning(tmp_path):
    followed = np.arange(50) % 3 == 0
    submap = wall(np.random.default_rng(2).uniform(20, 300, (50, 2)), followed)
    write_model(submap, CAMERA, tmp_path)
    assert_array_equal(read_submap(tmp_path).is_followed, followed)
    drop = np.arange(50) < 10
    assert_array_equal(_without_points(submap, drop).is_followed, followed[~drop])
    write_model(replace(submap, followed=None), CAMERA, tmp_path)
    assert not read_submap(tmp_path).is_followed.any()
