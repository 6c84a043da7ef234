"""Points of corners that KLT tracked from frame to frame: told apart, trusted less, and replaced where others are."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_array_equal

from haustra.core.camera import Camera
from pipeline.depth.sparse_depth import SLIDE, SparseDepthMaker, has_better_neighbours
from pipeline.mapping.colmap_io import write_model
from pipeline.mapping.submap import Submap, read_submap

CAMERA = Camera("PINHOLE", 320, 320, (160.0, 160.0, 160.0, 160.0), True)
FRAMES = 6


def wall(pixels, klt):
    """A wall 20 ahead, which six cameras side by side all see; pixels: (P,2) of its points in the first camera."""
    points = np.column_stack([(np.asarray(pixels) - 160) / 160 * 20, np.full(len(pixels), 20.0)])
    poses = np.tile(np.eye(4), (FRAMES, 1, 1))
    poses[:, 0, 3] = 0.5 * np.arange(FRAMES)
    observations = np.array([(row, point) for row in range(FRAMES) for point in range(len(points))])
    seen = np.concatenate([CAMERA.project(points - world_from_camera[:3, 3]) for world_from_camera in poses])
    error = np.full(len(points), 0.3)
    return Submap(np.arange(FRAMES), poses, points, error, observations, seen, CAMERA.params, klt=klt)


def test_a_klt_corner_slides_by_the_angle_that_it_spans_however_many_frames_saw_it():
    pixels = np.random.default_rng(0).uniform(150, 190, (40, 2))
    klt = np.arange(40) % 2 == 0
    submap, slide_px = wall(pixels, klt), SLIDE * CAMERA.width
    found = SparseDepthMaker(replace(submap, klt=None), CAMERA)
    maker = SparseDepthMaker(submap, CAMERA)
    assert_array_equal(maker.scatter, found.error)
    assert_array_equal(maker.error[~klt], found.error[~klt])
    baseline = 0.5 * (FRAMES - 1)
    by_hand = slide_px / 160.0 * 20.0 / baseline  # depth over baseline is one over the angle, for small angles
    slid = np.sqrt(maker.error[klt] ** 2 - maker.scatter[klt] ** 2)
    np.testing.assert_allclose(slid, by_hand, rtol=0.06)
    twice = replace(  # every frame twice: the scatter falls, the slide stays
        submap,
        frames=np.arange(2 * FRAMES),
        world_from_camera=np.repeat(submap.world_from_camera, 2, axis=0),
        observations=np.concatenate([submap.observations * (2, 1), submap.observations * (2, 1) + (1, 0)]),
        pixels=np.tile(submap.pixels, (2, 1)),
    )
    denser = SparseDepthMaker(twice, CAMERA)
    np.testing.assert_allclose(denser.scatter, maker.scatter / np.sqrt(2))
    again = np.sqrt(denser.error[klt] ** 2 - denser.scatter[klt] ** 2)
    np.testing.assert_allclose(again, slid)


@pytest.mark.parametrize(("found", "kept"), [(3, 1), (2, 2)])
def test_a_klt_corner_stays_only_where_few_others_are(found, kept):
    """A tenth of the width is 32 px: of two KLT corners, one stands among those that were found."""
    among = np.array([[200.0, 160.0], [210.0, 170.0], [190.0, 170.0]])[:found]
    pixels = np.concatenate([among, [[200.0, 165.0], [60.0, 160.0]]])
    submap = wall(pixels, np.arange(len(pixels)) >= found)
    sparse = SparseDepthMaker(submap, CAMERA).sparse_depth(0)
    assert len(sparse.depth) == found + kept
    assert 60.0 in sparse.pixels[:, 0].round(6)


def points(*rows):
    """Pixels, depth, error and whether it is a KLT corner, of (x, y, depth, error, klt)."""
    x, y, depth, error, klt = np.array(rows, dtype=float).T
    return np.column_stack([x, y]), depth, error, klt > 0


CORNER, BESIDE = (100, 100, 20, 0.05, 1), ((110, 100), (100, 110), (95, 95))


@pytest.mark.parametrize(
    ("depth", "error", "replaced"),
    [(20.5, 0.02, True), (40.0, 0.02, False), (20.5, 0.08, False)],
    ids=["surer points of the same wall", "a wall behind the fold", "points that are less sure"],
)
def test_what_may_replace_a_klt_corner(depth, error, replaced):
    others = [(x, y, depth, error, 0) for x, y in BESIDE]
    assert_array_equal(has_better_neighbours(*points(CORNER, *others), 320), [replaced, False, False, False])


def test_a_fold_keeps_its_points_before_a_wall_of_features():
    """A fold at 10 that only KLT corners mark, in front of a wall at 20 with features on both sides of it."""
    rng = np.random.default_rng(3)
    wall_at = [(x, y, 20, 0.01, 0) for x, y in rng.uniform(0, 320, (600, 2)) if abs(x - 160) > 24]
    fold_at = [(x, y, 10, 0.03, 1) for x, y in rng.uniform((136, 0), (184, 320), (60, 2))]
    assert not has_better_neighbours(*points(*wall_at, *fold_at), 320).any()


def test_nothing_changes_where_no_point_is_a_klt_corner():
    pixels = np.random.default_rng(1).uniform(20, 300, (60, 2))
    plain, none = wall(pixels, None), wall(pixels, np.zeros(60, dtype=bool))
    one, other = (SparseDepthMaker(s, CAMERA).sparse_depth(2) for s in (plain, none))
    assert_array_equal(one.depth, other.depth)
    assert_array_equal(one.error, other.error)


def test_it_is_known_after_writing_reading_and_thinning(tmp_path):
    klt = np.arange(50) % 3 == 0
    submap = wall(np.random.default_rng(2).uniform(20, 300, (50, 2)), klt)
    write_model(submap, CAMERA, tmp_path)
    assert_array_equal(read_submap(tmp_path).is_klt, klt)
    drop = np.arange(50) < 10
    assert_array_equal(submap.without_points(drop).is_klt, klt[~drop])
    write_model(replace(submap, klt=None), CAMERA, tmp_path)
    assert not read_submap(tmp_path).is_klt.any()
