"""The lens model of docs/extending.md, known by its row alone to all that handle lenses."""

import json

import cv2
import numpy as np
import pytest

from haustra.core.camera import Camera, read_camera
from haustra.core.errors import HaustraError
from haustra.core.lenses import LENS_MODELS, LensModel
from haustra.core.ray_table import RayTable
from pipeline.depth.rectification import make_rectifier
from pipeline.mapping.submap import Submap, refined_camera
from reconstruction.evaluation.reference_surface import read_reference_surface
from reconstruction.evaluation.trajectory_io import write_tum
from tests.helpers.recipes import add_row, written

OMEGA = 0.9
PARAMS = (60.0, 62.0, 50.0, 39.0, OMEGA)
SIZE = (100, 80)


@pytest.fixture
def camera(monkeypatch):
    written("haustra/core/lenses/field_of_view.py", monkeypatch)
    with pytest.raises(HaustraError, match="unknown camera model 'FOV'"):
        Camera("FOV", *SIZE, PARAMS)
    assert add_row(LENS_MODELS, "haustra/core/lenses/__init__.py", monkeypatch, {"LensModel": LensModel}) == "FOV"
    return Camera("FOV", *SIZE, PARAMS)


def angle_of(radius):
    """The model's inverse in closed form: distorted radius over focal length -> angle off the axis."""
    return np.arctan(np.tan(radius * OMEGA) / (2 * np.tan(OMEGA / 2)))


def test_it_projects_by_its_closed_form(camera):
    angles = np.linspace(0.01, 1.2, 30)
    rays = np.stack([np.sin(angles), np.zeros(30), np.cos(angles)], axis=1)
    radius = (camera.project(rays)[:, 0] - 50.0) / 60.0
    np.testing.assert_allclose(angle_of(radius), angles, atol=1e-9)
    np.testing.assert_allclose(camera.project(np.array([[0.0, 0.0, 3.0]])), [[50.0, 39.0]], atol=1e-12)
    wide = 2 * np.degrees(angle_of(50 / 60))
    assert camera.field_of_view()[0] == pytest.approx(wide, abs=1e-2)
    assert not camera.is_pinhole
    assert Camera("FOV", *SIZE, (*PARAMS[:4], 0.0)).is_pinhole


def test_the_ray_table_inverts_it(camera):
    table = RayTable(camera)
    assert table.usable.all()
    corners = np.stack(np.meshgrid(np.arange(0, 100, 7.0), np.arange(0, 80, 7.0)), axis=-1).reshape(-1, 2)
    plane, _ = table.unproject(corners)
    distorted = np.hypot((corners[:, 0] - 50) / 60, (corners[:, 1] - 39) / 62)
    np.testing.assert_allclose(np.arctan(np.linalg.norm(plane, axis=1)), angle_of(distorted), atol=1e-6)
    np.testing.assert_allclose(table.project(np.column_stack([plane, np.ones(len(plane))])), corners, atol=1e-3)


def test_a_rectified_picture_has_straight_lines(camera):
    """A board of two colours, split by a line of the scene, is split by a straight line in the pinhole's picture."""
    plane, _ = RayTable(camera).unproject(
        np.stack(np.meshgrid(np.arange(100) + 0.5, np.arange(80) + 0.5), -1).reshape(-1, 2)
    )
    board = np.where(plane[:, 0] > 0.3 + 0.2 * plane[:, 1], 255, 0).astype(np.uint8).reshape(80, 100)
    rectifier = make_rectifier(camera)
    picture = rectifier.image(np.repeat(board[..., None], 3, axis=2))
    (fx, fy), (cx, cy) = rectifier.camera.focal, rectifier.camera.centre
    shown = rectifier.mask(np.full((80, 100), 255, np.uint8)) > 0
    x, y = np.meshgrid((np.arange(100) + 0.5 - cx) / fx, (np.arange(80) + 0.5 - cy) / fy)
    off = x - 0.3 - 0.2 * y
    clear = shown & (np.abs(off) > 3 / fx)
    assert clear.mean() > 0.5
    np.testing.assert_array_equal(picture[..., 0][clear] > 127, off[clear] > 0)
    assert rectifier.camera.is_pinhole


def test_camera_files_are_read_and_refused(camera, tmp_path):
    path = tmp_path / "camera.json"
    path.write_text(json.dumps(camera.to_dict()))
    assert read_camera(path) == camera
    path.write_text(json.dumps({"model": "FOV", "width": 100, "height": 80, "params": PARAMS[:4]}))
    with pytest.raises(HaustraError, match="FOV takes 5 parameters, not 4"):
        read_camera(path)
    half = camera.cropped_and_scaled(10, 20, 60, 40, 0.5)
    rays = np.array([[0.2, 0.1, 1.0], [-0.3, 0.4, 1.0]])
    np.testing.assert_allclose(half.project(rays), (camera.project(rays) - [10, 20]) * 0.5)
    nothing = np.zeros((0, 3))
    submap = Submap(*(np.zeros(0, int), np.zeros((0, 4, 4)), nothing, np.zeros(0), nothing, nothing), PARAMS)
    assert refined_camera(camera, submap) == camera


def test_true_depth_becomes_the_wall(camera, tmp_path):
    """A plane at 40 mm square to the axis, seen from a pose 5 mm along x."""
    (tmp_path / "depth").mkdir()
    (tmp_path / "camera.json").write_text(json.dumps(camera.to_dict() | {"depth_unit_mm": 0.01}))
    cv2.imwrite(str(tmp_path / "depth" / "00000.png"), np.full((80, 100), 4000, np.uint16))
    world_from_camera = np.eye(4)
    world_from_camera[0, 3] = 5.0
    write_tum(tmp_path / "trajectory.txt", np.zeros(1), world_from_camera[None])
    surface = read_reference_surface(tmp_path)
    np.testing.assert_allclose(surface.seen[:, 2], 40.0, atol=1e-6)
    reach = 40 * np.tan(angle_of(49.5 / 60))  # the centre of the last pixel of the middle row
    assert surface.seen[:, 0].max() >= 5 + 0.97 * reach
    left = surface.seen[np.abs(surface.seen[:, 1]) < 2, 0].min()
    assert left == pytest.approx(5 - reach, abs=0.6)
