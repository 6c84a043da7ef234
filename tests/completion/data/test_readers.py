"""Readers on tiny folders written in each data set's documented encoding, with the traps of each."""

from __future__ import annotations

import json
from pathlib import Path

import cv2
import numpy as np
import pytest

from completion.data.readers import read_evaluation_frames, recognise
from completion.evaluation.evaluate import LeftOut, Protocol, evaluate_frames
from completion.evaluation.outputs import Outputs
from completion.evaluation.predictors import load_predictor
from completion.evaluation.run import evaluate
from haustra.core.errors import CompletionError
from haustra.core.progress import SilentProgress

OpenEXR = pytest.importorskip("OpenEXR")
RGB = np.zeros((6, 8, 3), np.uint8)
RGB[..., 0] = 200  # red, so that a swapped channel order shows


def write_rgb(path: Path) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    cv2.imwrite(str(path), RGB[..., ::-1])


def write_16(path: Path, value: int) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    depth = np.full(RGB.shape[:2], value, np.uint16)
    depth[0, 0], depth[0, 1] = 0, 65535
    cv2.imwrite(str(path), depth)


def write_exr(path: Path, value: float) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    depth = np.full(RGB.shape[:2], value, np.float32)
    depth[0, 0] = np.inf
    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    OpenEXR.File(header, {"R": depth, "G": depth, "B": depth}).write(str(path))


