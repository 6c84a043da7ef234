"""Trajectories on disk as TUM files: `world_from_camera` (N,4,4), quaternions x y z w."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from haustra.core.errors import ReconstructionError
from haustra.core.text import read_text

Array = NDArray[np.float64]

MAX_QUATERNION_ERROR = 1e-3  # deviation of a quaternion's length from 1 that a file's rounding may leave
SHOWN = 120  # characters of a line that is none


def read_tum(path: Path | str) -> tuple[Array, Array]:
    """Seconds (N,) and `world_from_camera` (N,4,4) of a file with lines `seconds tx ty tz qx qy qz qw`.

    Blanks, commas or semicolons part the numbers. Blank lines and lines that begin with # are skipped; anything else
    that is not a pose raises `ReconstructionError`, and so does time that stands still or runs backwards.
    """
    rows: list[list[float]] = []
    for number, line in enumerate(read_text(path).splitlines(), start=1):
        if line.strip() and not line.lstrip().startswith("#"):
            rows.append(_tum_row(line, f"{path}, line {number}"))
            if len(rows) > 1 and rows[-1][0] <= rows[-2][0]:
                raise ReconstructionError(f"{path}, line {number}: time must increase from pose to pose")
    if not rows:
        raise ReconstructionError(f"{path} has no poses")
    table = np.array(rows)
    world_from_camera = np.tile(np.eye(4), (len(table), 1, 1))
    world_from_camera[:, :3, :3] = Rotation.from_quat(table[:, 4:]).as_matrix()
    world_from_camera[:, :3, 3] = table[:, 1:4]
    return table[:, 0], world_from_camera


def write_tum(path: Path | str, seconds: Array, world_from_camera: Array) -> None:
    """Write `world_from_camera` (N,4,4) at `seconds` (N,): microseconds, and nine decimals of the unit of length."""
    checked = checked_poses(world_from_camera)
    if np.shape(seconds) != (len(checked),):
        raise ReconstructionError(f"{len(checked)} poses need {len(checked)} times, got {np.size(seconds)}")
    quaternions = Rotation.from_matrix(checked[:, :3, :3]).as_quat(canonical=True)
    table = np.column_stack([seconds, checked[:, :3, 3], quaternions])
    np.savetxt(path, table, fmt=["%.6f"] + ["%.9f"] * 7)


def _tum_row(line: str, where: str) -> list[float]:
    """The eight numbers of a line; `ReconstructionError` names `where` if they are no pose."""
    try:
        values = [float(word) for word in numbers_of(line)]
    except ValueError as error:
        raise ReconstructionError(f"{where}: a pose is eight numbers, got {line.strip()[:SHOWN]!r}") from error
    if len(values) != 8 or not np.isfinite(values).all():
        raise ReconstructionError(f"{where}: a pose is eight finite numbers, got {line.strip()[:SHOWN]!r}")
    length = float(np.linalg.norm(values[4:]))
    if abs(length - 1) > MAX_QUATERNION_ERROR:
        raise ReconstructionError(f"{where}: the quaternion's length is {length:.4g}, not 1")
    return values


def numbers_of(line: str) -> list[str]:
    """The words of a line that blanks, commas or semicolons part, as tools and spreadsheets save them."""
    return re.split(r"\s*[,;]\s*|\s+", line.strip())


def checked_poses(world_from_camera: Array) -> Array:
    """`world_from_camera` as float64; `ReconstructionError` unless finite and (N,4,4)."""
    matrices = np.asarray(world_from_camera, np.float64)
    if matrices.ndim != 3 or matrices.shape[1:] != (4, 4) or not np.isfinite(matrices).all():
        raise ReconstructionError(f"poses must be finite and (N,4,4), not {matrices.shape}")
    return matrices
