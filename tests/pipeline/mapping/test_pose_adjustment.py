"""Poses adjusted to all matched features: rendered views of a tube, whose true poses are known."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from haustra.core.progress import no_progress
from haustra.core.ray_table import RayTable
from haustra.core.se3 import angle_between
from pipeline.mapping.feature_triangulation import empty_map, triangulate_again
from pipeline.mapping.local_map import TrackKind
from pipeline.mapping.pose_adjustment import adjust_poses, mean_reprojection
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
        return triangulate_again(submap, CAMERA, motion_px, find, no_progress, least=3, adjust=adjust)


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
    assert adjusted.is_klt.sum() == leaning.is_klt.sum()
    for kind in (adjusted.is_klt, ~adjusted.is_klt):
        assert np.median(off_the_wall(adjusted, kind)) < 0.02
    np.testing.assert_allclose(
        adjusted.error_px[adjusted.is_klt], mean_reprojection(adjusted, RayTable(CAMERA))[adjusted.is_klt]
    )


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


def test_few_features_hold_no_pose(odometry):
    few = empty_map(odometry.frames.tolist(), odometry.world_from_camera, RayTable(CAMERA))
    ids = few.insert_tracks(np.tile([[0.0, 0.0, 40.0]], (30, 1)), TrackKind.FEATURE)
    for number in range(len(few.keyframes)):
        few.extend(number, ids, np.full((30, 2), 96.0))
    assert adjust_poses(odometry, few, no_progress) is odometry


def test_poses_that_were_fitted_to_as_many_features_stay(adjusted, film):
    fewer = again(adjusted, film, motion_px=12.0)
    np.testing.assert_array_equal(fewer.world_from_camera, adjusted.world_from_camera)
