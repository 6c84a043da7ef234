"""Camera files in the encoding that each program documents: their rays against OpenCV's, or a closed form."""

import json
import struct
from types import SimpleNamespace

import cv2
import numpy as np
import pytest

from haustra.core.camera import Camera
from haustra.core.errors import HaustraError
from pipeline.frontend.colmap.front_end import colmap_job
from pipeline.input.calibration import calibrate, check_choice
from pipeline.input.camera_files.registry import read_lens
from tests.helpers.camera_files import FISHEYE, PINHOLE_RAYS, TERMS, K, fisheye_pixels, opencv_pixels, ray_error
from tests.helpers.camera_texts import (
    BROWN_FILES,
    ENDOMAPPER,
    FISHEYE_FILES,
    KALIBR,
    MATLAB,
    NERFSTUDIO,
    OPENCV_YAML,
    PYSLAM,
    PYTHON_JSON,
    ROS,
    TEXT,
    WITHOUT_SIZE,
)

MOST = 1e-6  # rad


@pytest.mark.parametrize("name", BROWN_FILES)
def test_one_lens_in_many_files(tmp_path, name):
    (tmp_path / name).write_text(BROWN_FILES[name])
    camera = calibrate(str(tmp_path / name), tmp_path, (640, 480), (0, 0, 640, 480)).camera
    assert camera.trusted
    assert ray_error(camera, opencv_pixels(PINHOLE_RAYS, K, TERMS), PINHOLE_RAYS) < MOST
    _, lens = read_lens(tmp_path / name)
    assert lens.size == (None if name in WITHOUT_SIZE else (640, 480))


@pytest.mark.parametrize("name", FISHEYE_FILES)
def test_one_fisheye_in_many_files(tmp_path, name):
    (tmp_path / name).write_text(FISHEYE_FILES[name])
    camera = calibrate(str(tmp_path / name), tmp_path, (640, 480), (0, 0, 640, 480)).camera
    rays = PINHOLE_RAYS * [2.0, 2.0, 1.0]  # to 70 degrees off the axis
    assert ray_error(camera, fisheye_pixels(rays, K, FISHEYE), rays) < MOST


@pytest.mark.parametrize("name", ["written.yaml", "written.xml", "written.json"])
def test_what_opencv_itself_writes(tmp_path, name):
    """The first line of its YAML is another one from version 5 on."""
    storage = cv2.FileStorage(str(tmp_path / name), cv2.FILE_STORAGE_WRITE)
    storage.write("image_width", 640)
    storage.write("image_height", 480)
    storage.write("camera_matrix", K)
    storage.write("distortion_coefficients", np.array([TERMS]))
    storage.release()
    camera = calibrate(str(tmp_path / name), tmp_path, (640, 480), (0, 0, 640, 480)).camera
    assert ray_error(camera, opencv_pixels(PINHOLE_RAYS, K, TERMS), PINHOLE_RAYS) < MOST


def test_colmap_in_binary(tmp_path):
    """format.html: count, then id, model, width, height and parameters; 9 is RADIAL_FISHEYE, whose k1 k2 are OpenCV's
    first two terms."""
    params = (400.0, 323.0, 238.75, -0.13, -0.006)
    (tmp_path / "cameras.bin").write_bytes(struct.pack("<QIiQQ5d", 1, 3, 9, 640, 480, *params))
    camera = calibrate(str(tmp_path / "cameras.bin"), tmp_path, (640, 480), (0, 0, 640, 480)).camera
    pixels = fisheye_pixels(
        PINHOLE_RAYS, np.array([[400, 0, 322.5], [0, 400, 238.25], [0, 0, 1]]), (-0.13, -0.006, 0, 0)
    )
    assert ray_error(camera, pixels, PINHOLE_RAYS) < MOST
    (tmp_path / "cameras.bin").write_bytes(struct.pack("<QIiQQ2d", 1, 3, 9, 640, 480, *params[:2]))
    with pytest.raises(HaustraError, match="cut off"):
        read_lens(tmp_path / "cameras.bin")


def ocam_ray(row, column, polynomial, centre, affine):
    """OCamCalib's own cam2world (ocam_functions.c), turned from its axes (down, right, backwards) to ours."""
    c, d, e = affine
    x = ((row - centre[0]) - d * (column - centre[1])) / (c - d * e)
    y = (-e * (row - centre[0]) + c * (column - centre[1])) / (c - d * e)
    z = np.polyval(polynomial[::-1], np.hypot(x, y))
    return np.column_stack([y, x, -z])


