"""Points that known poses triangulate: synthetic rays with wrong ones among them, and rendered views of a tube."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial import cKDTree

from haustra.core.frame_spacing import LEAST_FRAMES
from haustra.core.progress import no_progress
from haustra.core.ray_table import RayTable
from haustra.core.se3 import in_camera, inverse
from pipeline.mapping import feature_triangulation
from pipeline.mapping.feature_triangulation import (
    MIN_ERROR_PX,
    choose_frames,
    empty_map,
    frames_of_features,
    largest_error,
    triangulate_again,
    triangulate_features,
)
from pipeline.mapping.local_map import TrackKind
from pipeline.mapping.submap_of_map import to_submap
from pipeline.matching.sift_cache import SiftCache
from reconstruction.evaluation.trajectory_metrics import align_poses
from tests.helpers.tubes.textured_tube import CAMERA, MASK, RADIUS, camera_at, polished, render, run

RAYS = RayTable(CAMERA)
POSES = np.stack([camera_at(k, step=1.6) for k in range(8)])


def synthetic_map(noise_px, rng, count=120, poses=POSES):
    """A map of features on the tube's wall, each seen by six keyframes and more, without points; the true ones."""
    angle, height = rng.uniform(0, 2 * np.pi, count), rng.uniform(25, 45, count)
    points = np.column_stack([RADIUS * np.cos(angle), RADIUS * np.sin(angle), height])
    local_map = empty_map(list(range(len(poses))), poses, RAYS)
    ids = local_map.insert_tracks(np.full((count, 3), 7.0), TrackKind.FEATURE)  # nowhere near
    for number, world_from_camera in enumerate(poses):
        pixels = CAMERA.project(in_camera(inverse(world_from_camera), points)) + rng.normal(0, noise_px, (count, 2))
        inside = ((pixels > 1) & (pixels < 191)).all(axis=1)
        local_map.extend(number, ids[inside], pixels[inside])
    return local_map, ids, points


def moved(local_map, number, place, pixels):
    keyframe = local_map.keyframes[number]
    keyframe.pixels[place] += pixels
    keyframe.xy, keyframe.jacobian = RAYS.unproject(keyframe.pixels)


def seen(local_map):
    return np.concatenate([k.ids for k in local_map.keyframes])


@settings(max_examples=20, deadline=None)
@given(st.integers(0, 10_000), st.sampled_from([0.0, 0.1, 0.3]))
def test_points_are_where_the_rays_meet_whatever_stood_there(seed, noise_px):
    local_map, ids, points = synthetic_map(noise_px, np.random.default_rng(seed))
    triangulate_features(local_map)
    found = ids[local_map.tracks.has_point[ids]]
    assert len(found) > (0.9 if noise_px == 0 else 0.4) * len(ids)
    off = np.linalg.norm(local_map.tracks.points[found] - points[np.searchsorted(ids, found)], axis=1)
    assert np.median(off) < 1e-3 + 2.0 * noise_px
    assert set(seen(local_map)) == set(found)  # what became no point is seen by nobody


@settings(max_examples=20, deadline=None)
@given(st.integers(0, 10_000))
def test_a_wrong_match_is_dropped_and_its_track_stays(seed):
    rng = np.random.default_rng(seed)
    local_map, ids, points = synthetic_map(0.0, rng)
    wrong = []
    often = np.bincount(seen(local_map), minlength=len(local_map.tracks)) >= 5
    for track in ids[often[ids]][::4]:
        number = int(rng.choice([n for n, k in enumerate(local_map.keyframes) if track in k.ids]))
        place = int(np.flatnonzero(local_map.keyframes[number].ids == track)[0])
        out = local_map.keyframes[number].pixels[place] - 96  # along which the camera's own motion shifts it
        moved(local_map, number, place, 5 * np.array([-out[1], out[0]]) / np.linalg.norm(out))
        wrong.append((number, track))
    triangulate_features(local_map)
    assert not any(track in local_map.keyframes[number].ids for number, track in wrong)
    kept = local_map.tracks.has_point[ids]
    assert kept.mean() > 0.9
    np.testing.assert_allclose(local_map.tracks.points[ids[kept]], points[kept], atol=0.05)


