"""TUM (`seconds tx ty tz qx qy qz qw`) and KITTI (`r11 r12 r13 tx r21 ... tz`, one line a frame), world_from_camera."""

from pathlib import Path

import numpy as np

from haustra.core.errors import HaustraError
from haustra.core.text import read_text
from pipeline.input.pose_files.pose_table import PoseTable, rigid
from reconstruction.evaluation.trajectory_io import numbers_of, read_tum

TUM, KITTI = 8, 12


def read_text_poses(path: Path) -> PoseTable | None:
    """Poses of a text file, whose format is known by how many numbers its lines have."""
    if not path.is_file() or path.suffix.lower() not in (".tum", ".txt", ".kitti", ""):
        return None
    lines = [
        numbers_of(line) for line in read_text(path).splitlines() if line.strip() and not line.lstrip().startswith("#")
    ]
    counts = {len(words) for words in lines}
    if counts == {TUM}:
        seconds, world_from_camera = read_tum(path)
        return PoseTable(path, world_from_camera, seconds)
    if counts != {KITTI}:
        return None
    try:
        rows = np.array(lines, np.float64).reshape(-1, 3, 4)
    except ValueError as error:
        raise HaustraError(f"{path}: a pose of KITTI is twelve numbers") from error
    matrices = np.tile(np.eye(4), (len(rows), 1, 1))
    matrices[:, :3] = rows
    return PoseTable(path, rigid(matrices, str(path)))
