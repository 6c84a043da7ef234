"""Data sets of stereo laparoscopes with depth: SCARED as it is handed out and as AF-SfMLearner lays it out, and Hamlyn.

SCARED (Allan et al. 2021): each `keyframe_N` has `Left_Image.png` and `left_depth_map.tiff`, three floats a pixel: the
point of the original picture in the left camera, mm, NaN where there is none. AF-SfMLearner: `image_02/data/%010d.png`,
counted from 1, beside `image_02/data/groundtruth/scene_points%06d.tiff`, counted from 0, the left eye's points above
the right one's, 0 where there is none. Hamlyn as Endo-Depth-and-Motion rectified it: `image01/*.jpg` and
`depth01/*.png`, or `color/` and `depth/`, whole mm that end at 300, and `intrinsics.txt`.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from completion.data.evaluation_frame import Depth, EvaluationFrame, partner, read_depth16, read_image, read_rgb
from haustra.core.errors import CompletionError
from haustra.core.text import read_text

HAMLYN_END_MM = 300
HALF_PIXEL = 0.5  # OpenCV counts from the centre of the first pixel


def scared(folder: Path) -> Iterator[EvaluationFrame]:
    """The first frame of each keyframe of a `dataset_N`."""
    for path in sorted(folder.glob("keyframe_*/left_depth_map.tiff")):
        rgb, depth = read_rgb(partner(path, path.parent, "Left_Image.png")), depth_of_points(path)
        yield EvaluationFrame(path.parent.name, rgb, depth, "mm", _left_lens(path.parent), folder.name)


def scared_frames(folder: Path) -> Iterator[EvaluationFrame]:
    for path in sorted((folder / "image_02/data").glob("[0-9]*.png")):
        points = partner(path, path.parent / "groundtruth", f"scene_points{int(path.stem) - 1:06d}.tiff")
        yield EvaluationFrame(path.stem, read_rgb(path), depth_of_points(points), "mm", None, folder.name)


def hamlyn(folder: Path) -> Iterator[EvaluationFrame]:
    pictures, depths = ("image01", "depth01") if (folder / "depth01").is_dir() else ("color", "depth")
    lens = _hamlyn_lens(folder / "intrinsics.txt")
    for path in sorted(path for path in (folder / pictures).glob("[!.]*") if path.suffix.lower() in (".jpg", ".png")):
        raw = read_depth16(partner(path, folder / depths, f"{path.stem}.png"))
        depth = np.where(raw < HAMLYN_END_MM, raw, 0).astype(np.float32)
        yield EvaluationFrame(path.stem, read_rgb(path), depth, "mm", lens, folder.name)


def points_of(path: Path) -> NDArray[np.float32]:
    """(H,W,3) x y z, mm, of the left eye's pixels; 0 0 0 where there is none."""
    stored = read_image(path, cv2.IMREAD_UNCHANGED)
    if stored.ndim != 3 or stored.shape[2] != 3 or stored.dtype != np.float32:
        raise CompletionError(f"{path} is no image of points: {stored.dtype} with shape {stored.shape}")
    height, width = stored.shape[:2]
    points = stored[: height // 2 if height > width else height, :, ::-1]  # OpenCV turns the channels round
    known = np.isfinite(points).all(axis=2) & (points[..., 2] > 0)
    return np.where(known[..., None], points, np.float32(0))


def depth_of_points(path: Path) -> Depth:
    return np.ascontiguousarray(points_of(path)[..., 2])


def _left_lens(folder: Path) -> NDArray[np.float64] | None:
    """M1 of `endoscope_calibration.yaml`; None without one."""
    if not (folder / "endoscope_calibration.yaml").is_file():
        return None
    storage = cv2.FileStorage(str(folder / "endoscope_calibration.yaml"), cv2.FILE_STORAGE_READ)
    stored = storage.getNode("M1")
    if stored.empty():
        return None
    data = stored.getNode("data")  # not `mat()`, which writes past its memory where the sides are wrong
    numbers = [data.at(k).real() for k in range(data.size())]
    if len(numbers) != 9:
        raise CompletionError(
            f"M1 of {folder / 'endoscope_calibration.yaml'} has {len(numbers)} numbers; nine are needed"
        )
    return _lens_of(np.array(numbers).reshape(3, 3))


def _hamlyn_lens(path: Path) -> NDArray[np.float64] | None:
    if not path.is_file():
        return None
    try:
        rows = [[float(word) for word in line.split()[:3]] for line in read_text(path).splitlines() if line.strip()]
        return _lens_of(np.array(rows[:3], np.float64).reshape(3, 3))
    except ValueError as error:
        raise CompletionError(f"{path} must hold a camera matrix of three rows") from error


def _lens_of(matrix: NDArray[np.float64]) -> NDArray[np.float64]:
    centre = matrix[0, 2] + HALF_PIXEL, matrix[1, 2] + HALF_PIXEL
    return np.array([matrix[0, 0], matrix[1, 1], *centre], np.float64)
