"""C3VD and C3VDv2: `pose.txt`, sixteen numbers a line, in mm.

The data set's page says row-major camera-to-world, but the renderer writes GLM's columns: the translation is in the
last row, and each matrix is transposed (issues 3 and 20 of DurrLab/C3VD).
"""

from pathlib import Path

import numpy as np

from completion.data.readers import read_evaluation_frames
from haustra.core.errors import HaustraError
from pipeline.input.camera_presets import PRESETS
from pipeline.truth.data_set_truth import DataSetTruth, table_of


def read_c3vd(folder: Path) -> DataSetTruth | None:
    if not (folder / "pose.txt").is_file():
        return None
    stored = table_of(folder / "pose.txt", 16, ",").reshape(-1, 4, 4)
    if np.abs(stored[:, :3, 3]).max() > 1e-6:
        raise HaustraError(f"{folder / 'pose.txt'} has its translations in the last column; C3VD's are in the last row")
    world_from_camera = np.swapaxes(stored, 1, 2)
    flat = next(folder.glob("*_depth.tiff"), None) is not None
    kind = "c3vd" if flat else "c3vdv2"
    if not flat and next(folder.glob("depth/*_depth.tiff"), None) is None:
        return DataSetTruth(world_from_camera)
    lens = "c3vd" if flat or folder.name.startswith("c0_") else "c3vd-v2"  # c0_: the first C3VD, released again
    depths = (frame.depth for frame in read_evaluation_frames(folder, kind))
    return DataSetTruth(world_from_camera, depths=depths, camera=PRESETS[lens].camera)
