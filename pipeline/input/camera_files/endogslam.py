"""EndoGSLAM's and gradslam's YAML of data sets: `camera_params:` with fx fy cx cy of undistorted pictures, size."""

from pipeline.input.camera_files.calibrated_lens import CalibratedLens, from_opencv, size_of
from pipeline.input.camera_files.document import CameraDocument


def read_camera_params(document: CameraDocument) -> CalibratedLens | None:
    values = document.fields.get("camera_params")
    if not isinstance(values, dict):
        return None
    size = size_of(values, "image_width", "image_height")
    return from_opencv(values["fx"], values["fy"], values["cx"], values["cy"], values.get("distortion", []), size)
