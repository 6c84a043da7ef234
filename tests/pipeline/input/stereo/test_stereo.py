"""Two eyes in a textured tube: rectified pictures, depth against the tube's closed form, and what cannot be right."""

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from haustra.core.errors import HaustraError
from pipeline.config import StereoSettings
from pipeline.input.stereo.rig_file import read_rig
from pipeline.input.stereo.stereo_source import StereoSource, split
from tests.helpers.tubes.textured_tube import RADIUS, SIZE, camera_at, render

BASELINE = 4.0
K = np.array([[96.0, 0, 95.5], [0, 96, 95.5], [0, 0, 1]])  # OpenCV's pixels of the tube's camera
TURN = Rotation.from_euler("xyz", [0.6, -0.9, 0.8], degrees=True).as_matrix()  # the eyes are not quite parallel
SHIFT = TURN @ [-BASELINE, 0, 0]  # right = TURN left + SHIFT
COUNT = 3


def right_pose(left):
    """world_from_right of the left eye's world_from_camera: x_right = TURN x_left + SHIFT."""
    right_from_left = np.eye(4)
    right_from_left[:3, :3], right_from_left[:3, 3] = TURN, SHIFT
    return left @ np.linalg.inv(right_from_left)


@pytest.fixture(scope="module")
def eyes():
    lefts = [camera_at(5 * k) for k in range(COUNT)]
    return [(render(world_from_camera), render(right_pose(world_from_camera))) for world_from_camera in lefts]


def opencv_matrix(name, values):
    rows, columns = np.atleast_2d(values).shape
    numbers = ", ".join(f"{value:.12g}" for value in np.ravel(values))
    return f"{name}: !!opencv-matrix\n   rows: {rows}\n   cols: {columns}\n   dt: d\n   data: [ {numbers} ]\n"


def write_yaml(path, shift=SHIFT, size=(SIZE, SIZE), turn=TURN, k=K):
    parts = {"M1": k, "D1": np.zeros(5), "M2": k, "D2": np.zeros(5), "R": turn, "T": np.reshape(shift, (3, 1))}
    text = "".join(opencv_matrix(name, values) for name, values in parts.items())
    sides = f"image_width: {size[0]}\nimage_height: {size[1]}\n" if size else ""
    path.write_text(f"%YAML:1.0\n---\n{sides}{text}")
    return path


def write_film(folder, eyes, layout):
    folder.mkdir()
    for k, (left, right) in enumerate(eyes):
        if layout == "interlaced":
            whole = np.empty_like(left)
            whole[0::2], whole[1::2] = left[0::2], right[1::2]
        else:
            whole = np.concatenate([left, right], axis=1 if layout == "side-by-side" else 0)
        cv2.imwrite(str(folder / f"{k:04d}.png"), whole[..., ::-1])
    return folder


def source_of(tmp_path, eyes, layout="side-by-side", **changed):
    tmp_path.mkdir(exist_ok=True)
    rig = write_yaml(tmp_path / "rig.yaml", **changed)
    film = write_film(tmp_path / "film", eyes, layout)
    return StereoSource(film, StereoSettings(calibration=str(rig), layout=layout))


def tube_depth(source, world_from_camera, shape):
    """z-depth (h,w) of the rectified left camera, whose axes are the left eye's turned by the rectification."""
    camera, scale = source.camera, source.camera.width / shape[1]
    shift = SHIFT.reshape(3, 1)
    turned = cv2.stereoRectify(K, np.zeros(5), K, np.zeros(5), (SIZE, SIZE), TURN, shift, flags=1024, alpha=0)
    new_from_left = turned[0]
    (fx, fy), (cx, cy) = camera.focal, camera.centre
    x, y = np.meshgrid((np.arange(shape[1]) + 0.5) * scale, (np.arange(shape[0]) + 0.5) * scale)
    rays = (
        np.stack([(x - cx) / fx, (y - cy) / fy, np.ones_like(x)], axis=-1)
        @ (world_from_camera[:3, :3] @ new_from_left.T).T
    )
    a = (rays[..., :2] ** 2).sum(-1)
    b = (rays[..., :2] * world_from_camera[:2, 3]).sum(-1)
    return (-b + np.sqrt(b * b - a * ((world_from_camera[:2, 3] ** 2).sum() - RADIUS**2))) / np.maximum(a, 1e-9)


