"""What every reader gives: a lens with its centre counted as COLMAP does, and the size that it was calibrated at."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from haustra.core.camera import whole_number
from haustra.core.errors import HaustraError

HALF_PIXEL = 0.5  # OpenCV counts from the centre of the first pixel, COLMAP from its corner
LEAST_FOCAL_PX = 10
MOST_SKEW = 1e-3  # of the focal length; no lens model here has skew

Size = tuple[int, int]


@dataclass(frozen=True)
class CalibratedLens:
    """model and params: as `Camera` has them. size: width and height of the calibration's pictures; None where the file
    does not say. note: what a user should know of how the file was read."""

    model: str
    params: tuple[float, ...]
    size: Size | None
    note: str = ""
    trusted: bool = True


def from_matrix(
    matrix: Any, distortion: Sequence[float], size: Size | None, fisheye: bool = False, note: str = ""
) -> CalibratedLens:
    """From K (3,3) and distortion as OpenCV orders it: k1 k2 p1 p2 [k3 [k4 k5 k6]], or a fisheye's k1 k2 k3 k4."""
    k = np.asarray(matrix, np.float64)
    if k.shape != (3, 3):
        raise HaustraError(f"its camera matrix must be 3x3, not {'x'.join(map(str, k.shape))}")
    if k[0, 2] == k[1, 2] == 0 and (k[2, :2] > 0).all():  # by columns, as MATLAB and Open3D store it
        k = k.T
    if not np.allclose([*k[2], k[1, 0]], [0, 0, 1, 0]):
        raise HaustraError("its camera matrix is none: it must be fx 0 cx, 0 fy cy, 0 0 1, by rows")
    if abs(k[0, 1]) > MOST_SKEW * abs(k[0, 0]):
        raise HaustraError(f"its camera matrix has a skew of {k[0, 1]:g} px, which no lens model here has")
    return from_opencv(k[0, 0], k[1, 1], k[0, 2], k[1, 2], distortion, size, fisheye, note)


def from_opencv(
    fx: float,
    fy: float,
    cx: float,
    cy: float,
    distortion: Sequence[float],
    size: Size | None,
    fisheye: bool = False,
    note: str = "",
) -> CalibratedLens:
    """The same from single numbers, in OpenCV's pixels."""
    if max(fx, fy) < LEAST_FOCAL_PX and 0 < cx <= 1 and 0 < cy <= 1:
        raise HaustraError(
            f"its focal length {fx:g} and centre ({cx:g}, {cy:g}) are shares of the picture's size; multiply them by it"
        )
    pinhole = (float(fx), float(fy), float(cx) + HALF_PIXEL, float(cy) + HALF_PIXEL)
    terms = [float(value) for value in distortion]
    if fisheye:
        if len(terms) != 4:
            raise HaustraError(f"a fisheye has four distortion terms, k1 to k4, not {len(terms)}")
        return CalibratedLens("OPENCV_FISHEYE", (*pinhole, *terms), size, note)
    if len(terms) not in (0, 2, 4, 5, 8) and any(terms[8:]):
        raise HaustraError(
            f"it has {len(terms)} distortion terms, thin prism and tilt among them, which no lens model here has"
        )
    if len(terms) not in (0, 2, 4, 5, 8, 12, 14):
        raise HaustraError(f"OpenCV has no lens of {len(terms)} distortion terms")
    terms = (terms + [0.0] * 8)[:8]
    if any(terms[4:]):
        return CalibratedLens("FULL_OPENCV", (*pinhole, *terms), size, note)
    if any(terms):
        return CalibratedLens("OPENCV", (*pinhole, *terms[:4]), size, note)
    return CalibratedLens("PINHOLE", pinhole, size, note)


def size_of(fields: dict[str, Any], width: str, height: str) -> Size | None:
    """The size under two names; None where either is missing."""
    if width not in fields or height not in fields:
        return None
    return whole_size(fields[width], fields[height])


def whole_size(width: Any, height: Any) -> Size:
    """Of two values as a file has them. HaustraError where one is no whole number of pixels."""
    return whole_number(width, "its width"), whole_number(height, "its height")


def array_of(values: Any) -> NDArray[np.float64]:
    """Numbers of any nesting as an array."""
    return np.asarray(values, np.float64)
