"""Lens models against OpenCV, crops and scales against projecting first, rectification against straight lines."""

import json
from dataclasses import replace

import cv2
import numpy as np
import pycolmap
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.optimize import least_squares

from haustra.core.camera import Camera, guess_camera, read_camera
from haustra.core.errors import HaustraError
from pipeline.depth.rectification import make_rectifier
from pipeline.input.calibration import calibrate
from pipeline.input.camera_presets import PRESETS

RAYS = np.random.default_rng(0).uniform([-0.8, -0.8, 1], [0.8, 0.8, 1.5], (200, 3))
OPENCV = Camera("OPENCV", 640, 480, (400.0, 410.0, 322.0, 241.0, -0.2, 0.05, 0.001, -0.002))
FISHEYE = Camera("OPENCV_FISHEYE", 640, 480, (300.0, 305.0, 318.0, 243.0, -0.05, 0.01, -0.002, 0.0004))


def test_opencv_model_equals_opencv():
    expected, _ = cv2.projectPoints(RAYS, np.zeros(3), np.zeros(3), OPENCV.matrix, np.array(OPENCV.distortion))
    np.testing.assert_allclose(OPENCV.project(RAYS), expected[:, 0], atol=1e-9)


def test_full_opencv_model_equals_opencv():
    distortion = (-0.2, 0.05, 0.001, -0.002, 0.01, 0.02, 0.003, -0.001)
    camera = Camera("FULL_OPENCV", 640, 480, (400.0, 410.0, 322.0, 241.0, *distortion))
    expected, _ = cv2.projectPoints(RAYS, np.zeros(3), np.zeros(3), camera.matrix, np.array(distortion))
    np.testing.assert_allclose(camera.project(RAYS), expected[:, 0], atol=1e-9)


def test_fisheye_equals_opencv():
    zero = np.zeros(3)
    expected, _ = cv2.fisheye.projectPoints(RAYS[:, None], zero, zero, FISHEYE.matrix, np.array(FISHEYE.distortion))
    np.testing.assert_allclose(FISHEYE.project(RAYS), expected[:, 0], atol=1e-9)


@pytest.mark.parametrize("model", ["SIMPLE_PINHOLE", "PINHOLE", "SIMPLE_RADIAL", "RADIAL"])
def test_radial_models_are_special_cases(model):
    params = {
        "SIMPLE_PINHOLE": (400.0, 322.0, 241.0),
        "PINHOLE": (400.0, 400.0, 322.0, 241.0),
        "SIMPLE_RADIAL": (400.0, 322.0, 241.0, -0.1),
        "RADIAL": (400.0, 322.0, 241.0, -0.1, 0.02),
    }[model]
    k = {"SIMPLE_RADIAL": (-0.1, 0.0), "RADIAL": (-0.1, 0.02)}.get(model, (0.0, 0.0))
    general = Camera("OPENCV", 640, 480, (400.0, 400.0, 322.0, 241.0, *k, 0.0, 0.0))
    np.testing.assert_allclose(Camera(model, 640, 480, params).project(RAYS), general.project(RAYS), atol=1e-12)


@pytest.mark.parametrize(("model", "terms"), [("SIMPLE_RADIAL_FISHEYE", (-0.13,)), ("RADIAL_FISHEYE", (-0.13, 0.02))])
def test_fisheyes_of_one_focal_length_equal_colmap(model, terms):
    params = (300.0, 322.0, 241.0, *terms)
    known = pycolmap.Camera(model=model, width=640, height=480, params=params)
    one = Camera(model, 640, 480, params)
    expected = known.img_from_cam(RAYS)
    np.testing.assert_allclose(one.project(RAYS), expected, atol=1e-9)
    plane, reached = one.unproject(expected)
    assert reached.all()
    np.testing.assert_allclose(plane, RAYS[:, :2] / RAYS[:, 2:], atol=1e-4)


@given(st.integers(0, 200), st.integers(0, 150), st.floats(0.2, 3.0), st.sampled_from([OPENCV, FISHEYE]))
def test_crop_and_scale_commute_with_projection(x0, y0, scale, camera):
    moved = camera.cropped_and_scaled(x0, y0, 300, 200, scale)
    np.testing.assert_allclose(moved.project(RAYS), (camera.project(RAYS) - [x0, y0]) * scale, atol=1e-9)
    assert (moved.width, moved.height) == (round(300 * scale), round(200 * scale))


