"""Points moved to where the pictures show them: rendered views of a tube, whose wall is known exactly."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pipeline.depth.sparse_depth import SparseDepthMaker
from pipeline.frontend.point_refinement import VIEWS, refine_points, sightings
from pipeline.mapping.colmap_io import write_model
from pipeline.mapping.submap import Submap, read_submap
from tests.helpers.tubes.textured_tube import CAMERA, MASK, RADIUS, camera_at, render

COUNT = 12
POSES = np.stack([camera_at(k, step=1.6) for k in range(COUNT)])


@pytest.fixture(scope="module")
def pictures():
    return [render(pose)[..., 0] for pose in POSES]


def true_submap(klt=None, seed=0):
    """Points on the tube's wall and all frames that see them."""
    rng = np.random.default_rng(seed)
    angle, height = rng.uniform(0, 2 * np.pi, 400), rng.uniform(25, 55, 400)
    points = np.column_stack([RADIUS * np.cos(angle), RADIUS * np.sin(angle), height])
    observations, pixels = [], []
    for row, pose in enumerate(POSES):
        local = (points - pose[:3, 3]) @ pose[:3, :3]
        at = CAMERA.project(np.where(local[:, 2:] > 1, local, 1.0))
        seen = np.flatnonzero((local[:, 2] > 1) & ((at > 12) & (at < 180)).all(axis=1))
        observations.append(np.column_stack([np.full(len(seen), row), seen]))
        pixels.append(at[seen])
    error = np.full(len(points), 0.3)
    return Submap(
        np.arange(COUNT),
        POSES,
        points,
        error,
        np.concatenate(observations),
        np.concatenate(pixels),
        CAMERA.params,
        (),
        klt,
    )


def off_the_wall(submap, points, reference):
    """Relative error of depth in each point's reference frame: by the cylinder that its ray meets."""
    centre = submap.centres[reference]
    ray = points - centre
    a, b = (ray[:, :2] ** 2).sum(axis=1), (ray[:, :2] * centre[:, :2]).sum(axis=1)
    length = (-b + np.sqrt(b * b - a * ((centre[:, :2] ** 2).sum(axis=1) - RADIUS**2))) / a
    return 1 / length - 1


def displaced(submap, rng, by=0.03):
    """Its points moved along their rays in their reference frames; those rows."""
    reference, _ = sightings(submap, submap.observations)
    centre = submap.centres[reference]
    factor = 1 + rng.normal(0, by, (len(reference), 1))
    moved = np.where(reference[:, None] >= 0, centre + factor * (submap.points - centre), submap.points)
    return replace(submap, points=moved), reference


def refined(submap, pictures, mask=MASK):
    return refine_points(submap, CAMERA, lambda frame: (np.repeat(pictures[frame][..., None], 3, axis=2), mask))


def test_points_go_back_to_the_wall_and_say_how_sure_they_are(pictures):
    submap, reference = displaced(true_submap(), np.random.default_rng(1))
    found = refined(submap, pictures)
    known = np.isfinite(found.depth_error)
    # What is dropped is known by its observations: points keep their order.
    left = np.flatnonzero(np.isin(np.arange(len(submap.points)), _kept(submap, found)))
    before = np.abs(off_the_wall(submap, submap.points[left], reference[left]))[known]
    after = np.abs(off_the_wall(submap, found.points, reference[left]))[known]
    assert known.mean() > 0.6
    assert np.median(before) > 0.015
    assert np.median(after) < 0.005
    assert np.mean(after < before) > 0.8
    assert np.mean(after < 2 * found.depth_error[known]) > 0.8


def _kept(before, after):
    """Rows of the points of `before` that are in `after`: by the frames and pixels that saw them."""

    def tracks(submap):
        order = np.lexsort((submap.observations[:, 0], submap.observations[:, 1]))
        point = submap.observations[order, 1]
        firsts = np.unique(point, return_index=True)[1]
        return point[firsts], [tuple(p) for p in submap.pixels[order][firsts]]

    rows, names = tracks(before)
    number = dict(zip(names, rows.tolist(), strict=True))
    return [number[name] for name in tracks(after)[1]]


def test_a_point_that_one_of_its_frames_cannot_see_is_dropped(pictures):
    """A frame that looks back is said to see every tenth point: COLMAP reads no model with an infinite error."""
    submap = true_submap()
    backwards = POSES[-1] @ np.diag([-1.0, 1.0, -1.0, 1.0])
    told = np.arange(0, len(submap.points), 10)
    wrong = replace(
        submap,
        frames=np.arange(COUNT + 1),
        world_from_camera=np.concatenate([POSES, backwards[None]]),
        observations=np.concatenate([submap.observations, np.column_stack([np.full(len(told), COUNT), told])]),
        pixels=np.concatenate([submap.pixels, np.full((len(told), 2), 96.0)]),
    )
    found = refined(wrong, [*pictures, pictures[-1]])
    assert np.isfinite(found.error_px).all()
    assert np.isfinite(found.depth_error).any()


def test_poses_observations_and_the_unit_stay(pictures):
    submap, _ = displaced(true_submap(), np.random.default_rng(1))
    found = refined(submap, pictures)
    np.testing.assert_array_equal(found.world_from_camera, submap.world_from_camera)
    kept = _kept(submap, found)
    assert len(found.observations) == np.isin(submap.observations[:, 1], kept).sum()
    larger = refined(submap.scaled(7.0), pictures)
    np.testing.assert_allclose(larger.points, 7 * found.points, rtol=1e-5)
    np.testing.assert_allclose(larger.depth_error, found.depth_error, rtol=1e-3)


