"""nerfstudio's and instant-ngp's `transforms.json`; pixels count from the corner of the first one, as COLMAP's.

docs.nerf.studio/quickstart/data_conventions.html
"""

import math
from typing import Any

from haustra.core.errors import HaustraError
from pipeline.input.camera_files.calibrated_lens import CalibratedLens, size_of
from pipeline.input.camera_files.document import CameraDocument

LENS = ("fl_x", "fl_y", "cx", "cy", "w", "h", "k1", "k2", "k3", "k4", "p1", "p2", "camera_model")


def read_transforms(document: CameraDocument) -> CalibratedLens | None:
    fields = document.fields
    if not {"frames", "fl_x", "camera_angle_x"} & fields.keys():
        return None
    return lens_of(_shared(fields))


def _shared(fields: dict[str, Any]) -> dict[str, Any]:
    """The lens of all frames, which may give it each for itself."""
    frames = [frame for frame in fields.get("frames", []) if isinstance(frame, dict)]
    own = [{name: frame[name] for name in LENS if name in frame} for frame in frames]
    if any(lens != own[0] for lens in own):
        raise HaustraError("its frames have lenses of their own, which differ; one lens is needed")
    return fields | (own[0] if own else {})


def lens_of(fields: dict[str, Any]) -> CalibratedLens:
    """Lens from fl_x or camera_angle_x and what else there is."""
    size = size_of(fields, "w", "h")
    if "fl_x" in fields:
        fx = float(fields["fl_x"])
    elif size is not None and "camera_angle_x" in fields:
        fx = 0.5 * size[0] / math.tan(0.5 * float(fields["camera_angle_x"]))
    else:
        raise HaustraError("it lacks fl_x, and camera_angle_x with w and h")
    if size is None and not {"cx", "cy"} <= fields.keys():
        raise HaustraError("it lacks cx and cy, and w and h")
    width, height = size or (0, 0)
    pinhole = (
        fx,
        float(fields.get("fl_y", fx)),
        float(fields.get("cx", width / 2)),
        float(fields.get("cy", height / 2)),
    )
    k1, k2, k3, k4, p1, p2 = (float(fields.get(name, 0)) for name in ("k1", "k2", "k3", "k4", "p1", "p2"))
    model = str(fields.get("camera_model", "OPENCV_FISHEYE" if fields.get("is_fisheye") else "OPENCV")).upper()
    if model in ("OPENCV_FISHEYE", "FISHEYE"):
        return CalibratedLens("OPENCV_FISHEYE", (*pinhole, k1, k2, k3, k4), size)
    if model not in ("OPENCV", "PINHOLE", "SIMPLE_PINHOLE", "PERSPECTIVE"):
        raise HaustraError(f"its camera_model {model} is none that haustra has")
    if k4:
        raise HaustraError("its lens has a fourth radial term k4, which no lens model here has")
    if k3:
        return CalibratedLens("FULL_OPENCV", (*pinhole, k1, k2, p1, p2, k3, 0.0, 0.0, 0.0), size)
    if any((k1, k2, p1, p2)):
        return CalibratedLens("OPENCV", (*pinhole, k1, k2, p1, p2), size)
    return CalibratedLens("PINHOLE", pinhole, size)