def test_field_of_view_of_a_pinhole():
    camera = Camera("PINHOLE", 320, 320, (159.45, 159.45, 160.0, 160.0))
    assert camera.field_of_view()[0] == pytest.approx(2 * np.degrees(np.arctan(160 / 159.45)), abs=0.05)
    assert guess_camera(320, 320, (0, 0, 320, 320)).field_of_view()[0] == pytest.approx(100, abs=0.05)


@pytest.mark.parametrize("camera", [OPENCV, FISHEYE])
def test_rectified_pixels_look_along_the_pinhole_ray(camera):
    rectifier = make_rectifier(camera, 120)
    for row, column in ((240, 320), (100, 500), (400, 60)):
        (fx, fy), (cx, cy) = rectifier.camera.focal, rectifier.camera.centre
        ray = np.array([[(column + 0.5 - cx) / fx, (row + 0.5 - cy) / fy, 1.0]])
        np.testing.assert_allclose(rectifier.map_xy[row, column] + 0.5, camera.project(ray)[0], atol=1e-3)


def test_a_lens_that_turns_back_within_its_picture_sees_no_farther_than_that():
    camera = Camera("RADIAL", 400, 400, (200.0, 200.0, 200.0, -0.25, 0.0))
    limit = np.degrees(camera.lens.valid_angle(camera.distortion))
    assert limit == pytest.approx(49.1, abs=0.1)
    assert camera.field_of_view() == pytest.approx((2 * limit, 2 * limit))
    rectifier = make_rectifier(camera)
    assert rectifier.camera.focal[0] == pytest.approx(200 / np.tan(np.radians(limit)))
    assert (rectifier.map_xy[..., 0] > -5).mean() > 0.7


def test_a_pinhole_is_not_resampled():
    image = np.random.default_rng(0).integers(0, 255, (320, 320, 3), dtype=np.uint8)
    rectifier = make_rectifier(PRESETS["vr-caps"].camera, 120)
    assert rectifier.image(image) is image
    assert rectifier.kept_share == 1


@pytest.mark.parametrize("camera", [OPENCV, FISHEYE, guess_camera(640, 480, (0, 0, 640, 480))])
def test_the_lens_of_a_cut_out_box_is_that_of_the_whole_picture(camera):
    box, scale = (33, 17, 560, 420), 0.8
    again = camera.cropped_and_scaled(*box, scale).of_whole(*box[:2], camera.width, camera.height, scale)
    assert (again.model, again.width, again.height) == (camera.model, camera.width, camera.height)
    np.testing.assert_allclose(again.params, camera.params, rtol=1e-12)


def test_a_wide_fisheye_says_how_much_is_cut():
    rectifier = make_rectifier(PRESETS["endomapper-03"].camera.cropped_and_scaled(0, 0, 1440, 1080, 1 / 3), 110)
    assert 0.5 < rectifier.kept_share < 0.95
    assert rectifier.camera.field_of_view()[0] == pytest.approx(110, abs=1)


def test_a_picture_without_its_corners_is_guessed_to_be_a_colonoscope_s(tmp_path):
    """The content's longer side shows the angle that EndoMapper's 1440 pixels do, about the middle of the content."""
    guess = calibrate("auto", tmp_path, (720, 576), (40, 18, 640, 540), cut_corners=True).camera
    mean = PRESETS["colonoscope"].camera
    off = np.array([[0.0, 0.0], [300.0, 0.0], [-200.0, 150.0]])
    rays, _ = guess.unproject(off + np.array([360.0, 288.0]))
    expected, _ = mean.unproject(off * 1440 / 640 + mean.centre)
    np.testing.assert_allclose(rays, expected, atol=1e-6)
    assert not guess.trusted
    assert calibrate("auto", tmp_path, (720, 576), (40, 18, 640, 540)).camera.model == "RADIAL"


