"""Kalibr's camchain: `cam0:` with camera_model, distortion_model, intrinsics, distortion_coeffs, resolution.

github.com/ethz-asl/kalibr/wiki/yaml-formats
"""

from haustra.core.errors import HaustraError
from pipeline.input.camera_files.calibrated_lens import CalibratedLens, from_opencv, whole_size
from pipeline.input.camera_files.document import CameraDocument


def read_kalibr(document: CameraDocument) -> CalibratedLens | None:
    cameras = [name for name in document.fields if str(name).startswith("cam") and str(name)[3:].isdigit()]
    if not cameras:
        return None
    first = min(cameras, key=lambda name: int(name[3:]))
    values = document.fields[first]
    model, distortion = str(values["camera_model"]), str(values.get("distortion_model", "none"))
    if model != "pinhole" or distortion not in ("radtan", "equidistant", "none"):
        raise HaustraError(f"its {first} is {model}-{distortion}; pinhole-radtan, -equidistant and -none can be read")
    fx, fy, cx, cy = values["intrinsics"]
    width, height = values["resolution"]
    terms = [] if distortion == "none" else list(values["distortion_coeffs"])
    note = f"{first} of {len(cameras)} cameras" if len(cameras) > 1 else ""
    return from_opencv(fx, fy, cx, cy, terms, whole_size(width, height), distortion == "equidistant", note)
