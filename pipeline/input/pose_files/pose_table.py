"""Poses that a file gives, and which frames of a film they belong to."""

import json
import re
from collections import Counter
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from haustra.core.errors import HaustraError
from haustra.core.extrapolation import extrapolated
from haustra.core.se3 import interpolated
from pipeline.input.image_folder import images_of, rows_by_number
from pipeline.input.pose_files.pairing import FEWEST, MIN_PAIRED, paired
from pipeline.run_folder.workspace import Workspace, report_corruption

POSES_UNIT = "poses' unit (--poses-mm)"
SHOWN = 4  # folders
SAME_TIME = 0.03  # of the spacing: times are rounded to milliseconds, and such a pose is taken as it is
WIDEST_GAP = 1.5  # of the median spacing, between two poses that one between them is made of

OPENCV = "world_from_camera in OpenCV's axes"
INVERTED = "camera_from_world in OpenCV's axes"
OPENGL = "world_from_camera in OpenGL's axes (y up, z backwards)"

Array = NDArray[np.float64]


@dataclass(frozen=True)
class PoseTable:
    """world_from_camera (N,4,4), OpenCV's axes. They belong to frames by seconds (N,), by the names of pictures, or,
    where both are None, by their order: `lines` (N,) are then the numbers, from 0, of those lines of `line_count` that
    have a pose; None: all have one. path: of the file, for sentences. sensor_from_camera (4,4): the hand-eye
    transform that a tracker's poses were brought to the camera by. written: what the matrices are in the file by its
    format, `OPENCV`, `INVERTED` or `OPENGL`."""

    path: Path
    world_from_camera: Array
    seconds: Array | None = None
    names: tuple[str, ...] | None = None
    lines: tuple[int, ...] | None = None
    line_count: int = 0
    sensor_from_camera: Array | None = None
    written: str = OPENCV


@dataclass(frozen=True)
class FilmFrames:
    """A film's frames that were looked at: numbers in the source (K,), seconds (K,), names of a folder's pictures.
    called: what a pose file may call the source, of several that it knows."""

    index: NDArray[np.int64]
    seconds: Array
    names: tuple[str, ...] | None
    called: tuple[str, ...] = ()

    @staticmethod
    def of(workspace: Workspace) -> "FilmFrames":
        with report_corruption(workspace.frames):
            listed = json.loads(workspace.frames.read_text())["frames"]
        source = Path(workspace.record["source"]["path"])
        pictures = images_of(source)[0] if source.is_dir() else []
        return FilmFrames(
            np.array([index for index, _, _ in listed]),
            np.array([seconds for _, seconds, _ in listed]),
            tuple(path.name for path in pictures) if source.is_dir() else None,
            (source.stem, *{path.parent.name for path in pictures}),
        )

    def spacing(self, table: PoseTable) -> float | None:
        """Seconds between two frames, where the poses have times, too."""
        return None if table.seconds is None or len(self.index) < 2 else self.interval

    @property
    def interval(self) -> float:
        """Mean seconds between two frames of the source, of which a stride left some out."""
        return float((self.seconds[-1] - self.seconds[0]) / (self.index[-1] - self.index[0]))

    def seconds_of(self, numbers: NDArray[np.int64]) -> Array:
        """(N,) times of frames by their numbers in the source (N,), looked at or not."""
        return extrapolated(numbers, self.index, self.seconds, self.interval)

    def numbers_at(self, seconds: Array) -> Array:
        """(N,) numbers in the source of the frames at times (N,), with their fractions between two frames."""
        return extrapolated(seconds, self.seconds, self.index, 1 / self.interval)


def first_numbers(table: PoseTable, film: FilmFrames) -> tuple[int, ...]:
    """The numbers that a film's first frame may have in the names of the table's pictures, the likeliest first.

    Programs count from 0, and FFmpeg from 1; where neither the first nor the last frame has a pose, both can be meant,
    unless only every n-th frame was looked at and has the numbers of one count.
    """
    if table.names is None or film.names is not None:
        return (0,)
    _, names = _of_one_camera(table, table.names, film)
    numbers = {int(found[-1]) for name in names if (found := re.findall(r"\d+", Path(name).stem))}
    least, most, last = min(numbers, default=0), max(numbers, default=0), int(film.index.max())
    if least == 0 or most > last + 1:
        return (0,)
    if most == last + 1:
        return (1,)
    looked_at = set(film.index.tolist())
    belong = {first: len(looked_at & {number - first for number in numbers}) for first in (1, 0)}
    return tuple(first for first in belong if belong[first] >= MIN_PAIRED * max(belong.values()))


def poses_by_frame(table: PoseTable, film: FilmFrames, first: int = 0) -> dict[int, Array]:
    """world_from_camera (4,4) by frame number, of the frames that have one. HaustraError where the poses are of another
    film by their number, names or times; first: the first frame's number in the names of a film's pictures."""
    if table.names is not None:
        found = _by_name(table, table.names, film, first)
    elif table.seconds is not None:
        found = _by_time(table, table.seconds, film)
    else:
        found = _by_order(table, film)
    looked_at = set(film.index.tolist())
    found = {frame: found[frame] for frame in found if frame in looked_at}
    if len(found) < max(FEWEST, MIN_PAIRED * min(len(film.index), len(table.world_from_camera))):
        raise HaustraError(
            f"only {len(found)} of the {len(table.world_from_camera)} poses of {table.path} belong to one of the "
            f"{len(film.index)} frames: they are of another film, or its frames have other names"
        )
    return found


