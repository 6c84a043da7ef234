"""The formats of pose files by name. A new one is a file with its reader and a row here."""

from collections.abc import Callable
from pathlib import Path

import numpy as np

from haustra.core.errors import HaustraError
from pipeline.input.pose_files.colmap_poses import images_file, read_colmap_poses
from pipeline.input.pose_files.pose_table import Array, PoseTable
from pipeline.input.pose_files.text_poses import read_text_poses
from pipeline.input.pose_files.tracker_csv import read_hand_eye, read_tracker
from pipeline.input.pose_files.transforms_poses import read_transforms_poses

FARTHEST = 1e9  # from the origin, in any unit
# A reader gives None for a file of another format; the second argument is sensor_from_camera (4,4) of a tracker.
Reader = Callable[[Path, Array | None], PoseTable | None]

POSE_FORMATS: dict[str, Reader] = {
    "tracker CSV": read_tracker,
    "COLMAP model folder": lambda path, _: read_colmap_poses(path),
    "nerfstudio transforms.json": lambda path, _: read_transforms_poses(path),
    "TUM or KITTI text": lambda path, _: read_text_poses(path),
}


def read_poses(path: Path, hand_eye: Path | None = None) -> PoseTable:
    """The poses of a file or model folder. HaustraError, one sentence, for what no reader knows or can read."""
    if not path.exists():
        raise HaustraError(f"there is no file or folder {path} of poses")
    sensor_from_camera = None if hand_eye is None else read_hand_eye(hand_eye)
    for read in POSE_FORMATS.values():
        table = read(path, sensor_from_camera)
        if table is not None:
            _check_distances(table)
            return table
    raise HaustraError(f"{path} holds no poses that can be read; looked for {', '.join(POSE_FORMATS)}")


def _check_distances(table: PoseTable) -> None:
    """HaustraError for a pose at a place where no camera is: some programs write such numbers for a missing pose."""
    farthest = float(np.abs(table.world_from_camera[:, :3, 3]).max(initial=0))
    if not farthest < FARTHEST:
        raise HaustraError(
            f"{table.path}: a pose lies {farthest:.3g} from the origin, where no camera is; if that marks a missing "
            "pose, leave such lines out"
        )


def lens_beside(path: Path) -> Path | None:
    """The camera file that comes with poses: of a COLMAP model or of transforms.json; None where there is none."""
    if path.is_file() and images_file(path) is not None:
        path = path.parent
    if path.is_file():
        return path if path.suffix.lower() == ".json" else None
    return next(
        (path / name for name in ("cameras.bin", "cameras.txt", "transforms.json") if (path / name).is_file()), None
    )
