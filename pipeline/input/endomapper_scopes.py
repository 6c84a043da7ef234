"""Lenses of the 18 colonoscopes of the EndoMapper data set (Azagra et al., Scientific Data 2023), at 1440x1080.

fx fy cx cy k1 k2 k3 k4 of Kannala and Brandt, from the data set's `Endoscope_XX_geometrical.xml`. The files do not say
from where their pixels count; ORB-SLAM3's authors' settings for them use OpenCV's convention. The numbers, with each
lamp's, are in haustra/core/endomapper_scopes.json, which the phantom films through too.
"""

import json
from collections.abc import Sequence
from pathlib import Path

import numpy as np

import haustra.core.errors
from haustra.core.camera import Camera

SIZE = (1440, 1080)
HALF_PIXEL = 0.5
# One focal length and one term, which follow the radius of each of the 18 to 3 px of 1440 (RMS) as far as the picture's
# corners. Pixels are square, and a film hardly tells four terms apart.
MEAN_MODEL = "SIMPLE_RADIAL_FISHEYE"
FIT_TO, FIT_STEPS = 1.3, 1000  # rad off the axis
TABLE = json.loads(Path(haustra.core.errors.__file__).with_name("endomapper_scopes.json").read_text())
LENSES: dict[int, tuple[float, ...]] = {row["endoscope"]: tuple(row["params"]) for row in TABLE["scopes"]}


def endomapper_camera(number: int) -> Camera:
    """The lens of one colonoscope."""
    return _camera(LENSES[number])


def mean_colonoscope() -> Camera:
    """The lens of square pixels and one radial term whose radius at each angle is nearest to the mean of all. Not
    trusted: each colonoscope is its own, and the lens is refined."""
    scopes = [endomapper_camera(number) for number in LENSES]
    theta = np.linspace(0.0, FIT_TO, FIT_STEPS)
    ahead = np.stack([np.sin(theta), np.zeros_like(theta), np.cos(theta)], axis=1)
    radius = np.mean([one.focal_px * one.lens.distort(ahead, one.distortion)[:, 0] for one in scopes], axis=0)
    weight = np.sqrt(radius)  # a ring of the picture has as many pixels as its radius
    powers = weight[:, None] * np.stack([theta, theta**3], axis=1)
    linear, cubic = np.linalg.lstsq(powers, weight * radius, rcond=None)[0]
    cx, cy = np.mean([one.centre for one in scopes], axis=0)
    return Camera(MEAN_MODEL, *SIZE, (float(linear), float(cx), float(cy), float(cubic / linear)), trusted=False)


def colonoscope_across(width: int, height: int, content: tuple[int, int, int, int]) -> Camera:
    """The mean colonoscope's lens for frames of another size, whose content's longer side is that of its picture."""
    x, y, content_width, content_height = content
    mean, scale = mean_colonoscope(), max(content_width, content_height) / SIZE[0]
    centre = x + content_width / 2, y + content_height / 2
    return Camera(mean.model, width, height, (scale * mean.focal[0], *centre, *mean.distortion), trusted=False)


def _camera(lens: Sequence[float]) -> Camera:
    fx, fy, cx, cy, *terms = (float(value) for value in lens)
    return Camera("OPENCV_FISHEYE", *SIZE, (fx, fy, cx + HALF_PIXEL, cy + HALF_PIXEL, *terms))
