"""Training frames from memory-mapped shards.

A shard folder holds `images.npy` (N,H,W,3) uint8 RGB, `depths.npy` (N,H,W) float16 mm and `colon.npy` (N) int, the
mesh that each frame shows. Validation takes whole meshes, never single frames of a mesh that is trained on.
"""

import hashlib
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import torch
import torch.nn.functional as F
from numpy.typing import NDArray
from torch import Tensor

from completion.data.draws import moved, normal_draws, on_host, uniform_draws
from haustra.core.errors import CompletionError
from haustra.core.text import counted

VALIDATION_SHARE = 0.05  # of the meshes


@dataclass(frozen=True)
class Shard:
    """Memory-mapped frames of one size; indices are into `images`."""

    images: NDArray[np.uint8]
    depths: NDArray[np.float16]
    colon: NDArray[np.int32]
    lenses: NDArray[np.float32] | None = None  # (N,4) fx fy cx cy px, where the folder has them
    held: tuple[Tensor, Tensor] | None = None  # images and depths in a device's memory

    @classmethod
    def open(cls, folder: Path) -> "Shard":
        try:
            arrays = [np.load(folder / f"{n}.npy", mmap_mode="r") for n in ("images", "depths", "colon")]
            path = folder / "intrinsics.npy"
            lenses = np.load(path, mmap_mode="r") if path.exists() else None
        except (OSError, ValueError) as error:
            raise CompletionError(f"{folder} is not a folder of training shards: {error}") from error
        if len({len(array) for array in (*arrays, lenses) if array is not None}) != 1:
            raise CompletionError(f"the arrays in {folder} differ in length")
        return cls(arrays[0], arrays[1], arrays[2], lenses)

    def held_on(self, device: torch.device) -> "Shard":
        """The same frames, copied once into a device's memory: 5 bytes a pixel."""
        images, depths = (torch.from_numpy(np.array(array)).to(device) for array in (self.images, self.depths))
        return replace(self, held=(images, depths))

    def fingerprint(self) -> str:
        """Which frames these are, wherever the folder lies: of the meshes, and of the first and last depth map."""
        found = hashlib.sha256(np.ascontiguousarray(self.colon).tobytes())
        found.update(str(self.images.shape).encode() + self.depths[0].tobytes() + self.depths[-1].tobytes())
        return found.hexdigest()[:16]

    def split(self) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """(training, validation) frame indices; the last meshes by number are for validation."""
        meshes = np.unique(self.colon)
        held_out = meshes[len(meshes) - validation_meshes(len(meshes)) :]
        validation = np.isin(self.colon, held_out)
        return np.flatnonzero(~validation), np.flatnonzero(validation)

    def too_few_for(self, batch: int) -> str:
        """What keeps training in batches of so many frames from it, a sentence that begins after the folder's name; ""
        where nothing does."""
        (training, held_out), frames, meshes = self.split(), len(self.colon), len(np.unique(self.colon))
        why = "held out to measure the error on"
        if meshes < 2:
            shown = f"{counted(frames, 'frame')} of {counted(meshes, 'mesh', 'meshes')}"
            return f"has {shown}: whole meshes are {why}, so two or more are needed"
        if len(training) < batch:
            held = f"{len(held_out)} of its {frames}, those of {validation_meshes(meshes)} of {meshes} meshes"
            few = f"{counted(len(training), 'frame')} to train on, fewer than a batch of {batch}"
            return f"has {few}: {held}, are {why}"
        return ""

    def batch(self, index: NDArray[np.int64], device: torch.device | None = None) -> "Batch":
        """Frames of sorted indices; on a device they are turned into floats there."""
        order = np.sort(index)
        if self.held is None:
            images, depths = (torch.from_numpy(array[order]).to(device) for array in (self.images, self.depths))
        else:
            rows = moved(torch.from_numpy(order), self.held[0].device)
            images, depths = (array[rows].to(device) for array in self.held)
        rgb = images.permute(0, 3, 1, 2).float() / 255
        lens = None if self.lenses is None else moved(torch.from_numpy(self.lenses[order]), images.device)
        return Batch(rgb, depths.float()[:, None], lens)


