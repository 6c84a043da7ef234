"""Camera files as they lie in public repositories: rays against OpenCV's, of numbers found by patterns of this test."""

import json
import re

import numpy as np
import pytest

from haustra.core.camera import Camera
from haustra.core.errors import HaustraError
from pipeline.input.camera_files.registry import read_lens
from pipeline.input.camera_presets import PRESETS
from tests.helpers.camera_files import fisheye_pixels, opencv_pixels, ray_error
from tests.helpers.real_data import shared

MOST = 1e-6  # rad
DEFAULT_SIZE = (1920, 1080)  # of files that name none; rays do not depend on it
NUMBER = r"[-+]?\d*\.?\d+(?:[eE][-+]?\d+)?"


def by_name(text, *names):
    """Values of lines `Camera.NAME: value` or `NAME: value`, 0 where there is none."""
    found = {name: re.search(rf"^\s*\"?(?:Camera1?\.)?{name}\"?:\s*({NUMBER})", text, re.M) for name in names}
    return [float(match.group(1)) if match else 0.0 for match in found.values()]


def matrix(fx, fy, cx, cy):
    return np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]])


def of_settings(text):
    k = matrix(*by_name(text, "fx", "fy", "cx", "cy"))
    if "KannalaBrandt8" in text or "k4:" in text:
        first = 0 if "Camera.k0" in text else 1
        return k, by_name(text, *(f"k{first + n}" for n in range(4))), True
    return k, by_name(text, "k1", "k2", "p1", "p2", "k3"), False


def of_numbers(text, beside=""):
    numbers = [float(word) for word in re.findall(NUMBER, text)]
    terms = numbers[9:] or [float(word) for word in re.findall(NUMBER, beside)]
    return np.array(numbers[:9]).reshape(3, 3), terms, False


def of_xml(text):
    data = [re.findall(NUMBER, found) for found in re.findall(r"<data>(.*?)</data>", text, re.S)[:2]]
    return np.array(data[0], float).reshape(3, 3), [float(word) for word in data[1]], False


def of_printed(text):
    text = text.replace("\\n", " ").replace("\\", " ")
    parts = [re.search(rf"{name}: ['\"](.*?)['\"]", text, re.S).group(1) for name in ("camera_matrix", "dist_coeffs")]
    k, terms = (np.array(re.findall(NUMBER, part), float) for part in parts)
    return k.reshape(3, 3), terms.tolist(), False


def of_json(text):
    values = json.loads(text)
    return np.array(values["camera_matrix"]), values["dist_coeff"][0], False


def cases(folder):
    """(file, K in OpenCV's pixels, terms, whether they are a fisheye's)."""
    for path in sorted([*folder.glob("*slam*/*.yaml"), *folder.glob("*slam3*/*.yaml")]):
        if path.parent.name != "gradslam":
            yield path, *of_settings(path.read_text())
    path = folder / "gradslam" / "endogslam_c3vd.yaml"
    yield path, matrix(*by_name(path.read_text(), "fx", "fy", "cx", "cy")), [], False
    for path in sorted(folder.glob("scikit-surgery/**/*.intrinsics.txt")):
        beside = path.with_name(path.name.replace("intrinsics", "distortion"))
        yield path, *of_numbers(path.read_text(), beside.read_text() if beside.exists() else "")
    for path in sorted(folder.glob("cam_txt/UnityCam*")):
        yield path, *of_numbers(path.read_text())
    for pattern, read in (("**/*.xml", of_xml), ("**/*.yml", of_printed), ("open3d*/*.json", of_json)):
        for path in sorted(folder.glob(pattern)):
            yield path, *read(path.read_text())


def rays_within(k, terms, fisheye):
    """Rays (N,3) to 50 degrees, as far as the lens's radius still grows with the angle."""
    theta = np.radians(np.arange(0.5, 50, 0.5))
    k1, k2, k3 = ([*terms, 0, 0, 0, 0, 0][n] for n in (0, 1, 4))
    t = np.tan(theta)
    growing = np.gradient(t * (1 + k1 * t**2 + k2 * t**4 + k3 * t**6), t) > 0.15
    end = len(theta) if fisheye or growing.all() else int(np.argmin(growing))
    angle, turn = np.meshgrid(theta[: max(1, int(0.8 * end))], np.radians(np.arange(0, 360, 20)))
    angle, turn = angle.ravel(), turn.ravel()
    return np.column_stack([np.sin(angle) * np.cos(turn), np.sin(angle) * np.sin(turn), np.cos(angle)])


def test_rays_of_real_files():
    checked = []
    for path, k, terms, fisheye in cases(shared("calibrations")):
        _, lens = read_lens(path)
        camera = Camera(lens.model, *(lens.size or DEFAULT_SIZE), lens.params)
        rays = rays_within(k, terms, fisheye)
        pixels = (fisheye_pixels if fisheye else opencv_pixels)(rays, k, tuple(terms))
        seen = ((pixels > 0) & (pixels < 2 * k[:2, 2])).all(axis=1)  # beyond the picture a polynomial may be anything
        assert seen.sum() > 50, path
        assert ray_error(camera, pixels[seen], rays[seen]) < MOST, path
        checked.append(path)
    assert len(checked) >= 25


def test_one_lens_of_c3vd_in_two_models():
    """Its own polynomial and REIM-NeRF's fisheye agree to 0.15 degrees within 50 of the axis and 0.52 within 60."""
    folder = shared("calibrations")
    lenses = [
        read_lens(folder / name)[1] for name in ("cam_txt/C3VD_ocamcalib_cam.txt", "c3vd_calib_FISHEYE_OPENCV.json")
    ]
    polynomial, fisheye = (Camera(lens.model, *lens.size, lens.params) for lens in lenses)
    assert polynomial.params == pytest.approx(PRESETS["c3vd"].camera.params, rel=1e-6)
    pixels = np.stack(np.meshgrid(np.arange(0, 1351, 27.0), np.arange(0, 1081, 27.0)), axis=-1).reshape(-1, 2)
    first, second = (
        np.column_stack([camera.unproject(pixels)[0], np.ones(len(pixels))]) for camera in (polynomial, fisheye)
    )
    first, second = (rays / np.linalg.norm(rays, axis=1, keepdims=True) for rays in (first, second))
    apart = np.degrees(np.linalg.norm(np.cross(first, second), axis=1))
    off_axis = np.degrees(np.arccos(first[:, 2]))
    assert apart[off_axis < 50].max() < 0.15
    assert 0.3 < apart[off_axis < 60].max() < 0.52


def test_real_files_that_are_no_calibration():
    folder = shared("calibrations")
    with pytest.raises(HaustraError, match="no camera file that is known"):
        read_lens(folder / "vslamlab_dataset_hamlyn.yaml")
    with pytest.raises(HaustraError, match="distortion terms alone"):
        read_lens(folder / "scikit-surgery/cbh-viking/calib.left.distortion.txt")


def test_presets_of_the_endomapper_scopes():
    """One of them is published as ORB-SLAM3's settings too; all are in the table of this checkout's neighbour."""
    _, settings = read_lens(shared("calibrations") / "orbslam3_endomapper/Endomapper_endoscope_03_full_video.yaml")
    assert settings.params == PRESETS["endomapper-03"].camera.params
    scopes = json.loads((shared("calibrations").parent / "endomapper_scopes.json").read_text())["scopes"]
    assert len(scopes) == 18
    for scope in scopes:
        fx, fy, cx, cy, *terms = scope["params"]
        assert PRESETS[f"endomapper-{scope['endoscope']:02d}"].camera.params == (fx, fy, cx + 0.5, cy + 0.5, *terms)
