"""Where the report marks a missed region, against OpenCV's projection."""

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from haustra.core.camera import Camera
from pipeline.report.page.region_marks import FARTHER, mark_region

CAMERA = Camera("PINHOLE", 400, 300, (180.0, 170.0, 150.0, 165.0))  # its axis is not in the picture's middle
AHEAD = np.array([0.0, 0.0, 5.0])


def views(turns_deg, back=0.0):
    """Cameras (N,4,4) turned about the vertical axis at the origin, or so far behind it."""
    poses = np.tile(np.eye(4), (len(turns_deg), 1, 1))
    poses[:, :3, :3] = Rotation.from_euler("y", np.reshape(turns_deg, (-1, 1)), degrees=True).as_matrix()
    poses[:, 2, 3] = -np.asarray(back)
    return poses


def test_the_mark_is_where_opencv_projects_the_place():
    rng = np.random.default_rng(3)
    (fx, fy), (cx, cy) = CAMERA.focal, CAMERA.centre
    matrix = np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1.0]])
    for _ in range(20):
        pose = np.eye(4)
        pose[:3, :3], pose[:3, 3] = Rotation.random(random_state=rng).as_matrix(), rng.normal(size=3)
        place = pose[:3, 3] + pose[:3, :3] @ np.array([rng.uniform(-0.8, 1.3), rng.uniform(-0.9, 0.7), 1.0]) * 4
        back = np.linalg.inv(pose)
        pixel = cv2.projectPoints(place[None], cv2.Rodrigues(back[:3, :3])[0], back[:3, 3], matrix, None)[0].ravel()
        mark = mark_region(place, 7, pose[None], np.array([9]), CAMERA)
        assert mark.at == pytest.approx(pixel / [CAMERA.width, CAMERA.height])


def test_the_nearest_in_time_is_taken_or_one_as_near_with_the_place_farther_inside():
    poses, frames = views([35.0, 180.0, 10.0]), np.array([10, 11, 20])
    assert mark_region(AHEAD, 11, poses, frames, CAMERA).row == 2  # 10 has it at the rim, 11 behind it
    assert mark_region(AHEAD, 11, poses[:2], frames[:2], CAMERA).row == 0
    assert mark_region(AHEAD, 11, views([10.0, 35.0, 5.0]), frames, CAMERA).row == 0  # 20 has it nearer to the middle
    far = views([35.0, 180.0, 10.0], back=[0.0, 0.0, 5 * FARTHER])
    assert mark_region(AHEAD, 11, far, frames, CAMERA).row == 0


def test_a_place_in_no_picture_has_the_nearest_frame_and_no_mark():
    mark = mark_region(AHEAD, 12, views([90.0, 180.0]), np.array([3, 13]), CAMERA)
    assert (mark.row, mark.at) == (1, None)