def test_ocamcalib(tmp_path):
    polynomial, centre, affine = (-190.0, 0.0, 1.8e-3, -1.1e-6, 4.9e-9), (238.25, 322.5), (0.9991, 0.0021, -0.0013)
    (tmp_path / "calib_results.txt").write_text(
        "#polynomial coefficients for the DIRECT mapping function (ocam_model.ss in MATLAB).\n\n"
        f"5 {' '.join(map(str, polynomial))}\n\n#polynomial coefficients for the inverse mapping function\n\n"
        '3 1.0 2.0 3.0\n\n#center: "row" and "column", starting from 0 (C convention)\n\n'
        f'{centre[0]} {centre[1]}\n\n#affine parameters "c", "d", "e"\n\n{" ".join(map(str, affine))}\n\n'
        '#image size: "height" and "width"\n\n480 640\n'
    )
    camera = calibrate(str(tmp_path / "calib_results.txt"), tmp_path, (640, 480), (0, 0, 640, 480)).camera
    column, row = np.meshgrid(np.arange(200, 440, 20.0), np.arange(140, 340, 20.0))
    rays = ocam_ray(row.ravel(), column.ravel(), polynomial, centre, affine)
    assert ray_error(camera, np.column_stack([column.ravel(), row.ravel()]) + 0.5, rays) < 1e-9


def test_the_line_of_c3vd_and_a_fisheye_of_matlab(tmp_path):
    """Both count from (1, 1): what C3VD's program has at 0-based pixel (x, y), this centre puts at (x + 1, y + 1)."""
    a0, a2, a3, a4, c, d, e = 190.0, -1.8e-3, 1.1e-6, -4.9e-9, 0.9991, 0.0021, -0.0013
    (tmp_path / "cam.txt").write_text(f"640 480 323.5 239.25 {a0} {a2} {a3} {a4} {c} {d} {e}\n")
    (tmp_path / "fisheye.json").write_text(
        json.dumps(
            {
                "Intrinsics": {
                    "MappingCoefficients": [a0, a2, a3, a4],
                    "ImageSize": [480, 640],
                    "DistortionCenter": [323.5, 239.25],
                    "StretchMatrix": [[c, d], [e, 1]],
                }
            }
        )
    )
    x, y = (grid.ravel() for grid in np.meshgrid(np.arange(200, 440, 20.0), np.arange(140, 340, 20.0)))
    uv = np.linalg.solve([[c, d], [e, 1]], np.stack([x - 322.5, y - 238.25])).T
    rho = np.hypot(*uv.T)
    rays = np.column_stack([uv, a0 + a2 * rho**2 + a3 * rho**3 + a4 * rho**4])
    for name in ("cam.txt", "fisheye.json"):
        camera = calibrate(str(tmp_path / name), tmp_path, (640, 480), (0, 0, 640, 480)).camera
        assert camera.model == "SCARAMUZZA"
        assert ray_error(camera, np.column_stack([x, y]) + 0.5, rays) < 1e-9


def test_text_in_two_files_and_by_columns(tmp_path):
    (tmp_path / "calib.left.intrinsics.txt").write_text("410 0 322.5\n0 405 238.25\n0 0 1\n")
    (tmp_path / "calib.left.distortion.txt").write_text("-0.2 0.05 0.001 -0.002 0.01\n")
    calibration = calibrate(str(tmp_path / "calib.left.intrinsics.txt"), tmp_path, (640, 480), (0, 0, 640, 480))
    assert ray_error(calibration.camera, opencv_pixels(PINHOLE_RAYS, K, TERMS), PINHOLE_RAYS) < MOST
    assert "calib.left.distortion.txt" in calibration.origin
    (tmp_path / "matlab.txt").write_text("410,0,0,0,405,0,322.5,238.25,1\n")
    assert read_lens(tmp_path / "matlab.txt")[1].params == (410, 405, 323.0, 238.75)
    with pytest.raises(HaustraError, match="distortion terms alone"):
        read_lens(tmp_path / "calib.left.distortion.txt")


