"""When a map begins: not without parallax, and where the camera hardly moves with the little that there is."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from haustra.core.progress import SilentProgress
from haustra.core.ray_table import RayTable
from pipeline.config import Config
from pipeline.frontend.odometry.frame_io import frame_features
from pipeline.frontend.odometry.front_end import track_frames
from pipeline.frontend.odometry.initialization import START_OF_A_STILL_CAMERA, USUAL_START
from pipeline.frontend.odometry.tracking import Odometry
from reconstruction.evaluation.trajectory_metrics import trajectory_errors
from tests.helpers.tubes.textured_tube import CAMERA, MASK, render, stored

FRAMES = 24
HARDLY_MM = 4.0  # a tenth of the distance to most of the wall that is in view


def hovering(mm, turn_deg=4.0):
    """world_from_camera (N,4,4) of a camera that moves so far off the tube's axis, and looks about."""
    share = np.linspace(0, 1, FRAMES)
    poses = np.tile(np.eye(4), (FRAMES, 1, 1))
    poses[:, :3, :3] = Rotation.from_euler("y", turn_deg * np.sin(5 * share)[:, None], degrees=True).as_matrix()
    poses[:, :3, 3] = mm * np.column_stack([share, 0.3 * np.sin(6 * share), 0.4 * share])
    return poses


def begun(poses, limits):
    odometry = Odometry(RayTable(CAMERA), 0, start=limits)
    for frame, image in enumerate(map(render, poses)):
        odometry.process(frame, image, odometry.view(image, MASK))
    return odometry.finish()


def test_a_film_whose_camera_hardly_moves_is_tracked_once_more_and_posed_whole(tmp_path):
    poses = hovering(HARDLY_MM)
    assert begun(poses, USUAL_START) == []
    workspace, frames = stored(tmp_path, [render(pose) for pose in poses])
    told = SilentProgress()
    with frame_features(workspace) as features:
        (submap,) = track_frames(frames, features, Config().front_end_settings, workspace, told).submaps
    assert len(submap.frames) == FRAMES
    errors = trajectory_errors(submap.world_from_camera, poses[submap.frames])
    assert errors.ate_rmse < 0.02 * HARDLY_MM


@pytest.mark.parametrize("limits", [USUAL_START, START_OF_A_STILL_CAMERA])
def test_a_camera_that_only_turns_begins_no_map(limits):
    assert begun(hovering(0.0, turn_deg=12.0), limits) == []
