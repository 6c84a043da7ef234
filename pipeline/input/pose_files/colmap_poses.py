"""A COLMAP model: images.txt or images.bin, camera_from_world, named by picture (colmap.github.io/format.html)."""

import re
import struct
from itertools import dropwhile
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from haustra.core.errors import HaustraError
from haustra.core.text import read_text
from pipeline.input.pose_files.pose_table import INVERTED, Array, PoseTable, rigid

HEAD = struct.Struct("<I7dI")  # number, quaternion w x y z, translation, number of the camera
IMAGE = re.compile(r"\s*\d+(\s+[-+\d.eE]+){7}\s+\d+\s+[^\n]*[^\W\d]")  # no line of points has a letter
NAMES = ("images.bin", "images.txt")
COMMENT, HEAD_BYTES = "IMAGE_ID, QW, QX, QY, QZ", 65536  # of the comment that COLMAP writes, and where it is looked for
POINT_BYTES = 24  # x, y and the number of the 3-D point


def images_file(path: Path) -> Path | None:
    """The images.bin or images.txt of a COLMAP model: that of a folder, or the file itself; a text may have any name if
    its comments or its first line are those of COLMAP. None where there is none."""
    if path.is_dir():
        return next((path / name for name in NAMES if (path / name).is_file()), None)
    return path if path.name in NAMES or (path.is_file() and _is_text_of_images(path)) else None


def _is_text_of_images(path: Path) -> bool:
    with path.open("rb") as file:
        head = file.read(HEAD_BYTES).decode("utf-8-sig", "replace").splitlines()
    comments = [line for line in head if line.startswith("#")]
    lines = [line for line in head if line.strip() and not line.startswith("#")]
    return any(COMMENT in line for line in comments) or bool(lines and IMAGE.match(lines[0]))


def read_colmap_poses(path: Path) -> PoseTable | None:
    images = images_file(path)
    if images is None or not images.is_file():
        return None
    found = _binary(images) if images.name == "images.bin" else _text(images)
    if not found:
        raise HaustraError(f"{path} holds a COLMAP model without images")
    none = next((name for name, (turn, _) in found.items() if not 0 < np.linalg.norm(turn) < np.inf), None)
    if none is not None:
        raise HaustraError(f"{path}: the quaternion of {none} is none: {found[none][0]}")
    names = sorted(found)
    poses = np.stack([_world_from_camera(*found[name]) for name in names])
    return PoseTable(path, rigid(poses, str(path)), names=tuple(names), written=INVERTED)


def _text(path: Path) -> dict[str, tuple[list[float], list[float]]]:
    """Every other line is an image, the next one its points, and may be empty; programs that know no points leave those
    lines out."""
    lines = [line for line in read_text(path).splitlines() if not line.startswith("#")]
    lines = list(dropwhile(lambda line: not line.strip(), lines))
    filled = [line for line in lines if line.strip()]
    images = filled if all(IMAGE.match(line) for line in filled) else lines[::2]
    found = {}
    for line in images:
        words = line.split(maxsplit=9)
        if len(words) < 10:
            continue
        try:
            numbers = [float(word) for word in words[1:8]]
        except ValueError as error:
            raise HaustraError(f"{path} is no images.txt of COLMAP: {line.strip()[:60]!r} is no image") from error
        found[words[9]] = (numbers[:4], numbers[4:])
    return found


def _binary(path: Path) -> dict[str, tuple[list[float], list[float]]]:
    data, found, place = path.read_bytes(), {}, 8
    try:
        (count,) = struct.unpack_from("<Q", data)
        for _ in range(count):
            _, *numbers, _ = HEAD.unpack_from(data, place)
            place += HEAD.size
            end = data.index(b"\0", place)
            found[data[place:end].decode()] = (numbers[:4], numbers[4:])
            (points,) = struct.unpack_from("<Q", data, end + 1)
            place = end + 9 + POINT_BYTES * points
        if place > len(data):
            raise ValueError
    except (struct.error, ValueError) as error:
        raise HaustraError(f"{path} is cut off") from error
    return found


def _world_from_camera(quaternion: list[float], shift: list[float]) -> Array:
    w, x, y, z = quaternion
    rotation = Rotation.from_quat([x, y, z, w]).as_matrix()
    world_from_camera = np.eye(4)
    world_from_camera[:3, :3], world_from_camera[:3, 3] = rotation.T, -rotation.T @ np.array(shift)
    return world_from_camera