def _by_order(table: PoseTable, film: FilmFrames) -> dict[int, Array]:
    count, frames = len(table.world_from_camera), int(film.index.max()) + 1
    lines = range(count) if table.lines is None else table.lines
    count = max(count, table.line_count)
    if count < frames:
        raise HaustraError(
            f"{table.path} has {count} poses without times, and the film {frames} frames: one for each frame is needed"
        )
    return dict(zip(lines, table.world_from_camera, strict=True))


def _by_name(table: PoseTable, names: tuple[str, ...], film: FilmFrames, first: int) -> dict[int, Array]:
    """By the names of a folder's pictures, or the numbers in both; of a film, by the number in the name."""
    table, names = _of_one_camera(table, names, film)
    by_stem = {Path(name).stem: number for number, name in enumerate(film.names or ())}
    stems = [Path(name).stem for name in names]
    if any(stem in by_stem for stem in stems):
        named = zip(stems, table.world_from_camera, strict=True)
        return {by_stem[stem]: world_from_camera for stem, world_from_camera in named if stem in by_stem}
    numbers = [re.findall(r"\d+", stem) for stem in stems]
    if not all(numbers):
        raise HaustraError(f"the pictures that {table.path} names are not those of the film, and carry no numbers")
    last = [int(found[-1]) for found in numbers]
    rows = rows_by_number(film.names or (), names)
    if rows is not None:
        return {rows[number]: matrix for number, matrix in zip(last, table.world_from_camera, strict=True)}
    numbered = zip(last, table.world_from_camera, strict=True)
    return {number - first: world_from_camera for number, world_from_camera in numbered}


def _of_one_camera(table: PoseTable, names: tuple[str, ...], film: FilmFrames) -> tuple[PoseTable, tuple[str, ...]]:
    """The poses whose pictures are the film's, where folders of several cameras have pictures of the same names: those
    of the folder that is called as the film is."""
    if len({Path(name).stem for name in names}) == len(names):
        return table, names
    folders = sorted({Path(name).parent.as_posix() for name in names})
    ours = [row for row, name in enumerate(names) if Path(name).parent.name in film.called]
    if len(folders) == 1:
        stems = Counter(Path(name).stem for name in names)
        name, count = stems.most_common(1)[0]
        raise HaustraError(f"{table.path} has {count} poses of the picture {name}: keep one of each picture")
    if not ours or len({Path(names[row]).stem for row in ours}) < len(ours):
        raise HaustraError(
            f"{table.path} has pictures of the same name in {' and '.join(folders[:SHOWN])}, and the film is called "
            f"{film.called[0] if film.called else 'otherwise'}: keep those of its own folder, or call it as that"
        )
    return replace(table, world_from_camera=table.world_from_camera[ours]), tuple(names[row] for row in ours)


def _by_time(table: PoseTable, seconds: Array, film: FilmFrames) -> dict[int, Array]:
    mine, theirs = paired(film.seconds, seconds, table.path, "frames of the film")
    at = _between(film.seconds[mine], seconds, table.world_from_camera, theirs)
    return {int(film.index[m]): world_from_camera for m, world_from_camera in zip(mine, at, strict=True)}


def _between(wanted: Array, seconds: Array, world_from_camera: Array, nearest: NDArray[np.int64]) -> Array:
    """(K,4,4) at times wanted (K,), between the poses (N,4,4) of seconds (N,) before and after: those of another rate
    than the film's are up to half a frame off. Beside a gap, and before the first and after the last, the nearest."""
    result = world_from_camera[nearest].copy()
    if len(seconds) < 2:
        return result
    after = np.searchsorted(seconds, wanted).clip(1, len(seconds) - 1)
    gaps = seconds[after] - seconds[after - 1]
    spacing = np.median(np.diff(seconds))
    apart = (gaps < WIDEST_GAP * spacing) & (np.abs(wanted - seconds[nearest]) > SAME_TIME * spacing)
    inside = apart & (wanted > seconds[after - 1]) & (wanted < seconds[after])
    if inside.any():
        result[inside] = interpolated(seconds, world_from_camera, wanted[inside])
    return result


def rigid(matrices: Array, where: str) -> Array:
    """(N,4,4) checked: finite, with a rotation, which is brought to the nearest exact one."""
    matrices = np.asarray(matrices, np.float64)
    if matrices.ndim != 3 or matrices.shape[1:] != (4, 4) or len(matrices) == 0 or not np.isfinite(matrices).all():
        raise HaustraError(f"{where} must hold poses as finite 4x4 matrices")
    u, size, vt = np.linalg.svd(matrices[:, :3, :3])
    if np.abs(size - 1).max() > 1e-2:
        raise HaustraError(f"{where}: the left upper 3x3 of a pose is no rotation (its stretch is {size.max():.3g})")
    if (np.linalg.det(matrices[:, :3, :3]) < 0).any():
        raise HaustraError(
            f"{where}: the left upper 3x3 of a pose mirrors (its determinant is -1): the file's world or camera is "
            "left-handed; turn one axis of that one round"
        )
    result = matrices.copy()
    result[:, :3, :3] = u @ vt
    result[:, 3] = [0, 0, 0, 1]
    return result