@pytest.mark.parametrize("layout", ["side-by-side", "over-under"])
def test_depth_is_that_of_the_tube(tmp_path, eyes, layout):
    source = source_of(tmp_path, eyes, layout)
    source.check()
    seen = 0
    for k, frame in enumerate(source):
        seen += 1
        depth = source.depth_mm()
        assert frame.rgb.shape == (SIZE, SIZE, 3)
        true = tube_depth(source, camera_at(5 * k), depth.shape)
        known = (depth > 0) & (true < 60)
        assert known.mean() > 0.35
        off = depth[known] / true[known] - 1
        assert abs(np.median(off)) < 0.01
        sigma = source.depth_error_per_mm * true[known]  # relative
        assert np.median(np.abs(off)) < 2 * np.median(sigma)
        assert np.mean(np.abs(off) < 0.15) > 0.9
    assert seen == COUNT


def test_lines_of_two_eyes_are_parted(eyes):
    left, right = eyes[0]
    whole = np.empty_like(left)
    whole[0::2], whole[1::2] = left[0::2], right[1::2]
    first, second = split(whole, "interlaced")
    assert first.shape == left.shape
    assert (
        np.abs(first[20:-20].astype(int) - left[20:-20]).mean()
        < np.abs(first[20:-20].astype(int) - right[20:-20]).mean() / 3
    )
    assert np.abs(second[20:-20].astype(int) - right[20:-20]).mean() < 10


@pytest.mark.parametrize("height", [240, 241])
def test_each_eye_of_a_picture_by_lines_stays_where_it_is(height):
    """A slope has its value in each row, whichever eye's lines are missing."""
    slope = np.tile(np.linspace(8, 248, height)[:, None, None], (1, 64, 3))
    for eye in split(np.rint(slope).astype(np.uint8), "interlaced"):
        assert eye.shape == slope.shape
        np.testing.assert_allclose(eye[1:-1], slope[1:-1], atol=1.1)


def test_two_files(tmp_path, eyes):
    for name, which in (("left", 0), ("right", 1)):
        (tmp_path / name).mkdir()
        for k, pair in enumerate(eyes[: COUNT - which]):  # the right one ends earlier
            cv2.imwrite(str(tmp_path / name / f"{k:04d}.png"), pair[which][..., ::-1])
    rig = write_yaml(tmp_path / "rig.yaml")
    source = StereoSource(tmp_path / "left", StereoSettings(calibration=str(rig), right=str(tmp_path / "right")))
    assert len(list(source)) == COUNT - 1
    assert any("ends earlier" in note for note in source.notes)
    assert (source.depth_mm() > 0).mean() > 0.3


def test_swapped_eyes_are_one_sentence(tmp_path, eyes):
    with pytest.raises(HaustraError, match="the eyes are swapped in the film, or"):
        source_of(tmp_path, [(right, left) for left, right in eyes]).check()


def test_a_calibration_of_another_rig_is_one_sentence(tmp_path, eyes):
    tilted = Rotation.from_euler("x", 6, degrees=True).as_matrix() @ TURN
    with pytest.raises(HaustraError, match="off its row in the median"):
        source_of(tmp_path, eyes, turn=tilted).check()


def test_a_calibration_of_another_size(tmp_path, eyes):
    with pytest.raises(HaustraError, match="is for 640x480 pixels, but one eye has 192x192"):
        source_of(tmp_path, eyes, size=(640, 480)).check()


@pytest.mark.parametrize("times", [0.5, 2])
def test_a_calibration_that_names_no_size_and_is_of_another(tmp_path, eyes, times):
    """Its depth would be off by as much, on rows that fit."""
    with pytest.raises(HaustraError, match="names no picture size, and its centre"):
        source_of(tmp_path, eyes, size=None, k=np.diag([times, times, 1]) @ K).check()
    source_of(tmp_path / "own", eyes, size=None).check()


