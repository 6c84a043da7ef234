"""Stereo laparoscopes: SCARED's and StereoMIS's camera paths; Hamlyn, which has none.

SCARED: `keyframe_N/data/frame_data/frame_data%06d.json` (or `frame_data.tar.gz`) with `camera-pose`, 4x4 in mm, and the
left camera's `KL` and `DL`; `scene_points/scene_points%06d.tiff` has the left eye's points of each frame above the
right one's. Programs that read it disagree whether a pose takes points to the world or from it: the points of two
frames tell, since only one reading puts them on one surface; without points the pose is taken for camera_from_world, as
AF-SfMLearner does. StereoMIS: `groundtruth.txt`, `time tx ty tz qx qy qz qw` with commas or blanks, world_from_camera
in metres, a line for each frame of the film, beside `StereoCalibration.ini`.
"""

import json
import re
import tarfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from completion.data.laparoscopes import depth_of_points, points_of
from haustra.core.camera import Camera
from haustra.core.errors import HaustraError
from haustra.core.se3 import inverse
from haustra.core.text import read_text
from pipeline.input.camera_files.calibrated_lens import from_matrix
from pipeline.truth.data_set_truth import Array, DataSetTruth, rotations_of, views_apart

MM_PER_M = 1000.0
THINNED = 4000  # points of a frame that are compared


def read_scared(folder: Path) -> DataSetTruth | None:
    base = next((b for b in (folder / "data", folder, folder / "image_02/data") if _told(b)), None)
    if base is None:
        return None
    frames = dict(_frame_data(base))
    if sorted(frames) != list(range(len(frames))):
        raise HaustraError(
            f"{base}: frame_data is counted from 0, without a gap; {len(frames)} files go to {max(frames)}"
        )
    try:
        stored = np.array([frames[k]["camera-pose"] for k in range(len(frames))], np.float64).reshape(-1, 4, 4)
        lens = frames[0]["camera-calibration"]
        calibrated = from_matrix(lens["KL"], np.ravel(lens["DL"]).tolist(), None)
    except (KeyError, TypeError, ValueError) as error:
        raise HaustraError(f"{base}: frame_data lacks camera-pose, or KL and DL of camera-calibration") from error
    points = _points(base, len(frames))
    inverted: Array = np.stack([inverse(matrix) for matrix in stored]).astype(np.float64)
    world_from_camera: Array = stored if _fit(stored, points) < _fit(inverted, points) else inverted
    if not points:
        return DataSetTruth(world_from_camera)
    height, width = depth_of_points(points[min(points)]).shape
    camera = Camera(calibrated.model, width, height, calibrated.params)
    return DataSetTruth(world_from_camera, depths=_depths(points, len(frames), (height, width)), camera=camera)


def read_stereomis(folder: Path) -> DataSetTruth | None:
    path = folder / "groundtruth.txt"
    if not path.is_file() or not (folder / "StereoCalibration.ini").is_file():
        return None
    lines = (line.replace(",", " ").split() for line in read_text(path).splitlines() if not line.startswith("#"))
    try:
        table = np.array([line for line in lines if line], np.float64)
    except ValueError as error:
        raise HaustraError(f"{path} must have eight numbers on each line") from error
    if table.ndim != 2 or table.shape[1] != 8 or not np.isfinite(table).all():
        raise HaustraError(f"{path} must have eight finite numbers on each line")
    world_from_camera = np.tile(np.eye(4), (len(table), 1, 1))
    world_from_camera[:, :3, :3] = rotations_of(path, table[:, 4:])
    world_from_camera[:, :3, 3] = MM_PER_M * table[:, 1:4]
    return DataSetTruth(world_from_camera)


def read_hamlyn(folder: Path) -> DataSetTruth | None:
    """HaustraError for a folder of Hamlyn."""
    pairs = (("image01", "depth01"), ("color", "depth"))
    has_depth = any((folder / picture).is_dir() and (folder / depth).is_dir() for picture, depth in pairs)
    if not has_depth or not (folder / "intrinsics.txt").is_file():
        return None
    raise HaustraError(
        f"{folder} is of Hamlyn, which has depth by stereo matching and no camera path: there is nothing to align a "
        "run by; `haustra evaluate` judges depth completion on it"
    )


def _told(base: Path) -> bool:
    return (base / "frame_data").is_dir() or (base / "frame_data.tar.gz").is_file()


def _frame_data(base: Path) -> Iterator[tuple[int, dict[str, Any]]]:
    """Number and contents of each JSON, of the folder or of the archive."""
    if (base / "frame_data").is_dir():
        for path in (base / "frame_data").glob("[!.]*.json"):
            yield _number(path.name), _parsed(read_text(path), path)
        return
    archive = base / "frame_data.tar.gz"
    try:
        with tarfile.open(archive) as files:
            for member in files:
                if member.name.endswith(".json") and (file := files.extractfile(member)) is not None:
                    yield _number(Path(member.name).name), _parsed(file.read().decode(), archive)
    except (tarfile.TarError, EOFError, OSError) as error:
        raise HaustraError(f"{archive} cannot be read to its end: {error}") from error


def _number(name: str) -> int:
    return int(re.findall(r"\d+", name)[-1])


def _parsed(text: str, path: Path) -> dict[str, Any]:
    try:
        return dict(json.loads(text))
    except (ValueError, TypeError) as error:
        raise HaustraError(f"{path} is no frame_data of SCARED: {error}") from error


def _points(base: Path, count: int) -> dict[int, Path]:
    """Images of points by frame, where their archive has been unpacked."""
    files = (path for place in ("scene_points", "groundtruth") for path in (base / place).glob("scene_points*.tiff"))
    return {number: path for path in files if (number := _number(path.stem)) < count}


def _fit(world_from_camera: Array, points: dict[int, Path]) -> float:
    """Median distance, mm, from one frame's points to those of another far from it, both in the world; infinite
    without two."""
    if len(points) < 2:
        return np.inf
    first = min(points)
    other = max(
        points, key=lambda k: float(np.linalg.norm(world_from_camera[k, :3, 3] - world_from_camera[first, :3, 3]))
    )
    here, there = (_world(world_from_camera[k], points[k]) for k in (first, other))
    return float(np.median(cKDTree(here).query(there)[0])) if len(here) and len(there) else np.inf


def _world(world_from_camera: Array, path: Path) -> Array:
    points = points_of(path)
    local = points[points[..., 2] > 0].astype(np.float64)
    local = local[:: max(1, len(local) // THINNED)]
    return np.asarray(local @ world_from_camera[:3, :3].T + world_from_camera[:3, 3])


def _depths(points: dict[int, Path], count: int, shape: tuple[int, int]) -> Iterator[NDArray[np.float32]]:
    """Of each frame (H,W), nothing in those that are not asked: an image of points has 30 MB."""
    nothing, step = np.zeros(shape, np.float32), views_apart(count)
    return (depth_of_points(points[k]) if k in points and k % step == 0 else nothing for k in range(count))
