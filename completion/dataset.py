"""Training frames from memory-mapped shards, and evaluation frames from folders.

A shard folder holds `images.npy` (N,H,W,3) uint8 RGB, `depths.npy` (N,H,W) float16 mm and `colon.npy` (N) int, the
mesh that each frame shows. Validation takes whole meshes, never single frames of a mesh that is trained on.
"""

import json
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from completion.errors import CompletionError


@dataclass(frozen=True)
class Shard:
    """Memory-mapped frames of one size; indices are into `images`."""

    images: NDArray[np.uint8]
    depths: NDArray[np.float16]
    colon: NDArray[np.int32]

    @classmethod
    def open(cls, folder: Path) -> "Shard":
        try:
            arrays = [np.load(folder / f"{n}.npy", mmap_mode="r") for n in ("images", "depths", "colon")]
        except (OSError, ValueError) as error:
            raise CompletionError(f"{folder} is not a folder of training shards: {error}") from error
        if not len(arrays[0]) == len(arrays[1]) == len(arrays[2]):
            raise CompletionError(f"the arrays in {folder} differ in length")
        return cls(*arrays)

    def split(self, validation_share: float = 0.05) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """(training, validation) frame indices; the last meshes by number are for validation."""
        meshes = np.unique(self.colon)
        held_out = meshes[len(meshes) - max(1, round(validation_share * len(meshes))) :]
        validation = np.isin(self.colon, held_out)
        return np.flatnonzero(~validation), np.flatnonzero(validation)

    def batch(self, index: NDArray[np.int64]) -> tuple[Tensor, Tensor]:
        """rgb (B,3,H,W) float in [0,1] and depth (B,1,H,W) float32 in mm."""
        order = np.sort(index)
        rgb = torch.from_numpy(self.images[order]).permute(0, 3, 1, 2).float() / 255
        depth = torch.from_numpy(self.depths[order].astype(np.float32))[:, None]
        return rgb, depth


def augment(rgb: Tensor, depth: Tensor, generator: torch.Generator) -> tuple[Tensor, Tensor]:
    """Flips and transpositions of both; gain, gamma, tint, haze and noise of the image only."""
    flip = torch.rand(3, generator=generator) < 0.5
    for dim in (2, 3):
        if flip[dim - 2]:
            rgb, depth = rgb.flip(dim), depth.flip(dim)
    if flip[2] and rgb.shape[2] == rgb.shape[3]:
        rgb, depth = rgb.transpose(2, 3), depth.transpose(2, 3)
    batch = len(rgb)

    def draw(low: float, high: float, channels: int = 1) -> Tensor:
        return low + (high - low) * torch.rand(batch, channels, 1, 1, generator=generator)

    rgb = rgb.clamp_min(1e-4) ** draw(0.7, 1.4) * draw(0.7, 1.35) * draw(0.85, 1.15, 3)
    grey = rgb.mean(1, keepdim=True)
    rgb = grey + (rgb - grey) * draw(0.3, 1.5) + draw(0, 0.05)
    rgb = rgb + draw(0, 0.02) * torch.randn(rgb.shape, generator=generator)
    return rgb.clamp(0, 1).contiguous(memory_format=torch.channels_last), depth.contiguous()


@dataclass(frozen=True)
class EvaluationFrame:
    """One frame with truth: rgb (H,W,3) uint8, depth (H,W) float32 with 0 = none, in `unit`."""

    name: str
    rgb: NDArray[np.uint8]
    depth: NDArray[np.float32]
    unit: str


def read_evaluation_frames(folder: Path) -> Iterator[EvaluationFrame]:
    """Frames of an RGB-D folder (`rgb/`, `depth/`, `camera.json`) or of a SimCol3D folder."""
    if (folder / "camera.json").exists():
        yield from _read_rgbd_folder(folder)
    elif any(folder.glob("FrameBuffer_*.png")):
        yield from _read_simcol(folder)
    else:
        raise CompletionError(f"{folder} is neither an RGB-D folder (camera.json) nor SimCol3D (FrameBuffer_*.png)")


def _read_rgbd_folder(folder: Path) -> Iterator[EvaluationFrame]:
    unit_mm = json.loads((folder / "camera.json").read_text())["depth_unit_mm"]
    for path in sorted((folder / "rgb").glob("*.png")):
        depth = _imread(folder / "depth" / path.name, cv2.IMREAD_UNCHANGED)
        yield EvaluationFrame(path.stem, _read_rgb(path), depth.astype(np.float32) * np.float32(unit_mm), "mm")


def _read_simcol(folder: Path) -> Iterator[EvaluationFrame]:
    for path in sorted(folder.glob("FrameBuffer_*.png")):
        raw = _imread(folder / path.name.replace("FrameBuffer", "Depth"), cv2.IMREAD_UNCHANGED)
        # 256 * 255, not 65535, and a full scale of 20 cm: SimCol3D's own reader.
        depth = raw.astype(np.float32) * np.float32(200 / (256 * 255))
        yield EvaluationFrame(path.stem.split("_")[-1], _read_rgb(path), depth, "mm")


def _read_rgb(path: Path) -> NDArray[np.uint8]:
    return np.ascontiguousarray(_imread(path, cv2.IMREAD_COLOR)[..., ::-1])


def _imread(path: Path, flags: int) -> NDArray:
    image = cv2.imread(str(path), flags)
    if image is None:
        raise CompletionError(f"cannot read the image {path}")
    return image