def make(kind: str, folder: Path) -> None:
    """Two frames of each layout."""
    for number in (2, 10):
        match kind:
            case "rgbd":
                lens = {"params": [5.0, 5.0, 4.0, 3.0], "depth_unit_mm": 0.01}
                write_rgb(folder / f"rgb/{number:05d}.png")
                write_16(folder / f"depth/{number:05d}.png", 1234)
                (folder / "camera.json").write_text(json.dumps(lens))
            case "simcol3d":
                write_rgb(folder / f"FrameBuffer_{number:04d}.png")
                write_16(folder / f"Depth_{number:04d}.png", 256 * 255 // 2)
            case "c3vd":
                write_rgb(folder / f"{number}_color.png")  # not padded, as in cecum_t1_a
                write_16(folder / f"{number}_depth.tiff", 13107)
            case "c3vdv2":
                write_rgb(folder / f"rgb/{number:04d}.png")
                write_16(folder / f"depth/{number:04d}_depth.tiff", 13107)
            case "unitycam":
                write_rgb(folder / f"Frames/image_{number:04d}.png")
                write_rgb(folder / f"Pixelwise Depths/aov_image_{number:04d}.png")
            case "vrcaps":
                write_rgb(folder / f"rgb/{number:05d}.png")
                write_exr(folder / f"depth/{number:05d}.exr", 0.5)
            case "ccd":
                write_rgb(folder / f"images/{number:04d}.png")
                write_16(folder / f"depths/{number:04d}.png", 65535 // 5)
            case "ccd_flat":
                write_rgb(folder / f"T1_L1_{number}_FrameBuffer_{number:04d}.png")
                write_16(folder / f"T1_L1_{number}_Depth_{number:04d}.png", 65535 // 5)
            case "csd_cases":
                write_rgb(folder / f"rgb/{number:05d}.png")
                write_exr(folder / f"depth_gt/{number:05d}.exr", 7.0)
            case "csd":
                write_rgb(folder / f"SUK_L{number:05d}.png")
                write_exr(folder / f"SUK_L_depth{number:05d}.exr", 7.0)


EXPECTED = {
    "rgbd": (12.34, "mm"),
    "simcol3d": (100.0, "mm"),  # 65535 as the divisor would give 99.6
    "c3vd": (20.0, "mm"),
    "c3vdv2": (20.0, "mm"),
    "unitycam": (200 / 255, "scene"),  # never millimetres: the unit is not documented
    "vrcaps": (0.5, "scene"),
    "ccd": (40.0, "mm"),
    "ccd_flat": (40.0, "mm"),
    "csd": (35.0, "mm"),  # five millimetres a unit
    "csd_cases": (35.0, "mm"),
}


@pytest.mark.parametrize("kind", EXPECTED)
def test_companions_of_macos_are_no_frames(kind: str, tmp_path: Path) -> None:
    make(kind, tmp_path)
    for path in [path for path in tmp_path.rglob("*") if path.is_file()]:
        path.with_name(f"._{path.name}").write_bytes(b"\x00\x05\x16\x07")
    assert recognise(tmp_path) == kind
    assert len(list(read_evaluation_frames(tmp_path))) == 2


@pytest.mark.parametrize("kind", EXPECTED)
def test_each_layout_is_recognised_and_decoded(kind: str, tmp_path: Path) -> None:
    folder = tmp_path / "cecum_t1_a"
    make(kind, folder)
    assert recognise(folder) == kind
    frames = list(read_evaluation_frames(folder))
    value, unit = EXPECTED[kind]
    assert [int(frame.name.split("_")[-1]) for frame in frames] == [2, 10]
    for frame in frames:
        assert frame.unit == unit
        assert frame.depth.dtype == np.float32
        assert frame.depth[3, 3] == pytest.approx(value, rel=1e-4)
        np.testing.assert_array_equal(frame.rgb, RGB)
        assert np.isfinite(frame.depth).all()


def test_frames_of_c3vdv2_are_in_the_order_of_their_numbers(tmp_path: Path) -> None:
    """Padded or not: the k-th is held against the k-th pose."""
    for name in ("rgb", "depth"):
        (tmp_path / name).mkdir()
    for number in range(12):
        cv2.imwrite(str(tmp_path / f"rgb/{number}.png"), np.zeros((8, 8, 3), np.uint8))
        cv2.imwrite(str(tmp_path / f"depth/{number}_depth.tiff"), np.full((8, 8), 9, np.uint16))
    assert [int(frame.name) for frame in read_evaluation_frames(tmp_path, "c3vdv2")] == list(range(12))


@pytest.mark.parametrize("kind", ["c3vd", "c3vdv2"])
def test_c3vd_clamped_and_missing_depth_is_no_depth(kind: str, tmp_path: Path) -> None:
    make(kind, tmp_path)
    depth = next(iter(read_evaluation_frames(tmp_path))).depth
    assert depth[0, 0] == 0
    assert depth[0, 1] == 0  # 65535 says "100 mm or more"


@pytest.mark.parametrize(
    ("clip", "kind", "group"),
    [
        ("cecum_t1_a", "c3vd", "cecum"),
        ("trans_t4_b", "c3vd", "trans"),
        ("c1_sigmoid1_t2_v3", "c3vdv2", "c1_sigmoid1"),
        ("Frames_S12", "simcol3d", "S"),
        ("Frames_B3", "simcol3d", "B"),
    ],
)
def test_groups_name_meshes_so_that_splits_can_keep_them_apart(
    clip: str, kind: str, group: str, tmp_path: Path
) -> None:
    make(kind, tmp_path / clip)
    assert {frame.group for frame in read_evaluation_frames(tmp_path / clip)} == {group}


def test_wrong_folders_are_one_sentence(tmp_path: Path) -> None:
    with pytest.raises(CompletionError, match="looked for simcol3d"):
        list(read_evaluation_frames(tmp_path))
    with pytest.raises(CompletionError, match="no data set 'kitti'"):
        list(read_evaluation_frames(tmp_path, "kitti"))
    make("simcol3d", tmp_path)
    (tmp_path / "Depth_0010.png").unlink()
    with pytest.raises(CompletionError, match=r"Depth_0010\.png is missing"):
        list(read_evaluation_frames(tmp_path))
    write_rgb(tmp_path / "Depth_0010.png")
    with pytest.raises(CompletionError, match="no 16-bit depth image"):
        list(read_evaluation_frames(tmp_path))
    (tmp_path / "Depth_0010.png").write_bytes(b"")
    with pytest.raises(CompletionError, match="cannot read the image"):
        list(read_evaluation_frames(tmp_path))


@pytest.mark.parametrize("unit", ["0", "-1", "NaN", "1e400", "null", '"ten"', "1" + 400 * "0"])
def test_a_depth_unit_that_is_none_is_one_sentence(tmp_path: Path, unit: str) -> None:
    make("rgbd", tmp_path)
    (tmp_path / "camera.json").write_text(f'{{"depth_unit_mm": {unit}}}')
    with pytest.raises(CompletionError, match="depth_unit_mm"):
        list(read_evaluation_frames(tmp_path))


def test_a_camera_file_without_depth_unit_is_no_folder_of_depth(tmp_path: Path) -> None:
    (tmp_path / "camera.json").write_text("{}")
    with pytest.raises(CompletionError, match="depth_unit_mm"):
        list(read_evaluation_frames(tmp_path))


def test_a_sensor_s_depth_is_no_truth(tmp_path: Path) -> None:
    make("rgbd", tmp_path)
    (tmp_path / "camera.json").write_text('{"depth_unit_mm": 0.01, "depth": "sensor"}')
    with pytest.raises(CompletionError, match="which is no truth"):
        list(read_evaluation_frames(tmp_path))


def rgbd_folder(folder: Path, suffix: str = ".png", empty: tuple[int, ...] = ()) -> Path:
    """Four frames of 32 px; those in `empty` have no depth."""
    (folder / "rgb").mkdir(parents=True)
    (folder / "depth").mkdir()
    (folder / "camera.json").write_text('{"depth_unit_mm": 0.01}')
    for number in range(4):
        cv2.imwrite(str(folder / "rgb" / f"{number:05d}{suffix}"), np.full((32, 32, 3), 90, np.uint8))
        depth = np.full((32, 32), 0 if number in empty else 2000, np.uint16)
        cv2.imwrite(str(folder / "depth" / f"{number:05d}.png"), depth)
    return folder


@pytest.mark.parametrize("suffix", [".png", ".jpg", ".JPG", ".bmp"])
def test_pictures_of_an_rgbd_folder_may_be_of_any_usual_kind(tmp_path: Path, suffix: str) -> None:
    frames = list(read_evaluation_frames(rgbd_folder(tmp_path / "film", suffix)))
    assert [frame.name for frame in frames] == ["00000", "00001", "00002", "00003"]
    assert all((frame.depth == 20).all() for frame in frames)


def test_a_data_set_with_a_camera_file_is_what_its_frames_say(tmp_path: Path) -> None:
    (tmp_path / "camera.json").write_text('{"model": "PINHOLE"}')
    cv2.imwrite(str(tmp_path / "0_depth.tiff"), np.zeros((8, 8), np.uint16))
    assert recognise(tmp_path) == "c3vd"


def test_a_frame_without_true_depth_is_left_out_and_counted(tmp_path: Path) -> None:
    folder, left_out = rgbd_folder(tmp_path / "film", empty=(1, 2)), LeftOut()
    protocol = Protocol(points=10)
    frames = read_evaluation_frames(folder)
    results = list(evaluate_frames(frames, load_predictor("nearest"), protocol, left_out=left_out))
    assert [result.name for result in results] == ["00000", "00003"]
    assert left_out.without_truth == ["00001", "00002"]


def test_frames_of_which_none_has_points_are_refused(tmp_path: Path) -> None:
    folder, protocol = rgbd_folder(tmp_path / "film", empty=(1,)), Protocol(sampler="sfm")
    with pytest.raises(CompletionError, match=r"'sfm' finds no point with true depth in any of 3 frames .* uniform"):
        evaluate([folder], ["nearest"], [protocol], Outputs(), None, SilentProgress())
