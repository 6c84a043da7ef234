"""The formats of camera files by name. A new one is a file with its reader and a row here (docs/extending.md)."""

from collections.abc import Callable
from pathlib import Path

from haustra.core.camera import Camera
from haustra.core.errors import HaustraError
from pipeline.input.camera_files.calibrated_lens import LEAST_FOCAL_PX, CalibratedLens
from pipeline.input.camera_files.camera_json import read_camera_json
from pipeline.input.camera_files.colmap_cameras import read_colmap
from pipeline.input.camera_files.document import CameraDocument, open_document
from pipeline.input.camera_files.endogslam import read_camera_params
from pipeline.input.camera_files.endomapper_xml import read_endomapper
from pipeline.input.camera_files.kalibr import read_kalibr
from pipeline.input.camera_files.matlab_json import read_matlab
from pipeline.input.camera_files.matrix_file import read_matrix_file
from pipeline.input.camera_files.nerfstudio import read_transforms
from pipeline.input.camera_files.ocamcalib import read_ocamcalib
from pipeline.input.camera_files.orb_slam import read_orb_slam
from pipeline.input.camera_files.ros_camera_info import read_camera_info
from pipeline.input.camera_files.text_matrix import read_text_matrix

# A reader gives None for a file of another format, and raises where the file is of its own but cannot be read.
Reader = Callable[[CameraDocument], CalibratedLens | None]

MOST_PX = 100_000  # of a picture's side

# The first that knows the file is taken: those whose marks others could have too come last.
CAMERA_FORMATS: dict[str, Reader] = {
    "nerfstudio transforms.json": read_transforms,
    "MATLAB JSON": read_matlab,
    "ROS camera_info": read_camera_info,
    "Kalibr camchain": read_kalibr,
    "ORB-SLAM settings": read_orb_slam,
    "EndoGSLAM camera_params": read_camera_params,
    "EndoMapper geometrical XML": read_endomapper,
    "OCamCalib or C3VD polynomial": read_ocamcalib,
    "OpenCV YAML, XML or JSON": read_matrix_file,
    "camera.json": read_camera_json,
    "COLMAP cameras": read_colmap,
    "camera matrix as text": read_text_matrix,
}


def read_lens(path: Path) -> tuple[str, CalibratedLens]:
    """A camera file's format and lens. HaustraError, one sentence, for a file that no reader knows or can read."""
    document = open_document(path)
    for name, read in CAMERA_FORMATS.items():
        try:
            lens = read(document)
            if lens is not None:
                if max(lens.size or (1, 1)) > MOST_PX:
                    raise HaustraError(f"its pictures have over {MOST_PX} pixels a side, which none has")
                focal_px = Camera(lens.model, *(lens.size or (1, 1)), lens.params).focal_px  # of possible numbers
                if focal_px < LEAST_FOCAL_PX:
                    raise HaustraError(
                        f"its focal length is {focal_px:.3g}; it must be in pixels, and seems to be in mm"
                    )
                return name, lens
        except HaustraError as error:
            said = str(error)
            raise HaustraError(said if said.startswith(str(path)) else f"{path}, read as {name}: {said}") from error
        except KeyError as error:
            raise HaustraError(f"{path}, read as {name}: it lacks {error.args[0]}") from error
        except (TypeError, ValueError, IndexError, AttributeError, OverflowError, ZeroDivisionError) as error:
            raise HaustraError(f"{path}, read as {name}: a value has another form than this format's") from error
    raise HaustraError(f"{path} is no camera file that is known; looked for {', '.join(CAMERA_FORMATS)}")