def test_a_matrix_of_90_degrees_is_no_slip_of_simcol3d(tmp_path):
    """Its focal length is half the picture's side, as its centre is; a skew beside it is called by its name."""
    (tmp_path / "k.txt").write_text("120 0 120\n0 120 120\n0 0 1\n")
    assert read_lens(tmp_path / "k.txt")[1].params == (120, 120, 120.5, 120.5)
    (tmp_path / "k.txt").write_text("120 5 120\n0 120 120\n0 0 1\n")
    with pytest.raises(HaustraError, match="skew of 5 px"):
        read_lens(tmp_path / "k.txt")


def test_scaled_where_the_ratio_says_so_and_refused_otherwise(tmp_path):
    (tmp_path / "ros.yaml").write_text(ROS)
    half = calibrate(str(tmp_path / "ros.yaml"), tmp_path, (320, 240), (0, 0, 320, 240))
    assert "scaled from 640x480" in half.origin
    corners = opencv_pixels(PINHOLE_RAYS, K, TERMS)  # from the corner of the first pixel, these simply halve
    assert ray_error(half.camera, corners / 2, PINHOLE_RAYS) < MOST
    with pytest.raises(HaustraError, match=r"640x480.*720x480.*another crop"):
        calibrate(str(tmp_path / "ros.yaml"), tmp_path, (720, 480), (0, 0, 720, 480))


def test_a_file_without_a_size(tmp_path):
    (tmp_path / "k.txt").write_text(TEXT)
    assert "names no size" in calibrate(str(tmp_path / "k.txt"), tmp_path, (640, 480), (0, 0, 640, 480)).origin
    with pytest.raises(HaustraError, match="not that of frames of 1920x1080"):
        calibrate(str(tmp_path / "k.txt"), tmp_path, (1920, 1080), (0, 0, 1920, 1080))


@pytest.mark.parametrize(
    ("name", "text", "message"),
    [
        ("a.yaml", ROS.replace("plumb_bob", "omnidirectional"), "none of plumb_bob"),
        ("a.yaml", KALIBR.replace("equidistant", "fov"), "pinhole-fov"),
        ("a.yaml", KALIBR.replace("  resolution: [640, 480]\n", ""), "lacks resolution"),
        ("a.yaml", OPENCV_YAML[: OPENCV_YAML.index("distortion")], "no distortion coefficients"),
        ("a.yaml", OPENCV_YAML.replace("410., 0.,", "410., 9.,"), "skew of 9 px"),
        ("a.yaml", '%YAML:1.0\nCamera.type: "Omni"\n' + PYSLAM, "'omni'"),
        ("a.yaml", "%YAML:1.0\n---\nnothing: [1, 2", "no camera file that is known"),
        ("a.xml", ENDOMAPPER.replace("calibu_fu_fv_u0_v0_kb4", "sls"), "geometrical"),
        ("a.xml", ENDOMAPPER.replace("<height> 480 </height>", ""), "lacks <height>"),
        ("a.xml", ENDOMAPPER[:200], "not whole XML"),
        ("a.json", json.dumps(NERFSTUDIO | {"camera_model": "EQUIRECTANGULAR"}), "EQUIRECTANGULAR"),
        ("a.json", json.dumps({"frames": [{"fl_x": 1}, {"fl_x": 2}]}), "lenses of their own"),
        ("a.json", json.dumps(MATLAB | {"ImageSize": "large"}), "MATLAB JSON"),
        ("a.txt", "1 OPENCV 640 480 1 1 0 0 0 0 0 0\n2 OPENCV 640 480 2 2 0 0 0 0 0 0\n", "2 cameras that differ"),
        ("a.txt", "1 FOV 640 480 1 1 0 0 0.9\n", "FOV is none of"),
        ("a.txt", "227.60416 0 227.60416 0 237.5 237.5 0 0 1\n", "slip of SimCol3D"),
        ("a.txt", "all about my camera\n", "no camera file that is known"),
        ("a.json", json.dumps(PYTHON_JSON | {"camera_matrix": [[0.8, 0, 0.5], [0, 1.0, 0.5], [0, 0, 1]]}), "shares of"),
        ("a.json", json.dumps(PYTHON_JSON | {"camera_matrix": [[8, 0, 5], [7, 8, 5], [0, 0, 1]]}), "fx 0 cx"),
        (
            "a.json",
            json.dumps(PYTHON_JSON | {"dist_coeff": [[-0.1], [0.02], [0.2], [-0.1]]}),
            "seem to be of cv2.fisheye",
        ),
        ("a.mat", "MATLAB 5.0 MAT-file", "jsonencode"),
        ("a.yaml", ROS.replace("410.0", "-410.0"), "focal length positive"),
        ("a.txt", "1 PINHOLE 640 480 2.8 2.8 320 240\n", "focal length is 2.8; it must be in pixels"),
        ("a.json", json.dumps(PYTHON_JSON | {"camera_matrix": [[2.8, 0, 322], [0, 2.8, 238], [0, 0, 1]]}), "be in mm"),
        ("a.yaml", ROS.replace("640", "640.5"), "its width is 640.5, and must be a whole number of pixels"),
        ("a.yaml", KALIBR.replace("[640", "[640.5"), "its width is 640.5, and must be a whole number of pixels"),
        ("a.json", json.dumps(NERFSTUDIO | {"cx": True}), "has true in cx, where a number belongs"),
        ("a.yaml", ROS.replace("[410.0", "[true"), "has true in data, where a number belongs"),
        ("a.yaml", ROS.replace("640", "1" + 400 * "0"), "over 100000 pixels a side"),
    ],
)
def test_what_is_missing_is_one_sentence(tmp_path, name, text, message):
    (tmp_path / name).write_text(text)
    with pytest.raises(HaustraError, match=message) as refusal:
        read_lens(tmp_path / name)
    assert str(refusal.value).startswith(str(tmp_path / name))
    assert "\n" not in str(refusal.value)


