"""Poses adjusted to all matched features: rendered views of a tube, whose true poses are known."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from haustra.core.progress import no_progress
from haustra.core.ray_table import RayTable
from haustra.core.se3 import angle_between, in_camera, inverse
from pipeline.mapping import pose_adjustment
from pipeline.mapping.feature_triangulation import empty_map, triangulate_again, triangulate_features
from pipeline.mapping.local_map import TrackKind
from pipeline.mapping.map_adjustment import MAX_ERROR_PX, fit_points
from pipeline.mapping.pose_adjustment import _move_back, adjust_poses
from pipeline.mapping.submap import Submap, sighting_errors
from pipeline.mapping.submap_of_map import to_submap
from pipeline.matching.sift_cache import SiftCache
from reconstruction.evaluation.trajectory_metrics import align_poses, trajectory_errors
from tests.helpers.tubes.textured_tube import CAMERA, MASK, RADIUS, camera_at, polished, render, run

COUNT = 30
TRUE = np.stack([camera_at(k) for k in range(COUNT)])


@pytest.fixture(scope="module")
def film():
    return [render(pose) for pose in TRUE]


@pytest.fixture(scope="module")
def odometry(film):
    return to_submap(polished(run(film)[0])[0], CAMERA.params)


@pytest.fixture(scope="module")
def leaning(odometry):
    """The camera looks ever further aside, by a degree in the end, as if it had moved in another direction."""
    poses = odometry.world_from_camera.copy()
    for row, pose in enumerate(poses):
        pose[:3, :3] = Rotation.from_euler("y", row / len(poses), degrees=True).as_matrix() @ pose[:3, :3]
    return replace(odometry, world_from_camera=poses)


def again(submap, film, motion_px=2.0, adjust=True):
    with SiftCache(lambda frame: (film[frame], MASK)) as find:
        found = triangulate_again(submap, CAMERA, motion_px, find, no_progress, least=3, adjust=adjust)
    assert (found.turned_deg > 0) == (found.submap.world_from_camera is not submap.world_from_camera)
    return found.submap


@pytest.fixture(scope="module")
def adjusted(leaning, film):
    return again(leaning, film)


def errors(submap):
    return trajectory_errors(submap.world_from_camera, TRUE[submap.frames])


def turned(submap):
    """Largest error of a frame's orientation, degrees, after the Sim(3) of all poses."""
    true_from_map = align_poses(submap.world_from_camera, TRUE[submap.frames])
    true_from_map[:3, :3] /= np.cbrt(np.linalg.det(true_from_map[:3, :3]))
    return max(
        np.degrees(angle_between(true_from_map @ mine, true))
        for mine, true in zip(submap.world_from_camera, TRUE[submap.frames], strict=True)
    )


def off_the_wall(submap, chosen):
    """|log| of points' distance from the axis over the true radius."""
    truth_from_map = align_poses(submap.world_from_camera, TRUE[submap.frames])
    points = submap.points[chosen] @ truth_from_map[:3, :3].T + truth_from_map[:3, 3]
    return np.abs(np.log(np.hypot(*points[:, :2].T) / RADIUS))


def test_poses_that_lean_are_brought_back(leaning, adjusted):
    assert turned(leaning) > 0.4
    assert turned(adjusted) < turned(leaning) / 3
    assert errors(adjusted).ate_rmse < 0.5 * errors(leaning).ate_rmse
    np.testing.assert_array_equal(adjusted.frames, leaning.frames)


def test_corners_and_features_lie_on_the_wall(leaning, adjusted):
    assert adjusted.is_klt.sum() > 0.95 * leaning.is_klt.sum()
    for kind in (adjusted.is_klt, ~adjusted.is_klt):
        assert np.median(off_the_wall(adjusted, kind)) < 0.02
    missed = sighting_errors(adjusted, RayTable(CAMERA))[adjusted.is_klt[adjusted.observations[:, 1]]]
    assert missed.max() <= MAX_ERROR_PX  # and so no corner's error is infinite


@pytest.mark.slow
def test_the_axes_and_the_unit_stay(odometry, film):
    found = again(odometry, film)
    change = align_poses(found.world_from_camera, odometry.world_from_camera)
    np.testing.assert_allclose(change, np.eye(4), atol=0.01)
    both = [submap.depths()[submap.is_klt[submap.observations[:, 1]]] for submap in (found, odometry)]
    assert np.median(both[0]) == pytest.approx(np.median(both[1]), rel=0.02)


def test_frames_between_are_carried_along(leaning, film):
    """Of every fifth frame or so features are matched; the others are as right as these."""
    found = again(leaning, film, motion_px=12.0)
    with_features = np.unique(found.observations[~found.is_klt[found.observations[:, 1]], 0])
    assert 4 < len(with_features) < len(found.frames) / 2
    assert turned(found) < 0.15


def test_two_runs_agree(leaning, adjusted, film):
    twice = again(leaning, film)
    np.testing.assert_array_equal(twice.world_from_camera, adjusted.world_from_camera)
    np.testing.assert_array_equal(twice.points, adjusted.points)


def test_without_it_poses_and_corners_stay(leaning, film):
    found = again(leaning, film, adjust=False)
    np.testing.assert_array_equal(found.world_from_camera, leaning.world_from_camera)
    np.testing.assert_array_equal(found.points[found.is_klt], leaning.points)


