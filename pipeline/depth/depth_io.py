"""Depth and confidence of keyframes on disk: 16-bit and 8-bit PNG."""

from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from haustra.core.errors import HaustraError

# One step of the depth PNG in scene units, which are median depths: 0.0004 of the median depth, up to 26 times it.
DEPTH_STEP = 0.0004


def write_depth(path: Path, depth: NDArray[np.float32]) -> None:
    """(H,W) depth in scene units, 0 = none; beyond the range of 16 bits it becomes none."""
    steps = np.round(np.nan_to_num(depth / DEPTH_STEP))
    _write(path, np.where((steps < 0) | (steps > 65535), 0, steps).astype(np.uint16))


def read_depth(path: Path) -> NDArray[np.float32]:
    """(H,W) float32 in scene units, 0 = none."""
    return _read(path).astype(np.float32) * np.float32(DEPTH_STEP)


def write_confidence(path: Path, confidence: NDArray[np.float32]) -> None:
    """(H,W) confidence in [0,1]."""
    _write(path, np.round(np.clip(confidence, 0, 1) * 255).astype(np.uint8))


def read_confidence(path: Path) -> NDArray[np.float32]:
    """(H,W) float32 in [0,1]."""
    return _read(path).astype(np.float32) / np.float32(255)


def _write(path: Path, image: NDArray) -> None:
    partial = path.with_name(f".{path.name}")
    if not cv2.imwrite(str(partial), image):
        raise HaustraError(f"cannot write {path}; is the disk full?")
    partial.replace(path)


def _read(path: Path) -> NDArray:
    image = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
    if image is None:
        raise HaustraError(f"{path} is missing or damaged; start the run anew with --overwrite")
    return image