@pytest.mark.parametrize(("old", "new"), [("cols: 1", "cols: -1"), ("rows: 5", "rows: 4000"), (", 0.01 ]", " ]")])
def test_a_matrix_of_other_sides_than_its_numbers_never_reaches_opencv(tmp_path, old, new):
    """OpenCV writes past its memory there, which ends the process."""
    (tmp_path / "lens.yaml").write_text(OPENCV_YAML.replace(old, new))
    with pytest.raises(HaustraError, match=r"lens.yaml has a matrix of [-0-9]+x[-0-9]+ with [45] numbers"):
        read_lens(tmp_path / "lens.yaml")


def test_a_lens_that_colmap_lacks_is_kept_from_it():
    camera = Camera("SCARAMUZZA", 10, 10, (5.0, 5.0, 5.0, 0, 0, 0, 1, 0, 0))
    with pytest.raises(HaustraError, match="no lens model SCARAMUZZA; take --front-end odometry"):
        colmap_job(SimpleNamespace(camera=camera), 0, None)


@pytest.mark.parametrize(
    ("name", "said"),
    [("", "is the folder of a run; its lens is"), ("camera.json", "is the pinhole of that run's depth")],
)
def test_of_a_run_only_its_lens_is_a_camera_file(tmp_path, name, said):
    camera = {"model": "PINHOLE", "width": 64, "height": 48, "params": [30, 30, 32, 24]}
    for file in ("camera.json", "lens.json", "run.yaml"):
        (tmp_path / file).write_text(json.dumps(camera))
    check_choice(str(tmp_path / "lens.json"), tmp_path / "film.mp4")
    with pytest.raises(HaustraError, match=said):
        check_choice(str(tmp_path / name), tmp_path / "film.mp4")


@pytest.mark.parametrize("value", ["false", "yes", 1, None])
def test_trusted_is_true_or_false(tmp_path, value):
    camera = {"model": "PINHOLE", "width": 64, "height": 48, "params": [30, 30, 32, 24], "trusted": value}
    (tmp_path / "camera.json").write_text(json.dumps(camera))
    with pytest.raises(HaustraError, match="must be true or false"):
        read_lens(tmp_path / "camera.json")


def test_four_terms_without_a_model_s_name_are_said_to_be_read_as_a_plane_lens(tmp_path):
    """cv2.fisheye writes four as well; who names the model is believed and told nothing."""
    text = json.dumps(PYTHON_JSON | {"dist_coeff": [-0.1, 0.02, 0.001, -0.002]})
    (tmp_path / "a.json").write_text(text)
    _, lens = read_lens(tmp_path / "a.json")
    assert lens.model == "OPENCV"
    assert "read as k1 k2 p1 p2" in lens.note
    for model, read in (("fisheye", "OPENCV_FISHEYE"), ("opencv", "OPENCV")):
        (tmp_path / "a.json").write_text(json.dumps(json.loads(text) | {"model": model}))
        _, lens = read_lens(tmp_path / "a.json")
        assert (lens.model, lens.note) == (read, "")