def matched_map(rng, shared, few=(), noise_px=0.3):
    """A map at the true poses, and its features on the wall: those of its first half of the frames, of its second half,
    and `shared` ones that all see; keyframes `few` see five in all."""
    matched = empty_map(list(range(COUNT)), TRUE, RayTable(CAMERA))
    for frames, count in ((range(COUNT // 2), 250), (range(COUNT // 2, COUNT), 250), (range(COUNT), shared)):
        angle, height = rng.uniform(0, 2 * np.pi, count), rng.uniform(45, 75, count)
        points = np.column_stack([RADIUS * np.cos(angle), RADIUS * np.sin(angle), height])
        ids = matched.insert_tracks(points, TrackKind.FEATURE)
        for number in frames:
            pixels = CAMERA.project(in_camera(inverse(TRUE[number]), points)) + rng.normal(0, noise_px, (count, 2))
            inside = np.flatnonzero(((pixels > 1) & (pixels < 191)).all(axis=1))[: 5 if number in few else count]
            matched.extend(number, ids[inside], pixels[inside])
    return matched


def bare(poses=TRUE):
    """A submap of these frames that sees nothing of its own."""
    nothing = np.zeros((0, 3)), np.zeros(0), np.zeros((0, 2), np.int32), np.zeros((0, 2))
    return Submap(np.arange(len(poses)), poses, *nothing, CAMERA.params)


def by_poses(local_map):
    triangulate_features(local_map)
    fit_points(local_map)


def test_halves_that_hardly_share_features_are_not_adjusted():
    """With 20 in common the halves' sizes come apart by some percents; the poses were right."""
    for shared, stays in ((20, True), (400, False)):
        submap = bare()
        found = adjust_poses(submap, matched_map(np.random.default_rng(0), shared), by_poses)
        assert (found.submap is submap) == stays
        assert (found.turned_deg == 0) == stays


def test_a_refused_adjustment_leaves_what_was_matched():
    matched, untouched = (matched_map(np.random.default_rng(0), 20) for _ in range(2))
    adjust_poses(bare(), matched, by_poses)
    by_poses(untouched)
    np.testing.assert_array_equal(matched.tracks.points, untouched.tracks.points)
    assert matched.incidence().nnz == untouched.incidence().nnz


def test_a_second_adjustment_that_is_refused_leaves_the_first_ones_poses(monkeypatch):
    """It had moved the matched map and dropped sightings before it was found to hang together by too little."""
    adjust_once, adjusted = pose_adjustment._adjusted_once, []

    def once(submap, matched):
        adjusted.append(adjust_once(submap, matched))
        return adjusted[0] if len(adjusted) == 1 else None

    monkeypatch.setattr(pose_adjustment, "_adjusted_once", once)
    matched = matched_map(np.random.default_rng(0), 400)
    found = adjust_poses(bare(), matched, by_poses).submap
    assert len(adjusted) == 2
    for keyframe, pose in zip(matched.keyframes, found.world_from_camera, strict=True):
        np.testing.assert_allclose(keyframe.camera_from_world, inverse(pose), atol=1e-12)


def test_a_frame_that_sees_few_features_follows_its_neighbours():
    """It is put where frames before and after have moved to; the others where they were."""
    poses = TRUE.copy()
    poses[9:12, 0, 3] += 0.5  # mm
    submap = bare(poses)
    matched = matched_map(np.random.default_rng(1), 400, few=(10,))
    for number in (9, 10, 11):
        matched.keyframes[number].camera_from_world = inverse(poses[number])
    found = adjust_poses(submap, matched, by_poses).submap
    truth_from_map = align_poses(found.world_from_camera, TRUE)
    off = np.linalg.norm((truth_from_map @ found.world_from_camera)[:, :3, 3] - TRUE[:, :3, 3], axis=1)
    assert off[[9, 11]].max() < 0.15
    assert off[10] < 0.2


def test_an_adjusted_map_is_as_large_as_before_whatever_the_path_says():
    """The path is a tenth too long, as of a camera that hovers; the points say how large the map is."""
    poses = TRUE.copy()
    poses[:, :3, 3] = TRUE[:, :3, 3].mean(axis=0) + 1.1 * (TRUE[:, :3, 3] - TRUE[:, :3, 3].mean(axis=0))
    points = np.random.default_rng(0).uniform(20, 40, (50, 3))
    matched = empty_map(list(range(COUNT)), TRUE, RayTable(CAMERA))
    ids = matched.insert_tracks(0.5 * points, TrackKind.FEATURE)
    for number in range(COUNT):
        keyframe = matched.keyframes[number]
        keyframe.camera_from_world = inverse(TRUE[number]).copy()
        keyframe.camera_from_world[:3, 3] *= 0.5  # half as large
        matched.extend(number, ids, np.full((len(ids), 2), 96.0))
    _move_back(matched, [inverse(pose) for pose in poses], 2 * matched.tracks.points, np.arange(COUNT))
    depth = [in_camera(matched.keyframes[5].camera_from_world, matched.tracks.points[ids])[:, 2]]
    depth.append(in_camera(inverse(poses[5]), points)[:, 2])
    assert np.median(depth[0] / depth[1]) == pytest.approx(1, rel=0.03)
    centres = np.stack([inverse(keyframe.camera_from_world)[:3, 3] for keyframe in matched.keyframes])
    np.testing.assert_allclose(centres.mean(axis=0), TRUE[:, :3, 3].mean(axis=0), atol=1e-9)


def test_few_features_hold_no_pose():
    matched = matched_map(np.random.default_rng(0), 0, few=range(COUNT))
    submap = bare()
    assert adjust_poses(submap, matched, by_poses).submap is submap


def test_poses_that_were_fitted_to_as_many_features_stay(adjusted, film):
    fewer = again(adjusted, film, motion_px=12.0)
    np.testing.assert_array_equal(fewer.world_from_camera, adjusted.world_from_camera)
