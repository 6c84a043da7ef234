"""nerfstudio's `transforms.json`: world_from_camera in OpenGL's axes (x right, y up, z backwards), named by picture."""

from pathlib import Path

import numpy as np

from haustra.core.errors import HaustraError
from haustra.core.text import read_json
from pipeline.input.pose_files.pose_table import OPENGL, PoseTable, rigid

OPENCV_FROM_OPENGL = np.diag([1.0, -1.0, -1.0, 1.0])


def read_transforms_poses(path: Path) -> PoseTable | None:
    file = path / "transforms.json" if path.is_dir() else path
    if file.suffix.lower() != ".json" or not file.is_file():
        return None
    frames = read_json(file).get("frames")
    if not isinstance(frames, list) or not frames:
        raise HaustraError(f"{file} has no frames with a transform_matrix each")
    try:
        matrices = np.array([frame["transform_matrix"] for frame in frames], np.float64)
        names = [str(frame["file_path"]) for frame in frames]
    except (KeyError, TypeError, ValueError, OverflowError) as error:
        raise HaustraError(f"{file}: each frame needs file_path and a transform_matrix of 4x4 numbers") from error
    return PoseTable(file, rigid(matrices, str(file)) @ OPENCV_FROM_OPENGL, names=tuple(names), written=OPENGL)