@pytest.mark.parametrize(
    ("changed", "told"),
    [
        ({"turn": -TURN}, "the rotation between the cameras is none"),
        ({"k": K.T}, "a camera matrix is none"),
        ({"shift": 10 * SHIFT}, "cameras 40 apart, which is no endoscope's baseline"),
    ],
)
def test_numbers_that_are_no_rig(tmp_path, changed, told):
    with pytest.raises(HaustraError, match=told):
        read_rig(write_yaml(tmp_path / "rig.yaml", **changed))


def test_metres_and_the_ini_of_stereomis(tmp_path):
    assert read_rig(write_yaml(tmp_path / "m.yaml", shift=SHIFT / 1000)).baseline_mm == pytest.approx(BASELINE)
    with pytest.raises(HaustraError, match="which is no endoscope's baseline"):
        read_rig(write_yaml(tmp_path / "far.yaml", shift=100 * SHIFT))
    left = "[StereoLeft]\nres_x=192\nres_y=192\nfc_x=96\nfc_y=97\ncc_x=95.5\ncc_y=94.5\nkc_0=-0.1\nkc_1=0.2\n"
    right = left.replace("Left", "Right").split("res_x")[0] + "fc_x=95\nfc_y=96\ncc_x=93\ncc_y=92\nkc_0=0\n"
    right += "".join(f"R_{k}={value}\n" for k, value in enumerate(np.eye(3).ravel())) + "T_0=-4.2\nT_1=0\nT_2=0\n"
    (tmp_path / "StereoCalibration.ini").write_text(left + right)
    rig = read_rig(tmp_path / "StereoCalibration.ini")
    assert (rig.size, rig.baseline_mm) == ((192, 192), pytest.approx(4.2))
    np.testing.assert_array_equal(rig.first, [[96, 0, 95.5], [0, 97, 94.5], [0, 0, 1]])
    np.testing.assert_array_equal(rig.first_terms, [-0.1, 0.2, 0, 0, 0])


def test_a_file_of_one_camera_is_no_rig(tmp_path):
    (tmp_path / "mono.yaml").write_text("%YAML:1.0\n---\n" + opencv_matrix("M1", K) + opencv_matrix("D1", np.zeros(5)))
    with pytest.raises(HaustraError, match="no stereo calibration: it lacks M2"):
        read_rig(tmp_path / "mono.yaml")


def test_a_number_of_a_rig_that_is_too_large_is_one_sentence(tmp_path):
    (tmp_path / "rig.json").write_text('{"M1": 1%s}' % (400 * "0"))
    with pytest.raises(HaustraError, match="a value has another form"):
        read_rig(tmp_path / "rig.json")


def test_the_three_text_files_of_hamlyn(tmp_path):
    rows = lambda matrix: "\n".join(" ".join(map(str, row)) for row in matrix)  # noqa: E731
    (tmp_path / "camera_extrinsic.txt").write_text(rows(np.vstack([TURN, SHIFT])) + "\n")
    with pytest.raises(HaustraError, match=r"beside it is no left_camera_calibration_intrinsic\.txt"):
        read_rig(tmp_path / "camera_extrinsic.txt")
    for eye, shift in (("Left", 0), ("Right", 2)):
        k = K + np.array([[0, 0, shift], [0, 0, 0], [0, 0, 0]])
        text = rows(k) + "\n-0.19 0.22 0.001 -0.002 0\n"
        (tmp_path / f"{eye}_Camera_Calibration_Intrinsic.txt").write_text(text)
    rig = read_rig(tmp_path / "camera_extrinsic.txt")
    np.testing.assert_allclose(rig.turn @ [1, 2, 30] + rig.shift, TURN @ [1, 2, 30] + SHIFT)
    assert rig.second[0, 2] - rig.first[0, 2] == 2
    np.testing.assert_allclose(rig.first_terms, [-0.19, 0.22, 0.001, -0.002, 0])
    (tmp_path / "Left_Camera_Calibration_Intrinsic.txt").write_text(rows(K))
    with pytest.raises(HaustraError, match="3 rows of numbers; Hamlyn's files have four"):
        read_rig(tmp_path / "camera_extrinsic.txt")