def test_reprojection_errors_are_those_of_the_moved_points(pictures):
    """The tube's pixels are exact: what is left is how far the points still are from the wall."""
    submap, _ = displaced(replace(true_submap(), error_px=np.full(400, 9.0)), np.random.default_rng(1))
    found = refined(submap, pictures)
    known = np.isfinite(found.depth_error)
    np.testing.assert_array_equal(found.error_px[~known], 9.0)
    one = np.flatnonzero(known)[7]
    mine = found.observations[:, 1] == one
    local = [(found.points[one] - p[:3, 3]) @ p[:3, :3] for p in POSES[found.observations[mine, 0]]]
    by_hand = np.linalg.norm(CAMERA.project(np.array(local)) - found.pixels[mine], axis=1).mean()
    assert found.error_px[one] == pytest.approx(by_hand)
    assert np.median(found.error_px[known]) < 0.1


def test_what_the_pictures_do_not_confirm_stays_as_it_was():
    submap, _ = displaced(true_submap(), np.random.default_rng(1))
    noise = np.random.default_rng(3).integers(0, 255, (COUNT, *MASK.shape)).astype(np.uint8)
    found = refined(submap, noise)
    assert np.isnan(found.depth_error).all()
    np.testing.assert_array_equal(found.points, submap.points)


def test_points_that_two_frames_see_stay_as_they_are(pictures):
    few = true_submap().without_frames(set(range(2, COUNT)))
    few = few.without_points(few.track_lengths() < 2)
    assert len(few.points) > 50
    found = refined(few, pictures)
    np.testing.assert_array_equal(found.points, few.points)
    assert np.isnan(found.depth_error).all()


def test_patches_that_touch_what_is_masked_are_not_compared(pictures):
    """The left half of every frame is left out: what is seen there by more than half of its frames is not confirmed."""
    submap, _ = displaced(true_submap(), np.random.default_rng(1))
    mask = MASK.copy()
    mask[:, :96] = 0
    found, whole = refined(submap, pictures, mask), refined(submap, pictures)
    reference, _ = sightings(found, found.observations)
    x = np.full((len(found.points), COUNT), np.nan)
    x[found.observations[:, 1], found.observations[:, 0]] = found.pixels[:, 0]
    at = x[np.arange(len(reference)), reference]
    known = np.isfinite(found.depth_error)
    assert (at[known] > 96).all()
    assert 0.2 < known.sum() / np.isfinite(whole.depth_error).sum() < 0.8


def test_few_points_are_dropped_however_small_the_parallax_and_coarse_the_noise(pictures):
    """Baselines of a tenth, and noise of 3 grey levels: unsure, but no edges."""
    rng = np.random.default_rng(5)
    noisy = [np.clip(p + rng.normal(0, 3, p.shape), 0, 255).astype(np.uint8) for p in pictures]
    submap, _ = displaced(true_submap(), rng)
    near = replace(submap, observations=submap.observations[submap.observations[:, 0] < 3])
    near = replace(near, pixels=submap.pixels[submap.observations[:, 0] < 3])
    for one in (submap, near):
        found = refined(one, noisy)
        assert len(found.points) > 0.8 * len(one.points)
        in_front = [(found.points[point] - POSES[row][:3, 3]) @ POSES[row][:3, 2] for row, point in found.observations]
        assert np.min(in_front) > 0


def test_two_calls_agree_and_a_stored_submap_keeps_its_errors(pictures, tmp_path):
    submap, _ = displaced(true_submap(), np.random.default_rng(1))
    first, second = refined(submap, pictures), refined(submap, pictures)
    np.testing.assert_array_equal(first.points, second.points)
    write_model(first, CAMERA, tmp_path)
    np.testing.assert_array_equal(read_submap(tmp_path).depth_error, first.depth_error)


def test_sparse_depth_takes_the_errors_that_are_known(pictures):
    followed = np.arange(400) % 2 == 0
    submap, _ = displaced(true_submap(followed), np.random.default_rng(1))
    found = refined(submap, pictures)
    known = np.isfinite(found.depth_error)
    assert known.any()
    assert not known.all()
    maker, plain = SparseDepthMaker(found, CAMERA), SparseDepthMaker(replace(found, depth_error=None), CAMERA)
    np.testing.assert_array_equal(maker.error[known], found.depth_error[known])
    np.testing.assert_array_equal(maker.error[~known], plain.error[~known])


@given(st.lists(st.integers(0, 14), min_size=1, max_size=6), st.integers(0, 99))
@settings(max_examples=60, deadline=None)
def test_the_reference_is_the_middle_sighting_and_others_are_spread(lengths, seed):
    rng = np.random.default_rng(seed)
    tracks = [np.sort(rng.choice(40, length, replace=False)) for length in lengths]
    pairs = [(frame, point) for point, track in enumerate(tracks) for frame in track]
    observations = rng.permutation(np.array(pairs, np.int64).reshape(-1, 2))
    submap = replace(true_submap(), points=np.zeros((len(tracks), 3)))
    reference, others = sightings(submap, observations)
    for track, mine, rest in zip(tracks, reference, others, strict=True):
        if len(track) < 3:
            assert mine == -1
            assert (rest == -1).all()
            continue
        assert mine == track[len(track) // 2]
        chosen = rest[rest >= 0]
        assert len(chosen) == len(np.unique(chosen)) == min(VIEWS, len(track) - 1)
        assert mine not in chosen
        assert np.isin(chosen, track).all()
        away = track[track != mine]
        assert {away[0], away[-1]} <= set(chosen.tolist())