@pytest.mark.parametrize("way", [-20.0, -6.0, 6.0, 20.0])
def test_a_wrong_match_along_the_camera_s_motion_is_dropped_too(way):
    """Features are matched within 2 % of the width, here 4 px."""
    local_map, ids, points = synthetic_map(0.0, np.random.default_rng(1))
    often = np.bincount(seen(local_map), minlength=len(local_map.tracks)) >= 6
    wrong = ids[often[ids]][::4]
    for track in wrong:
        number = [n for n, k in enumerate(local_map.keyframes) if track in k.ids][2]
        place = int(np.flatnonzero(local_map.keyframes[number].ids == track)[0])
        out = local_map.keyframes[number].pixels[place] - 96
        moved(local_map, number, place, way * out / np.linalg.norm(out))
    triangulate_features(local_map)
    kept = local_map.tracks.has_point[wrong]
    assert kept.mean() > 0.6
    off = np.linalg.norm(local_map.tracks.points[wrong[kept]] - points[np.searchsorted(ids, wrong[kept])], axis=1)
    assert (off < 0.05).mean() > 0.9


def test_chunks_of_tracks_give_what_one_does(monkeypatch):
    whole, parts = (synthetic_map(0.2, np.random.default_rng(2))[0] for _ in range(2))
    triangulate_features(whole)
    monkeypatch.setattr(feature_triangulation, "CHUNK", 7)
    triangulate_features(parts)
    np.testing.assert_array_equal(whole.tracks.has_point, parts.tracks.has_point)
    np.testing.assert_allclose(whole.tracks.points, parts.tracks.points, atol=1e-9)


def test_rays_that_are_nearly_parallel_are_no_point():
    poses = np.stack([camera_at(0) for _ in range(8)])
    poses[:, 0, 3] += np.linspace(0, 0.1, 8)  # a fifth of a degree at the nearest point
    local_map, ids, _ = synthetic_map(0.0, np.random.default_rng(0), poses=poses)
    triangulate_features(local_map)
    assert not local_map.tracks.has_point[ids].any()


def test_other_points_are_left_alone():
    local_map, _, _ = synthetic_map(0.0, np.random.default_rng(0))
    corner = local_map.insert_tracks(np.array([[1.0, 2.0, 30.0]]), TrackKind.KLT)
    local_map.extend(3, corner, np.array([[50.0, 60.0]]))
    triangulate_features(local_map)
    np.testing.assert_array_equal(local_map.tracks.points[corner], [[1.0, 2.0, 30.0]])
    assert corner[0] in local_map.keyframes[3].ids


def test_the_largest_error_follows_the_films_own_noise_and_not_pairs():
    error = np.array([0.5] * 9 + [0.0] * 20)
    assert largest_error(error, np.array([3] * 9 + [2] * 20)) == pytest.approx(1.0)
    assert largest_error(error, np.full(29, 2)) == MIN_ERROR_PX
    assert largest_error(np.array([np.inf, 0.6, 0.6]), np.full(3, 5)) == pytest.approx(1.2)


def test_keyframes_are_as_far_apart_as_asked():
    poses = np.stack([camera_at(k, step=1.6) for k in range(80)])
    rows = choose_frames(poses, 20.0, 96.0, 12.0)  # about 8 px a frame, turns included
    assert rows[0] == 0
    assert LEAST_FRAMES < len(rows) < len(poses)
    assert len(choose_frames(poses, 20.0, 96.0, 0.0)) == len(poses)
    assert len(choose_frames(poses, 20.0, 96.0, 60.0)) >= LEAST_FRAMES


@pytest.fixture(scope="module")
def film():
    return [render(camera_at(k)) for k in range(30)]


@pytest.fixture(scope="module")
def odometry(film):
    return to_submap(polished(run(film)[0])[0], CAMERA.params)


