"""A camera matrix and distortion by name: OpenCV's YAML and XML, and JSON or YAML of Python programs.

Names differ from program to program by case and underscores: camera_matrix, Camera_Matrix, cameraMatrix, K. A stereo
rig (M1 D1 M2 D2, as SCARED has them) gives its first camera.
"""

import re
from typing import Any

import numpy as np

from haustra.core.errors import HaustraError
from pipeline.input.camera_files.calibrated_lens import CalibratedLens, from_matrix, whole_size
from pipeline.input.camera_files.document import CameraDocument

MATRICES = ("cameramatrix", "k", "intrinsicmatrix", "mtx", "m1", "k1", "cameramatrixleft", "cameramatrix1")
TERMS = (
    "distortioncoefficients",
    "distcoeffs",
    "distcoeff",
    "distcoefs",
    "distortioncoeffs",
    "distortioncoefs",
    "distortion",
    "dist",
    "d",
    "d1",
    "distortioncoefficientsleft",
    "distcoeffs1",
)
WIDTHS, HEIGHTS, SIZES = ("imagewidth", "width", "w"), ("imageheight", "height", "h"), ("imagesize", "size", "dim")
AREAS = ("full", "roi")  # x, y, width, height
MODELS = ("distortionmodel", "cameramodel", "model", "type")
FLAGS = ("fisheyemodel", "fisheye", "isfisheye")
FISHEYE = ("fisheye", "equidistant", "kannala")
MOST_TANGENTIAL = 0.05  # p1 or p2 of a plane lens; of nine real endoscopes, the largest is 0.014


def read_matrix_file(document: CameraDocument) -> CalibratedLens | None:
    fields = {re.sub(r"[_\W]", "", name).lower(): value for name, value in document.fields.items()}
    matrix = next((fields[name] for name in MATRICES if name in fields and _is_matrix(fields[name])), None)
    if matrix is None:
        return None
    found = next((fields[name] for name in TERMS if name in fields), None)
    if found is None:
        raise HaustraError("it has a camera matrix but no distortion coefficients; write zeros if there is none")
    said = " ".join(str(fields.get(name, "")) for name in MODELS).strip().lower()
    fisheye = any(word in said for word in FISHEYE) or any(fields.get(name) in (True, 1) for name in FLAGS)
    terms = _numbers(found).ravel().tolist()
    notes = ["the first camera of the rig"] if {"m2", "k2", "d2"} & fields.keys() else []
    if len(terms) == 4 and not said and not any(name in fields for name in FLAGS):
        notes.append(_unnamed_model(terms))
    return from_matrix(_numbers(matrix).reshape(3, 3), terms, _size(fields), fisheye, "; ".join(notes))


def _unnamed_model(terms: list[float]) -> str:
    """What to say of four terms without a model's name, which cv2.fisheye and older plane calibrations both write.

    Raises `HaustraError` where the last two are no tangential terms that a lens has.
    """
    largest = max(map(abs, terms[2:]))
    if largest > MOST_TANGENTIAL:
        raise HaustraError(
            f"it has four distortion terms and names no lens model; as tangential terms {largest:.3g} is more than a "
            'lens has, so they seem to be of cv2.fisheye: let the file say that "model" is "fisheye", or "opencv"'
        )
    return 'four terms read as k1 k2 p1 p2; of cv2.fisheye, let the file say that "model" is "fisheye"'


def _is_matrix(value: Any) -> bool:
    try:
        return _numbers(value).size == 9
    except (TypeError, ValueError):
        return False


def _numbers(value: Any) -> Any:
    """Of an array, nested lists, `{data: [...]}`, or NumPy's printed form."""
    if isinstance(value, dict):
        value = value["data"]
    if isinstance(value, str):
        value = re.findall(r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?", value)
    return np.asarray(value, np.float64)


def _size(fields: dict[str, Any]) -> tuple[int, int] | None:
    for width, height in zip(WIDTHS, HEIGHTS, strict=True):
        if width in fields and height in fields:
            return whole_size(fields[width], fields[height])
    for name in SIZES:
        if name in fields and _numbers(fields[name]).size == 2:
            width, height = _numbers(fields[name]).ravel()
            return whole_size(width, height)
    for name in AREAS:
        if name in fields and _numbers(fields[name]).size == 4:
            x, y, width, height = _numbers(fields[name]).ravel()
            return whole_size(width, height) if x == y == 0 else None
    return None
