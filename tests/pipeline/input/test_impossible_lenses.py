"""Numbers of camera files that no camera has are told before any work; those of odd cameras are taken."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from haustra.core.camera import Camera
from haustra.core.errors import HaustraError
from pipeline.input.calibration import calibrate, check_choice
from pipeline.input.stereo.rectified_pair import rectify
from pipeline.input.stereo.rig_file import StereoRig

SIZE = 160
WHOLE = (0, 0, SIZE, SIZE)


def written(folder: Path, model: str, *params: float) -> str:
    fields = {"model": model, "width": SIZE, "height": SIZE, "params": params}
    (folder / "lens.json").write_text(json.dumps(fields))
    return str(folder / "lens.json")


@pytest.mark.parametrize(
    ("model", "params", "told"),
    [
        ("PINHOLE", (80, 80, 400, 80), r"its centre \(400, 80\) lies far outside its picture of 160x160 pixels"),
        ("PINHOLE", (80, 80, 80, -170), r"its centre \(80, -170\) lies far outside"),
        ("PINHOLE", (8000, 8000, 80, 80), "focal length, 8000 px, and its distortion it sees 1.1 degrees across"),
        ("OPENCV", (80, 80, 80, 80, 1e6, -1e9, 0, 0), "it sees 1.2 degrees across 160x160 pixels"),
        ("OPENCV", (80, 80, 80, 80, 0, 0, 3, 3), "p1 = 3 and p2 = 3, fold the picture onto itself: .* 75 % of it"),
        ("PINHOLE", (80, 240, 80, 80), "focal lengths, 80 and 240 px, differ by a factor of 3, and"),
        ("PINHOLE", (80, 8000, 80, 80), "differ by a factor of 100, and"),
    ],
)
def test_an_impossible_lens_is_told_before_any_work(tmp_path: Path, model: str, params: tuple, told: str) -> None:
    with pytest.raises(HaustraError, match=told) as refusal:
        check_choice(written(tmp_path, model, *params), tmp_path / "film.mp4")
    assert str(tmp_path / "lens.json") in str(refusal.value)


def test_a_lens_without_a_size_is_told_once_the_picture_has_one(tmp_path: Path) -> None:
    (tmp_path / "k.txt").write_text("80 0 80\n0 200 80\n0 0 1\n")
    with pytest.raises(HaustraError, match=r"differ by a factor of 2\.5"):
        calibrate(str(tmp_path / "k.txt"), tmp_path, (SIZE, SIZE), WHOLE)


@pytest.mark.parametrize(
    ("model", "params"),
    [
        ("PINHOLE", (300, 300, 80, 80)),  # a laparoscope of 30 degrees
        ("PINHOLE", (1500, 1500, 80, 80)),  # an exoscope of 6
        ("OPENCV_FISHEYE", (54, 54, 80, 80, 0, 0, 0, 0)),  # a capsule of 170
        ("PINHOLE", (80, 116, 80, 80)),  # DV as stored
        ("PINHOLE", (80, 160, 80, 80)),  # one eye of two side by side
        ("PINHOLE", (80, 80, 30, 130)),  # a crop
        ("PINHOLE", (80, 80, -39, 80)),  # one beside the axis
        ("OPENCV", (100, 100, 80, 80, -0.2, 0.05, 0.02, -0.02)),
        ("OPENCV", (80, 80, 80, 80, 5, 20, 0, 0)),
    ],
)
def test_odd_lenses_are_taken(tmp_path: Path, model: str, params: tuple) -> None:
    path = written(tmp_path, model, *params)
    check_choice(path, tmp_path / "film.mp4")
    assert calibrate(path, tmp_path, (SIZE, SIZE), WHOLE).camera == Camera(model, SIZE, SIZE, params)


@pytest.mark.parametrize(("fy", "cx", "told"), [(160, 79.5, ""), (80, 400, "far outside"), (8000, 79.5, "factor of")])
def test_an_eye_of_a_stereo_rig(fy: float, cx: float, told: str) -> None:
    """Films of two eyes may keep each at half its width."""
    k = np.array([[80.0, 0, 79.5], [0, fy, 79.5], [0, 0, 1]])
    second = k.copy()
    second[0, 2] = cx
    rig = StereoRig(k, np.zeros(5), second, np.zeros(5), np.eye(3), np.array([-4.0, 0, 0]), (SIZE, SIZE))
    if told:
        with pytest.raises(
            HaustraError, match=f"the stereo calibration's (first|second) camera is impossible: .*{told}"
        ):
            rectify(rig, (SIZE, SIZE))
    else:
        rectify(rig, (SIZE, SIZE))
