"""Points whose depth neighbours' pictures confirm, in a tube whose depth is known exactly."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from pipeline.depth.photometric_points import _grid, _seen_in, photometric_points, view_of
from pipeline.matching.patch_alignment import HALF_WIDTH, SEARCH_PX, Alignment
from tests.helpers.tubes.textured_tube import CAMERA, MASK, SIZE, camera_at, render, true_depth

PLACES = (0, 2, 5, 8, 10)
OWN = 2  # place of the view whose points are asked for
WAVE = 0.02 * np.sin(np.arange(SIZE) / 20)[None, :] * np.ones((SIZE, 1))  # of log depth
INTRINSICS = CAMERA.matrix


def view_at(place, wrong, mask=MASK):
    pose = camera_at(place)
    return view_of(render(pose), mask, (true_depth(pose) * np.exp(wrong)).astype(np.float32), pose)


@pytest.fixture(scope="module")
def views():
    return [view_at(place, WAVE) for place in PLACES]


def off(points, place=PLACES[OWN]):
    """(K,) log of a point's depth over the true one."""
    x, y = np.floor(points.pixels).astype(int).T
    return np.log(points.depth / true_depth(camera_at(place))[y, x])


def others(views):
    return [view for number, view in enumerate(views) if number != OWN]


def test_points_are_nearer_to_the_wall_than_the_depth_that_they_begin_at(views):
    points = photometric_points(views[OWN], others(views), INTRINSICS)
    x = np.floor(points.pixels[:, 0]).astype(int)
    assert len(points.depth) > 250
    before, after = np.abs(WAVE[0, x]), np.abs(off(points))
    assert np.median(after) < 0.4 * np.median(before)
    assert np.mean(after < 3 * points.error) > 0.9


def test_the_unit_and_the_axes_of_the_world_do_not_matter(views):
    def moved(view):
        pose = np.array([[0, -1, 0, 7], [1, 0, 0, -3], [0, 0, 1, 2], [0, 0, 0, 1]], float) @ view.world_from_camera
        pose[:3, 3] *= 5
        return replace(view, depth=5 * view.depth, world_from_camera=pose)

    plain = photometric_points(views[OWN], others(views), INTRINSICS)
    elsewhere = photometric_points(moved(views[OWN]), [moved(view) for view in others(views)], INTRINSICS)
    np.testing.assert_array_equal(elsewhere.pixels, plain.pixels)
    np.testing.assert_allclose(elsewhere.depth, 5 * plain.depth, rtol=1e-3)


def test_pictures_of_something_else_confirm_next_to_nothing(views):
    rng = np.random.default_rng(3)
    strange = [replace(view, grey=rng.integers(0, 256, view.grey.shape, np.uint8)) for view in others(views)]
    honest = len(photometric_points(views[OWN], others(views), INTRINSICS).depth)
    assert len(photometric_points(views[OWN], strange, INTRINSICS).depth) < 0.02 * honest


@pytest.mark.parametrize("left_out", ["masked", "without depth"])
def test_no_patch_touches_what_is_masked_or_has_no_depth(views, left_out):
    pose, mask, depth = views[OWN].world_from_camera, MASK.copy(), views[OWN].depth.copy()
    (mask if left_out == "masked" else depth)[:, :80] = 0
    points = photometric_points(view_of(render(pose), mask, depth, pose), others(views), INTRINSICS)
    assert len(points.depth) > 100
    assert points.pixels[:, 0].min() > 80 + HALF_WIDTH


def test_views_that_are_masked_are_not_asked(views):
    covered = [view_at(place, WAVE, np.zeros_like(MASK)) for place in PLACES if place != PLACES[OWN]]
    assert len(photometric_points(views[OWN], covered, INTRINSICS).depth) == 0


def test_a_view_that_has_other_wall_there_is_not_asked(views):
    nearer = [replace(view, depth=0.6 * view.depth) for view in others(views)]
    assert len(photometric_points(views[OWN], nearer, INTRINSICS).depth) == 0


def test_without_neighbours_there_are_none(views):
    points = photometric_points(views[OWN], [], INTRINSICS)
    assert points.pixels.shape == (0, 2)
    assert len(points.depth) == len(points.error) == 0


def test_two_calls_agree(views):
    first, second = (photometric_points(views[OWN], others(views), INTRINSICS) for _ in range(2))
    for name, values in vars(first).items():
        np.testing.assert_array_equal(values, getattr(second, name))


def test_only_points_that_most_views_confirm_and_that_are_sure_enough_are_taken(views, monkeypatch):
    """Of five patches one has too few views that correlate, one no majority, one a great shift, one a great error."""

    def aligned(reference, *_):
        count = len(reference.grey)
        shift, sigma, contrast = np.zeros(count), np.full(count, 0.001), np.full(count, 0.05)
        seen, correlating = np.full(count, 6), np.full(count, 4)
        seen[1], correlating[1] = 1, 1
        correlating[2] = 3
        shift[3], sigma[4] = 0.2, 0.2
        return Alignment(shift, sigma, seen, correlating, contrast)

    monkeypatch.setattr("pipeline.depth.photometric_points.align_patches", aligned)
    all_of_them = _grid(views[OWN])
    points = photometric_points(views[OWN], others(views), INTRINSICS)
    np.testing.assert_array_equal(points.pixels, np.delete(all_of_them, [1, 2, 3, 4], axis=0))


@pytest.mark.parametrize(("at", "turned", "seen"), [(0.0, 0, True), (20.0, 180, False)], ids=["before", "behind"])
def test_a_patch_is_not_compared_with_a_view_of_its_back(at, turned, seen):
    """Of a wall at z = 10, from either side; both views have depth 10 there."""
    pixels = np.array([[90.5, 90.5], [100.5, 96.5]])
    steps = np.array([[0, 0], [2, 0], [0, 2], [0, 0]])
    plane = (pixels[:, None] + steps - INTRINSICS[:2, 2]) / INTRINSICS[[0, 1], [0, 1]]
    world = 10 * np.concatenate([plane, np.ones((2, 4, 1))], axis=2)
    world[:, 3] /= 1.01
    pose = np.eye(4)
    pose[:3, :3] = Rotation.from_euler("y", turned, degrees=True).as_matrix()
    pose[2, 3] = at
    depth = np.full((SIZE, SIZE), 10, np.float32)
    view = view_of(np.zeros((SIZE, SIZE, 3), np.uint8), MASK, depth, pose)
    assert len(_seen_in(view, world, INTRINSICS).patch) == (2 if seen else 0)


def test_a_magnified_patch_keeps_farther_from_what_is_masked():
    """Of the same wall, from half as far: there the patch is twice as wide."""
    pixels = np.array([[96.0, 96.0]])  # the principal point, which stays
    steps = np.array([[0, 0], [2, 0], [0, 2], [0, 0]])
    plane = (pixels[:, None] + steps - INTRINSICS[:2, 2]) / INTRINSICS[[0, 1], [0, 1]]
    world = 10 * np.concatenate([plane, np.ones((1, 4, 1))], axis=2)
    for z, reach in ((0.0, HALF_WIDTH + SEARCH_PX), (5.0, 2 * HALF_WIDTH + SEARCH_PX)):
        pose = np.eye(4)
        pose[2, 3] = z
        for away, seen in ((reach - 2, False), (reach, True)):
            mask = MASK.copy()
            mask[:, : int(96 - away)] = 0
            view = view_of(np.zeros((SIZE, SIZE, 3), np.uint8), mask, np.full((SIZE, SIZE), 10 - z, np.float32), pose)
            assert len(_seen_in(view, world, INTRINSICS).patch) == seen
