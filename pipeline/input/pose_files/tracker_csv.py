"""A tracker's CSV (NDI Polaris and Aurora, and alike): a sensor's poses, and the camera by a hand-eye transform.

Columns are found by their names in any case: Tx Ty Tz and Q0 Qx Qy Qz (w first) or Qx Qy Qz Qw; time, seconds or
timestamp, else frame, else the order. Lines whose State is Missing or Disabled, or whose place is NDI's number for a
missing one (-3.697314e28), are left out.
"""

import csv
from dataclasses import replace
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from haustra.core.errors import HaustraError
from haustra.core.text import read_text
from pipeline.input.pose_files.pose_table import Array, PoseTable, rigid

PLACE = (("tx", "ty", "tz"), ("x", "y", "z"))
TURN = (("qx", "qy", "qz", "q0"), ("qx", "qy", "qz", "qw"), ("rx", "ry", "rz", "rw"))  # x y z w
TIMES = ("time", "seconds", "timestamp", "t")
SAME = 1e-6  # between two poses that a file gives twice
NO_PLACE = -1e28  # NDI's number for a missing place is below
LOST = ("missing", "disabled", "bad")


def read_tracker(path: Path, sensor_from_camera: Array | None) -> PoseTable | None:
    if path.suffix.lower() != ".csv" or not path.is_file():
        return None
    text = read_text(path)
    rows = list(csv.DictReader(text.splitlines(), delimiter=";" if ";" in text.split("\n", 1)[0] else ","))
    rows = [{(name or "").strip().lower(): value for name, value in row.items()} for row in rows]
    numbers = tuple(str(row.get("frame") or "").strip() for row in rows)
    kept = [k for k, row in enumerate(rows) if not _is_lost(row)]
    if rows and not kept:
        raise HaustraError(f"{path}: all {len(rows)} lines are marked as lost; none has a pose")
    rows, names = [rows[k] for k in kept], tuple(numbers[k] for k in kept)
    place, turn = (_present(rows, choices, path) for choices in (PLACE, TURN))
    time = next((name for name in TIMES if rows and name in rows[0]), None)
    if sensor_from_camera is None:
        raise HaustraError(
            f"{path} has a tracker's poses of its sensor: give the hand-eye transform by --hand-eye FILE"
        )
    try:
        world_from_sensor = np.tile(np.eye(4), (len(rows), 1, 1))
        world_from_sensor[:, :3, 3] = [[float(row[name]) for name in place] for row in rows]
        quaternions = np.array([[float(row[name]) for name in turn] for row in rows])
        world_from_sensor[:, :3, :3] = Rotation.from_quat(quaternions).as_matrix()
        seconds = None if time is None else np.array([float(row[time]) for row in rows])
        if seconds is not None and not np.isfinite(seconds).all():
            raise ValueError
    except (TypeError, ValueError) as error:
        raise HaustraError(f"{path}: a line's place, quaternion or time is no number") from error
    world_from_camera = rigid(world_from_sensor, str(path)) @ sensor_from_camera
    if seconds is None and (not any(numbers) or (all(numbers) and _without_gap(numbers, path))):
        # A line's own place says which frame it is of: the tracker may have counted before the film began.
        return PoseTable(path, world_from_camera, None, None, tuple(kept), len(numbers), sensor_from_camera)
    if seconds is None:
        if not all(names):
            raise HaustraError(f"{path}: line {kept[names.index('')] + 2} has no frame number, and others have one")
        return PoseTable(path, world_from_camera, names=names, sensor_from_camera=sensor_from_camera)
    order = np.argsort(seconds, kind="stable")
    table = PoseTable(path, world_from_camera[order], seconds[order], sensor_from_camera=sensor_from_camera)
    return _once_a_time(table)


def _is_lost(row: dict[str, str]) -> bool:
    """Whether the tracker did not see its sensor then, by its word or by its number for that."""
    try:
        places = [float(row.get(name) or 0) for names in PLACE for name in names]
    except ValueError:  # no number; the line is refused where it is read
        places = []
    return str(row.get("state", "")).strip().lower() in LOST or any(place < NO_PLACE for place in places)


def _without_gap(numbers: tuple[str, ...], path: Path) -> bool:
    """Whether frames follow each other by one, so that their order says all."""
    try:
        return set(np.diff([int(float(number)) for number in numbers])) <= {1}
    except (ValueError, OverflowError) as error:
        raise HaustraError(f"{path}: a line's frame is no number") from error


def _once_a_time(table: PoseTable) -> PoseTable:
    """Without lines that repeat a time. HaustraError where another place is said for it."""
    assert table.seconds is not None
    again = np.flatnonzero(np.diff(table.seconds) <= 0) + 1
    for row in again.tolist():
        if not np.allclose(table.world_from_camera[row], table.world_from_camera[row - 1], atol=SAME):
            raise HaustraError(
                f"{table.path} has two poses at {table.seconds[row]:g} s, "
                f"{np.linalg.norm(np.diff(table.world_from_camera[row - 1 : row + 1, :3, 3], axis=0)):.3g} apart: of "
                "two sensors, or by a clock too coarse? Keep the lines of one"
            )
    first = np.setdiff1d(np.arange(len(table.seconds)), again)
    return replace(table, world_from_camera=table.world_from_camera[first], seconds=table.seconds[first])


def read_hand_eye(path: Path) -> Array:
    """sensor_from_camera (4,4): sixteen numbers of text, by rows."""
    try:
        numbers = [float(word) for word in read_text(path).replace(",", " ").split()]
    except ValueError as error:
        raise HaustraError(f"the hand-eye transform {path} must be sixteen numbers, by rows") from error
    if len(numbers) != 16:
        raise HaustraError(f"the hand-eye transform {path} must be sixteen numbers, by rows, not {len(numbers)}")
    return rigid(np.array(numbers).reshape(1, 4, 4), str(path))[0]


def _present(rows: list[dict[str, str]], choices: tuple[tuple[str, ...], ...], path: Path) -> tuple[str, ...]:
    for names in choices:
        if rows and all(name in rows[0] for name in names):
            return names
    wanted = " or ".join(" ".join(names) for names in choices)
    raise HaustraError(f"{path} has no columns {wanted}")
