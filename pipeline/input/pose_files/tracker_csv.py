"""A tracker's CSV (NDI Polaris and Aurora, and alike): a sensor's poses, and the camera by a hand-eye transform.

Columns are found by their names in any case: Tx Ty Tz and Q0 Qx Qy Qz (w first) or Qx Qy Qz Qw; time, seconds or
timestamp, else frame. Lines whose State is Missing or Disabled are left out.
"""

import csv
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from haustra.core.errors import HaustraError
from haustra.core.text import read_text
from pipeline.input.pose_files.pose_table import Array, PoseTable, rigid

PLACE = (("tx", "ty", "tz"), ("x", "y", "z"))
TURN = (("qx", "qy", "qz", "q0"), ("qx", "qy", "qz", "qw"), ("rx", "ry", "rz", "rw"))  # x y z w
TIMES = ("time", "seconds", "timestamp", "t")
LOST = ("missing", "disabled", "bad")


def read_tracker(path: Path, sensor_from_camera: Array | None) -> PoseTable | None:
    if path.suffix.lower() != ".csv" or not path.is_file():
        return None
    text = read_text(path)
    rows = list(csv.DictReader(text.splitlines(), delimiter=";" if ";" in text.split("\n", 1)[0] else ","))
    rows = [{(name or "").strip().lower(): value for name, value in row.items()} for row in rows]
    rows = [row for row in rows if str(row.get("state", "")).strip().lower() not in LOST]
    place, turn = (_present(rows, names, path) for names in (PLACE, TURN))
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
    except (TypeError, ValueError) as error:
        raise HaustraError(f"{path}: a line's place, quaternion or time is no number") from error
    return PoseTable(path, rigid(world_from_sensor, str(path)) @ sensor_from_camera, seconds)


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
