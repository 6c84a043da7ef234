"""Lenses of the 18 colonoscopes of the EndoMapper data set (Azagra et al., Scientific Data 2023), at 1440x1080.

fx fy cx cy k1 k2 k3 k4 of Kannala and Brandt, from the data set's `Endoscope_XX_geometrical.xml`. The files do not say
from where their pixels count; ORB-SLAM3's authors' settings for them use OpenCV's convention. The numbers, with each
lamp's, are in haustra/core/endomapper_scopes.json, which the phantom films through too.
"""

import json
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

import haustra.core.errors
from haustra.core.camera import Camera

SIZE = (1440, 1080)
HALF_PIXEL = 0.5
TABLE = json.loads(Path(haustra.core.errors.__file__).with_name("endomapper_scopes.json").read_text())
LENSES: dict[int, tuple[float, ...]] = {row["endoscope"]: tuple(row["params"]) for row in TABLE["scopes"]}


def endomapper_camera(number: int) -> Camera:
    """The lens of one colonoscope."""
    return _camera(LENSES[number])


def mean_colonoscope() -> Camera:
    """The lens whose radius at each angle is the mean of all: terms weigh by their focal length. Not trusted: each
    colonoscope is its own, and the lens is refined."""
    lenses = np.array(list(LENSES.values()))
    mean = lenses.mean(axis=0)
    focal = np.sqrt(lenses[:, 0] * lenses[:, 1])
    terms = (focal[:, None] * lenses[:, 4:]).mean(axis=0) / focal.mean()
    return replace(_camera([*mean[:4], *terms]), trusted=False)


def colonoscope_across(width: int, height: int, content: tuple[int, int, int, int]) -> Camera:
    """The mean colonoscope's lens for frames of another size, whose content's longer side is that of its picture."""
    x, y, content_width, content_height = content
    mean, scale = mean_colonoscope(), max(content_width, content_height) / SIZE[0]
    fx, fy = mean.focal
    centre = x + content_width / 2, y + content_height / 2
    return Camera(mean.model, width, height, (scale * fx, scale * fy, *centre, *mean.distortion), trusted=False)


def _camera(lens: Sequence[float]) -> Camera:
    fx, fy, cx, cy, *terms = (float(value) for value in lens)
    return Camera("OPENCV_FISHEYE", *SIZE, (fx, fy, cx + HALF_PIXEL, cy + HALF_PIXEL, *terms))
