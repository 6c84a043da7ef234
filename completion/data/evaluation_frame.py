"""What every reader gives: one frame with truth, and how files are opened with a clear sentence when they cannot be."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from haustra.core.errors import CompletionError

Depth = NDArray[np.float32]


@dataclass(frozen=True)
class EvaluationFrame:
    """rgb (H,W,3) uint8; depth (H,W) float32 z-depth with 0 = none, in `unit`; fx fy cx cy (4,) px or None.

    The intrinsics are the pinhole part, with pixel centres at half integers. `group` names the mesh or the clip that
    the frame comes from: frames of one group never go to both sides of a split.
    """

    name: str
    rgb: NDArray[np.uint8]
    depth: Depth
    unit: str
    intrinsics: NDArray[np.float64] | None = None
    group: str = ""


def read_rgb(path: Path) -> NDArray[np.uint8]:
    """(H,W,3) RGB; a fourth channel (SimCol3D's files have one) is dropped."""
    return np.ascontiguousarray(read_image(path, cv2.IMREAD_COLOR)[..., ::-1])


def read_image(path: Path, flags: int) -> NDArray[Any]:
    """An image as OpenCV gives it; CompletionError if it cannot be read."""
    image = cv2.imread(str(path), flags)
    if image is None:
        raise CompletionError(f"cannot read the image {path}")
    return image


def read_depth16(path: Path) -> NDArray[np.uint16]:
    """A 16-bit single-channel PNG or TIFF; CompletionError if it is anything else."""
    image = read_image(path, cv2.IMREAD_UNCHANGED)
    if image.ndim != 2 or image.dtype != np.uint16:
        raise CompletionError(f"{path} is no 16-bit depth image: {image.dtype} with shape {image.shape}")
    return image


def read_exr(path: Path) -> Depth:
    """The first channel (H,W) float32 of an OpenEXR file."""
    try:
        import OpenEXR
    except ImportError:
        raise CompletionError(f"reading {path} needs OpenEXR: pip install 'haustra[exr]'") from None
    try:
        with OpenEXR.File(str(path)) as file:
            pixels = next(iter(file.channels().values())).pixels.astype(np.float32)
    except (OSError, RuntimeError, StopIteration) as error:
        raise CompletionError(f"cannot read the image {path}: {error}") from None
    return pixels if pixels.ndim == 2 else np.ascontiguousarray(pixels[..., 0])


def partner(path: Path, folder: Path, name: str) -> Path:
    """`folder/name`; CompletionError if there is none."""
    found = folder / name
    if not found.is_file():
        raise CompletionError(f"{path} has no depth beside it: {found} is missing")
    return found