def validation_meshes(meshes: int) -> int:
    """How many of so many meshes are only watched while a network is trained on the others."""
    return max(1, round(VALIDATION_SHARE * meshes))


@dataclass(frozen=True)
class Batch:
    """rgb (B,3,H,W) float in [0,1]; depth (B,1,H,W) float32 mm, 0 = none; lens (B,4) fx fy cx cy px or None."""

    rgb: Tensor
    depth: Tensor
    lens: Tensor | None

    def to(self, device: torch.device) -> "Batch":
        """On a device, channels last."""
        lens = None if self.lens is None else self.lens.to(device)
        rgb = self.rgb.to(device).contiguous(memory_format=torch.channels_last)
        return Batch(rgb, self.depth.to(device).contiguous(), lens)


def joined(batches: list[Batch]) -> Batch:
    """One batch of several, of frames of one size; without lenses unless all have them."""
    lenses = [batch.lens for batch in batches if batch.lens is not None]
    lens = torch.cat(lenses) if len(lenses) == len(batches) else None
    return Batch(torch.cat([b.rgb for b in batches]), torch.cat([b.depth for b in batches]), lens)


def augment(batch: Batch, generator: torch.Generator) -> Batch:
    """Flips, transpositions and enlarged parts of image, depth and lens; colours and noise of the image only."""
    rgb, depth, lens = batch.rgb, batch.depth, batch.lens
    height, width = rgb.shape[2:]
    flip = uniform_draws((3,), on_host(generator)) < 0.5
    for dim, centre, side in ((2, 3, height), (3, 2, width)):
        if flip[dim - 2]:
            rgb, depth = rgb.flip(dim), depth.flip(dim)
            if lens is not None:
                lens = lens.clone()
                lens[:, centre] = side - lens[:, centre]
    if flip[2] and height == width:
        rgb, depth = rgb.transpose(2, 3), depth.transpose(2, 3)
        lens = None if lens is None else lens.view(-1, 2, 2).flip(2).view(-1, 4)
    rgb, depth, lens = _zoomed(rgb, depth, lens, generator)
    return Batch(_recolour(rgb, generator), depth.contiguous(), lens)


def _zoomed(
    rgb: Tensor, depth: Tensor, lens: Tensor | None, generator: torch.Generator
) -> tuple[Tensor, Tensor, Tensor | None]:
    """In half of the batches a part of the image, up to 1.6 times enlarged: structures of other sizes in pixels."""
    chance, amount, down, right = uniform_draws((4,), on_host(generator)).tolist()
    if chance < 0.5:
        return rgb, depth, lens
    height, width = rgb.shape[2:]
    zoom = 1 + 0.6 * amount
    rows, columns = round(height / zoom), round(width / zoom)
    top, left = round(down * (height - rows)), round(right * (width - columns))
    part = (..., slice(top, top + rows), slice(left, left + columns))
    rgb = F.interpolate(rgb[part], size=(height, width), mode="bilinear", align_corners=False)
    depth = F.interpolate(depth[part], size=(height, width), mode="nearest-exact")
    if lens is not None:
        corner, scale = torch.tensor([[0, 0, left, top], [width / columns, height / rows] * 2])
        lens = (lens - moved(corner, lens.device)) * moved(scale, lens.device)
    return rgb, depth, lens


def _recolour(rgb: Tensor, generator: torch.Generator) -> Tensor:
    batch = len(rgb)

    def draw(low: float, high: float, channels: int = 1) -> Tensor:
        return low + (high - low) * uniform_draws((batch, channels, 1, 1), generator).to(rgb.device)

    rgb = rgb.clamp_min(1e-4) ** draw(0.7, 1.4) * draw(0.85, 1.35) * draw(0.85, 1.15, 3)
    grey = rgb.mean(1, keepdim=True)
    rgb = grey + (rgb - grey) * draw(0.3, 1.5) + draw(0, 0.05)
    rgb = rgb + draw(0, 0.02) * normal_draws(rgb.shape, generator).to(rgb.device)
    return rgb.clamp(0, 1)
