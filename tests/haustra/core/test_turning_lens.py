"""Lens polynomials that turn back on themselves: where, how much of the picture that leaves, and who is told."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from haustra.core.camera import Camera
from haustra.core.errors import HaustraError
from pipeline.input.calibration import calibrate

CONTENT = (0, 0, 320, 320)


def fisheye(*terms: float) -> Camera:
    return Camera("OPENCV_FISHEYE", 320, 320, (160.0, 160.0, 160.0, 160.0, *terms))


def turning_at(degrees: float) -> Camera:
    """k1 alone: 1 + 3 k1 theta^2 = 0 where it turns."""
    return fisheye(-1 / (3 * np.radians(degrees) ** 2), 0, 0, 0)


@pytest.mark.parametrize("degrees", range(15, 90, 7))
def test_a_polynomial_turns_back_where_its_derivative_says(degrees: float) -> None:
    camera = turning_at(degrees)
    assert np.degrees(camera.lens.valid_angle(camera.distortion)) == pytest.approx(degrees, abs=0.1)
    radius = 160 * np.radians(degrees) * 2 / 3  # theta (1 - 1/3)
    y, x = np.mgrid[0.5:320, 0.5:320]
    beyond = (np.hypot(x - 160, y - 160) > radius).mean()
    assert camera.share_beyond_lens() == pytest.approx(beyond, abs=0.01)


@pytest.mark.parametrize("degrees", range(15, 75, 6))
def test_no_ray_is_given_for_a_pixel_beyond(degrees: float) -> None:
    """A ray past the turn has a pixel, but it is not that pixel's."""
    camera = turning_at(degrees)
    pixels = np.stack(np.meshgrid(np.arange(0.5, 320, 5), np.arange(0.5, 320, 5)), -1).reshape(-1, 2)
    plane, valid = camera.unproject(pixels)
    radius = np.hypot(*(pixels - 160).T)
    edge = 160 * np.radians(degrees) * 2 / 3
    assert valid[radius < edge - 2].all()
    assert not valid[radius > edge + 1].any()
    assert np.degrees(np.arctan(np.linalg.norm(plane[valid], axis=1))).max() <= degrees + 0.1


@pytest.mark.parametrize("terms", [(0, 0, 0, 0), (0.1, 0, 0, 0), (-0.02, 0.01, 0, 0), (0.05, -0.01, 0.002, 0)])
def test_one_that_grows_throughout_leaves_nothing(terms: tuple[float, ...]) -> None:
    assert fisheye(*terms).share_beyond_lens() == 0


def written(camera: Camera, folder: Path) -> str:
    (folder / "lens.json").write_text(json.dumps(camera.to_dict()))
    return str(folder / "lens.json")


def test_a_lens_of_nearly_none_of_the_picture_is_refused(tmp_path: Path) -> None:
    with pytest.raises(HaustraError, match=r"turns back 25 degrees off the axis, and 9\d % of the picture is beyond"):
        calibrate(written(turning_at(25), tmp_path), tmp_path, (320, 320), CONTENT)


def test_a_lens_that_leaves_the_corners_is_told(tmp_path: Path) -> None:
    found = calibrate(written(turning_at(80), tmp_path), tmp_path, (320, 320), CONTENT)
    assert "turns back 80 degrees off the axis" in found.origin
    assert "unused" in found.origin


def test_corners_outside_the_content_are_not_missed(tmp_path: Path) -> None:
    found = calibrate(written(turning_at(80), tmp_path), tmp_path, (320, 320), (80, 80, 160, 160))
    assert "turns back" not in found.origin