def again(submap, film):
    with SiftCache(lambda frame: (film[frame], MASK)) as find:
        found = triangulate_again(submap, CAMERA, 2.0, find, no_progress)
    return None if found is None else found.submap


@pytest.fixture(scope="module")
def found(odometry, film):
    return again(odometry, film)


def off_the_wall(submap):
    """|log| of the points' distance from the axis over the true radius, in the film's unit and place."""
    true = np.stack([camera_at(int(k)) for k in submap.frames])
    aligned = align_poses(submap.world_from_camera, true)
    points = submap.points @ aligned[:3, :3].T + aligned[:3, 3]
    chosen = ~submap.is_klt & (submap.track_lengths() >= 3)
    return np.abs(np.log(np.hypot(*points[chosen, :2].T) / RADIUS))


def test_features_become_points_of_the_wall_and_the_path_stays(odometry, found):
    np.testing.assert_array_equal(found.world_from_camera, odometry.world_from_camera)
    np.testing.assert_array_equal(found.frames, odometry.frames)
    assert odometry.is_klt.all()
    np.testing.assert_array_equal(found.points[found.is_klt], odometry.points)
    assert (~found.is_klt).sum() > 300
    assert np.median(off_the_wall(found)) < 0.02
    assert found.observations[:, 0].max() < len(found.frames)
    assert found.observations[:, 1].max() < len(found.points)


def test_wrong_points_of_features_are_mended(found, film):
    """A tenth of the features stand far from where their rays meet, as after an adjustment that forgave them."""
    rng = np.random.default_rng(0)
    points = found.points.copy()
    wrong = rng.choice(np.flatnonzero(~found.is_klt), 60, replace=False)
    points[wrong] *= rng.uniform(1.3, 2.0, (60, 1))
    spoilt = replace(found, points=points)
    mended = again(spoilt, film)
    assert (off_the_wall(spoilt) > 0.1).mean() > 2 * (off_the_wall(mended) > 0.1).mean()
    assert np.median(off_the_wall(mended)) == pytest.approx(np.median(off_the_wall(found)), rel=0.3)


def test_a_sensor_s_depth_holds_the_points_in_the_submap_s_own_unit(odometry, found, film):
    """Millimetres are three of its units here; what is measured is the wall as the map has it."""
    row_of = {int(frame): row for row, frame in enumerate(odometry.frames)}

    def depth_at(frame, pixels):
        row = row_of[frame]
        mine = found.observations[:, 0] == row
        seen_at, depth = found.pixels[mine], found.depths()[mine]
        distance, nearest = cKDTree(seen_at).query(pixels)
        return np.where(distance < 1, 3 * depth[nearest], 0.0), np.full(len(pixels), 0.05)

    with SiftCache(lambda frame: (film[frame], MASK)) as find:
        held = triangulate_again(odometry, CAMERA, 2.0, find, no_progress, depth_at, adjust=True).submap
    np.testing.assert_array_equal(held.world_from_camera, odometry.world_from_camera)
    assert np.median(held.depths()) == pytest.approx(np.median(found.depths()), rel=0.02)
    assert np.median(off_the_wall(held)) < 0.02


def test_which_frames_are_matched_is_known_before_whatever_the_unit(odometry, film):
    asked = set()
    with SiftCache(lambda frame: (film[frame], MASK)) as find:
        triangulate_again(odometry, CAMERA, 8.0, lambda frame: asked.add(frame) or find(frame), no_progress, least=3)
    assert 2 < len(asked) < len(film)
    for unit in (1.0, 7.0):
        assert frames_of_features(odometry.scaled(unit), CAMERA, 8.0, least=3) == sorted(asked)


def test_two_runs_agree(odometry, found, film):
    twice = again(odometry, film)
    np.testing.assert_array_equal(twice.points, found.points)
    np.testing.assert_array_equal(twice.observations, found.observations)


def test_a_submap_whose_frames_see_two_points_keeps_what_it_has(odometry, film):
    bare = odometry.without_points(np.arange(len(odometry.points)) >= 2)
    assert again(bare, film) is None
