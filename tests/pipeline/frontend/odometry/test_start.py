"""When a map begins: not without parallax, and where the camera hardly moves with the little that there is."""

import cv2
import numpy as np
import pytest
from scipy.ndimage import gaussian_filter
from scipy.spatial.transform import Rotation

from haustra.core.progress import SilentProgress
from haustra.core.ray_table import RayTable
from pipeline.config import Config
from pipeline.frontend.odometry.frame_io import frame_features
from pipeline.frontend.odometry.front_end import LITTLE_PARALLAX, track_frames
from pipeline.frontend.odometry.tracking import Odometry
from pipeline.frontend.odometry.two_view import START_WITH_LITTLE_PARALLAX, USUAL_START
from reconstruction.evaluation.trajectory_metrics import trajectory_errors
from tests.helpers.tubes.textured_tube import CAMERA, MASK, SIZE, camera_at, render, stored

FRAMES = 24
HARDLY_MM = 4.0  # a tenth of the distance to most of the wall that is in view


def hovering(mm, turn_deg=4.0):
    """world_from_camera (N,4,4) of a camera that moves so far off the tube's axis, and looks about."""
    share = np.linspace(0, 1, FRAMES)
    poses = np.tile(np.eye(4), (FRAMES, 1, 1))
    poses[:, :3, :3] = Rotation.from_euler("y", turn_deg * np.sin(5 * share)[:, None], degrees=True).as_matrix()
    poses[:, :3, 3] = mm * np.column_stack([share, 0.3 * np.sin(6 * share), 0.4 * share])
    return poses


def maps_of(images, limits):
    odometry = Odometry(RayTable(CAMERA), 0, limits=limits)
    for frame, image in enumerate(images):
        odometry.process(frame, image, odometry.view(image, MASK))
    return odometry.finish()


def moving_wall(px, seed, frames=30):
    """Pictures of a camera at rest before a wall that moves smoothly by so many px (RMS), with noise."""
    rng, picture = np.random.default_rng(seed), render(np.eye(4))
    way = [gaussian_filter(rng.normal(size=(SIZE, SIZE)), 40, mode="wrap") for _ in range(2)]
    way = [px / np.sqrt(2) * one / one.std() for one in way]
    rows, columns = np.mgrid[0:SIZE, 0:SIZE].astype(np.float32)
    for share in np.linspace(0, 1, frames):
        places = [np.float32(start + share * one) for start, one in zip((columns, rows), way, strict=True)]
        moved = cv2.remap(picture, *places, cv2.INTER_CUBIC, borderMode=cv2.BORDER_REFLECT).astype(float)
        yield np.clip(moved + rng.normal(0, 2, (SIZE, SIZE, 1)), 0, 255).astype(np.uint8)


def tracked(tmp_path, images):
    workspace, frames = stored(tmp_path, images)
    with frame_features(workspace) as features:
        return track_frames(frames, features, Config().front_end_settings, workspace, SilentProgress())


def test_a_film_whose_camera_hardly_moves_is_tracked_once_more_and_posed_whole(tmp_path):
    poses = hovering(HARDLY_MM)
    images = [render(pose) for pose in poses]
    assert maps_of(images, USUAL_START) == []
    found = tracked(tmp_path, images)
    (submap,) = found.submaps
    assert len(submap.frames) == FRAMES
    assert trajectory_errors(submap.world_from_camera, poses[submap.frames]).ate_rmse < 0.02 * HARDLY_MM
    assert found.warnings == (LITTLE_PARALLAX,)


def test_a_camera_that_moves_is_tracked_once_and_without_that_warning(tmp_path):
    found = tracked(tmp_path, [render(camera_at(k)) for k in range(30)])
    assert len(found.submaps) == 1
    assert found.warnings == ()


def test_a_map_that_the_light_contradicts_gets_no_second_start(tmp_path, monkeypatch):
    monkeypatch.setattr(Odometry, "_fails_lighting_check", lambda odometry: odometry.limits == USUAL_START)
    found = tracked(tmp_path, [render(camera_at(k)) for k in range(30)])
    assert found.submaps == []
    assert found.warnings == ()


@pytest.mark.parametrize("seed", [0, *(pytest.param(seed, marks=pytest.mark.slow) for seed in (1, 2))])
def test_a_wall_that_moves_before_a_camera_at_rest_begins_no_map(seed):
    assert maps_of(moving_wall(6.0, seed), START_WITH_LITTLE_PARALLAX) == []


@pytest.mark.parametrize("limits", [USUAL_START, START_WITH_LITTLE_PARALLAX])
def test_a_camera_that_only_turns_begins_no_map(limits):
    assert maps_of(map(render, hovering(0.0, turn_deg=12.0)), limits) == []
