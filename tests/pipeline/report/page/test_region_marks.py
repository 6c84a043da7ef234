"""Where the report marks a missed region, against OpenCV's projection."""

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from pipeline.report.page.region_marks import INNER, mark_region

WIDTH, HEIGHT, FOCAL = 400, 300, 180.0
HALF_VIEW = np.array([WIDTH, HEIGHT]) / 2 / FOCAL
AHEAD = np.array([0.0, 0.0, 5.0])


def views(*turns_deg):
    """Cameras at the origin, turned about the vertical axis."""
    poses = np.tile(np.eye(4), (len(turns_deg), 1, 1))
    poses[:, :3, :3] = Rotation.from_euler("y", np.reshape(turns_deg, (-1, 1)), degrees=True).as_matrix()
    return poses


def test_the_mark_is_where_opencv_projects_the_place():
    rng = np.random.default_rng(3)
    matrix = np.array([[FOCAL, 0, WIDTH / 2], [0, FOCAL, HEIGHT / 2], [0, 0, 1.0]])
    for _ in range(20):
        pose = np.eye(4)
        pose[:3, :3], pose[:3, 3] = Rotation.random(random_state=rng).as_matrix(), rng.normal(size=3)
        place = pose[:3, 3] + pose[:3, :3] @ np.array([rng.uniform(-0.9, 0.9), rng.uniform(-0.7, 0.7), 1.0]) * 4
        back = np.linalg.inv(pose)
        pixel = cv2.projectPoints(place[None], cv2.Rodrigues(back[:3, :3])[0], back[:3, 3], matrix, None)[0].ravel()
        mark = mark_region(place, 7, pose[None], np.array([9]), HALF_VIEW)
        assert mark.at == pytest.approx(pixel / [WIDTH, HEIGHT])


def test_the_nearest_frame_with_the_place_well_in_view_is_taken():
    at_rim = np.degrees(np.arctan(HALF_VIEW[0] * (1 + INNER) / 2))
    poses, frames = views(at_rim, 180.0, 10.0, -10.0), np.array([10, 11, 20, 30])
    mark = mark_region(AHEAD, 11, poses, frames, HALF_VIEW)
    assert mark.row == 2
    assert mark.at == pytest.approx((0.5 - np.tan(np.radians(10)) / HALF_VIEW[0] / 2, 0.5))
    assert mark_region(AHEAD, 29, poses, frames, HALF_VIEW).row == 3
    assert mark_region(AHEAD, 11, poses[:2], frames[:2], HALF_VIEW).row == 0  # only there is it in the picture at all


def test_a_place_in_no_picture_has_the_nearest_frame_and_no_mark():
    mark = mark_region(AHEAD, 12, views(90.0, 180.0), np.array([3, 13]), HALF_VIEW)
    assert (mark.row, mark.at) == (1, None)