@pytest.mark.parametrize("name", PRESETS)
def test_presets_scale_with_the_frame_and_refuse_another_shape(name, tmp_path):
    camera = PRESETS[name].camera
    half = (camera.width // 2, camera.height // 2)
    assert calibrate(name, tmp_path, half, (0, 0, *half)).camera.focal[0] == pytest.approx(
        camera.focal[0] / 2, rel=0.01
    )
    with pytest.raises(HaustraError, match="cropped otherwise"):
        calibrate(name, tmp_path, (camera.width, camera.height // 2), (0, 0, 1, 1))


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        ({"model": "PINHOLE", "width": 320, "height": 320}, "params"),
        ({"model": "OMNI", "width": 320, "height": 320, "params": [1]}, "unknown camera model"),
        ({"model": "PINHOLE", "width": 320, "height": 320, "params": [1, 2, 3]}, "takes 4 parameters"),
        ({"model": "PINHOLE", "width": 320, "height": 320, "params": [-1, 2, 3, 4]}, "positive"),
        ({"model": "PINHOLE", "width": 320, "height": 320, "params": None}, "params is null, and must be a list of"),
        ({"model": "PINHOLE", "width": 320, "height": 320, "params": [True, 2, 3, 4]}, "params holds true, which is"),
        ({"model": "PINHOLE", "width": 320, "height": 320, "params": ["a", 2, 3, 4]}, 'params holds "a", which is no'),
        ({"model": "PINHOLE", "width": 320.5, "height": 320, "params": [1, 2, 3, 4]}, "width is 320.5, and must be a"),
        ({"model": "PINHOLE", "width": 320, "height": 320, "params": [float("nan"), 2, 3, 4]}, "finite"),
    ],
)
def test_wrong_camera_files_are_named(tmp_path, fields, message):
    path = tmp_path / "camera.json"
    path.write_text(json.dumps(fields))
    with pytest.raises(HaustraError, match=message):
        read_camera(path)


def test_a_guessed_lens_can_become_a_fisheye():
    """Two radial terms follow an equidistant lens over 118 degrees to two pixels at worst; one does not."""
    theta = np.radians(np.linspace(0.5, 59, 60))
    rays = np.stack([np.sin(theta), np.zeros_like(theta), np.cos(theta)], axis=1)
    true = Camera("OPENCV_FISHEYE", 320, 320, (156.2, 156.2, 160.0, 160.0, -0.02, 0.0, 0.0, 0.0)).project(rays)[:, 0]
    guess = guess_camera(320, 320, (0, 0, 320, 320))
    free = [0, *range(3, len(guess.params))]  # focal length and radial terms

    def off(values):
        params = np.array(guess.params)
        params[free] = values
        return replace(guess, params=tuple(params)).project(rays)[:, 0] - true

    found = least_squares(off, np.array(guess.params)[free]).x
    assert np.abs(off(found)).max() < 2.0
    one = replace(guess, model="SIMPLE_RADIAL", params=guess.params[:4])
    best = least_squares(
        lambda x: replace(one, params=(x[0], 160.0, 160.0, x[1])).project(rays)[:, 0] - true, [150, -0.1]
    )
    assert np.abs(best.fun).max() > 5.0


def test_the_mean_colonoscope_has_the_mean_radius():
    """At each angle off the axis, of the eighteen, to two pixels of 1440; it is a start and no calibration."""
    mean = PRESETS["colonoscope"].camera
    assert not mean.trusted
    assert len(mean.params) == 4
    theta = np.radians(np.linspace(1, 75, 20))
    rays = np.stack([np.sin(theta), np.zeros_like(theta), np.cos(theta)], axis=1)
    cameras = [PRESETS[f"endomapper-{number:02d}"].camera for number in range(1, 19)]
    radii = np.mean([camera.project(rays)[:, 0] - camera.centre[0] for camera in cameras], axis=0)
    np.testing.assert_allclose(mean.project(rays)[:, 0] - mean.centre[0], radii, atol=2.0)


@pytest.mark.parametrize("number", range(1, 19))
def test_one_focal_length_and_one_term_are_enough_for_each_colonoscope(number):
    """To 3 pixels of 1440, RMS over the picture; so the guess has no more to refine."""
    theta = np.linspace(0.01, 1.5, 300)
    ahead = np.stack([np.sin(theta), np.zeros_like(theta), np.cos(theta)], axis=1)
    scope = PRESETS[f"endomapper-{number:02d}"].camera
    radius = scope.focal_px * scope.lens.distort(ahead, scope.distortion)[:, 0]
    guess = PRESETS["colonoscope"].camera

    def off(x):
        return np.sqrt(radius) * (x[0] * guess.lens.distort(ahead, (x[1],))[:, 0] - radius)

    best = least_squares(off, [guess.focal[0], *guess.distortion], x_scale=[100, 0.1])
    assert np.sqrt(np.square(best.fun).sum() / radius.sum()) < 3.0


@pytest.mark.parametrize("name", ["simcol3d", "endomapper-sim", "vr-caps", "csd"])
def test_rendered_pictures_have_their_centre_in_the_middle(name):
    """A renderer's frustum is symmetric; COLMAP's middle of 475 px is 237.5, of 960 px 480."""
    camera = PRESETS[name].camera
    assert camera.centre == (camera.width / 2, camera.height / 2)
