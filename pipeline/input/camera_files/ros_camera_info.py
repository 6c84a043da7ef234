"""ROS: the YAML of `camera_calibration`, and a printed `sensor_msgs/CameraInfo` (ROS 1: D K, ROS 2: d k)."""

from dataclasses import replace
from typing import Any

from haustra.core.errors import HaustraError
from pipeline.input.camera_files.calibrated_lens import CalibratedLens, array_of, from_matrix, whole_size
from pipeline.input.camera_files.document import CameraDocument

BROWN = ("plumb_bob", "rational_polynomial")
FISHEYE = ("equidistant", "fisheye")


def read_camera_info(document: CameraDocument) -> CalibratedLens | None:
    fields = document.fields
    if "distortion_model" not in fields:
        return None
    model = str(fields["distortion_model"])
    if model not in (*BROWN, *FISHEYE):
        raise HaustraError(f"its distortion_model {model!r} is none of {', '.join((*BROWN, *FISHEYE))}")
    matrix, terms = _first(fields, "camera_matrix", "K", "k"), _first(fields, "distortion_coefficients", "D", "d")
    size = whole_size(_first(fields, "image_width", "width"), _first(fields, "image_height", "height"))
    lens = from_matrix(_data(matrix).reshape(3, 3), _data(terms).ravel().tolist(), size, model in FISHEYE)
    return _of_part(lens, fields.get("roi") or {})


def _of_part(lens: CalibratedLens, roi: dict[str, Any]) -> CalibratedLens:
    """K is of the whole sensor's picture; where `roi` is a part of it, the pictures are that part alone."""
    left, top, *size = (int(roi.get(name, 0)) for name in ("x_offset", "y_offset", "width", "height"))
    if not all(size) or (size[0], size[1]) == lens.size:
        return lens
    fx, fy, cx, cy, *terms = lens.params
    note = f"the part of {size[0]}x{size[1]} pixels at ({left}, {top})"
    return replace(lens, params=(fx, fy, cx - left, cy - top, *terms), size=(size[0], size[1]), note=note)


def _first(fields: dict[str, Any], *names: str) -> Any:
    for name in names:
        if name in fields:
            return fields[name]
    raise HaustraError(f"it lacks {names[0]}")


def _data(value: Any) -> Any:
    return array_of(value["data"] if isinstance(value, dict) else value)
