"""`camera.json` of this project, and REIM-NeRF's flat JSON: model FISHEYE_OPENCV, fx fy cx cy k1..k4, w, h.

REIM-NeRF does not say from where its pixels count. Its lens of C3VD has its centre 0.01 and 0.17 px from that of C3VD's
own calibration where both count from the corner of the first pixel, and half a pixel more otherwise.
"""

from haustra.core.camera import read_camera
from haustra.core.errors import HaustraError
from pipeline.input.camera_files.calibrated_lens import CalibratedLens, size_of
from pipeline.input.camera_files.document import CameraDocument


def read_camera_json(document: CameraDocument) -> CalibratedLens | None:
    fields = document.fields
    if "fl_x" in fields or not ({"params", "trusted"} & fields.keys() or "model" in fields):
        return None
    if document.path.suffix.lower() != ".json":
        return None
    if "fx" in fields and "params" not in fields:
        return _flat(document)
    camera = read_camera(document.path)
    return CalibratedLens(camera.model, camera.params, (camera.width, camera.height), trusted=camera.trusted)


def _flat(document: CameraDocument) -> CalibratedLens:
    fields = document.fields
    if str(fields["model"]).upper() not in ("FISHEYE_OPENCV", "OPENCV_FISHEYE"):
        raise HaustraError(f"its model {fields['model']} is none that a file with fx, fy, cx, cy and k1 has here")
    names = ("fx", "fy", "cx", "cy", "k1", "k2", "k3", "k4")
    return CalibratedLens("OPENCV_FISHEYE", tuple(float(fields[name]) for name in names), size_of(fields, "w", "h"))
