"""MATLAB's `cameraParameters`, `cameraIntrinsics`, `fisheyeIntrinsics`, as `jsonencode(toStruct(params))` has them.

MATLAB counts pixels from (1, 1), the centre of the first one. `IntrinsicMatrix` is K transposed; `K` of later versions
is not. mathworks.com/help/vision/ref/cameraintrinsics.html, .../fisheyeintrinsics.html
"""

from typing import Any

import numpy as np

from haustra.core.errors import HaustraError
from haustra.core.lenses.scaramuzza import parameters_of
from pipeline.input.camera_files.calibrated_lens import HALF_PIXEL, CalibratedLens, array_of, from_matrix, whole_size
from pipeline.input.camera_files.document import CameraDocument

MATLAB_FIRST = 1.0  # the coordinate of the centre of the first pixel


def read_matlab(document: CameraDocument) -> CalibratedLens | None:
    fields = document.fields
    inner = fields.get("Intrinsics", fields)
    inner = inner if isinstance(inner, dict) else fields
    if "MappingCoefficients" in inner:
        return _fisheye(inner)
    if "RadialDistortion" not in inner and "IntrinsicMatrix" not in inner and "FocalLength" not in inner:
        return None
    matrix = _matrix(inner)
    matrix[:2, 2] -= MATLAB_FIRST
    radial = array_of(inner.get("RadialDistortion", [])).ravel().tolist()
    tangential = array_of(inner.get("TangentialDistortion", [0, 0])).ravel().tolist()
    k1, k2, k3 = (radial + [0.0] * 3)[:3]
    return from_matrix(matrix, [k1, k2, *tangential, k3], _size(inner))


def _matrix(fields: dict[str, Any]) -> Any:
    """K (3,3), still in MATLAB's pixels."""
    if "K" in fields:
        return array_of(fields["K"])
    if "IntrinsicMatrix" in fields:
        return array_of(fields["IntrinsicMatrix"]).T.copy()
    if not {"FocalLength", "PrincipalPoint"} <= fields.keys():
        raise HaustraError("it lacks K, IntrinsicMatrix, and FocalLength with PrincipalPoint")
    (fx, fy), (cx, cy) = fields["FocalLength"], fields["PrincipalPoint"]
    return np.array([[fx, float(fields.get("Skew", 0)), cx], [0, fy, cy], [0, 0, 1.0]])


def _fisheye(fields: dict[str, Any]) -> CalibratedLens:
    a0, a2, a3, a4 = (float(value) for value in fields["MappingCoefficients"])
    cx, cy = (float(value) - MATLAB_FIRST + HALF_PIXEL for value in fields["DistortionCenter"])
    (c, d), (e, one) = array_of(fields.get("StretchMatrix", [[1, 0], [0, 1]])).tolist()
    if one != 1:
        raise HaustraError(f"the last number of its StretchMatrix must be 1, not {one:g}")
    return CalibratedLens("SCARAMUZZA", parameters_of(a0, a2, a3, a4, (cx, cy), (c, d, e)), _size(fields))


def _size(fields: dict[str, Any]) -> tuple[int, int] | None:
    """MATLAB says rows, then columns."""
    if not fields.get("ImageSize"):
        return None
    rows, columns = fields["ImageSize"]
    return whole_size(columns, rows)
