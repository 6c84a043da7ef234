"""Sparse voxel blocks: Open3D's hash map finds them, NumPy holds their values, Open3D marches over them.

Voxel (i,j,k) lies at (i,j,k) times the voxel size in world axes. A block is 8x8x8 voxels; its row in every channel
is the same, with x running fastest. The values live outside Open3D's hash map because it copies them one by one
whenever it grows (0.1-0.2 ms a block).

Means of colour and confidence are kept as integers in small steps: of a long film's voxels they are the larger part.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from haustra.core.errors import ReconstructionError
from reconstruction.fusion.voxel_integration import COLOUR_STEPS
from reconstruction.mesh.open3d_import import import_open3d

BLOCK = 8  # voxels along a block's edge; 16 touches twice the voxels for the same surface
VOXELS_PER_BLOCK = BLOCK**3
FIRST_CAPACITY = 1024  # blocks allocated at first
GROWTH = 1.5  # factor on the capacity when it is exceeded
MARCHED = 4096  # blocks of a slab, about: 74 MiB, and those of the layer after it
MAX_BLOCK_INDEX = 2**19  # along an axis, so that a block's three indices pack into 64 bits

Values = NDArray[Any]
Mesh = tuple[NDArray[np.float64], NDArray[np.int64], NDArray[np.float32]]  # vertices, faces, colours

# Type and number of the values of a voxel: 18 bytes.
CHANNELS = {
    "tsdf": (np.float32, 1),
    "colour": (np.uint16, 3),
    "evidence": (np.float32, 1),
    "confidence": (np.uint16, 1),
    "observations": (np.uint16, 1),
}
LOCATED = 100_000  # vertices whose voxels are looked up in one go: some twenty megabytes


@dataclass(frozen=True)
class EdgeVoxels:
    """The two voxels between which marching cubes put each vertex, as rows of flattened channels."""

    low: NDArray[np.int64]  # (V,)
    high: NDArray[np.int64]  # (V,)
    share_of_high: NDArray[np.float32]  # (V,) 0 at the low voxel, 1 at the high one

    def interpolate(self, channel: Values) -> NDArray[np.float32]:
        """Linear interpolation of a flattened channel (voxels,), in its steps, at the vertices (V,)."""
        low, high = channel[self.low].astype(np.float32), channel[self.high].astype(np.float32)
        return low * (1 - self.share_of_high) + high * self.share_of_high


class VoxelGrid:
    """Voxels that exist only near observed surface, on the CPU; 9 KiB a block."""

    def __init__(self, voxel_size: float) -> None:
        self._open3d = import_open3d()
        self._core = self._open3d.core
        self.voxel_size = voxel_size
        self.blocks = 0  # in use
        self._row_of_block = self._core.HashMap(FIRST_CAPACITY, self._core.int32, (3,), self._core.int64, (1,))
        self._channels: dict[str, Values] = {
            name: np.zeros((FIRST_CAPACITY, VOXELS_PER_BLOCK, width), kind) for name, (kind, width) in CHANNELS.items()
        }
        axis = np.arange(BLOCK, dtype=np.float32)
        z, y, x = np.meshgrid(axis, axis, axis, indexing="ij")
        self.offsets_in_block = np.stack([x, y, z], axis=-1).reshape(-1, 3) * np.float32(voxel_size)

    def touch(self, points: NDArray[np.float32]) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
        """Allocate the blocks that hold world points (N,3): their rows (B,), their first voxels' positions (B,3)."""
        position = points * np.float32(1 / (BLOCK * self.voxel_size))
        if np.abs(position).max() > MAX_BLOCK_INDEX:
            farthest = np.abs(points).max()
            raise ReconstructionError(
                f"a point lies {farthest:.3g} from the origin, far too many voxels of {self.voxel_size:.3g}; "
                "do the depth, the poses and the voxel size share one unit?"
            )
        block = np.floor(position).astype(np.int32)
        first = block.min(axis=0)
        extent = (block.max(axis=0) - first).astype(np.int64) + 1
        packed = np.unique(np.ravel_multi_index(tuple((block - first).T), tuple(extent)))
        block = np.stack(np.unravel_index(packed, tuple(extent)), axis=1).astype(np.int32) + first
        keys = self._core.Tensor(block)
        self._add(keys[self._row_of_block.find(keys)[1].logical_not()])
        return self._rows(keys)[0], block * (BLOCK * self.voxel_size)

    def channel(self, name: str) -> Values:
        """The memory of a channel, (blocks, 512, C), to read and write; fetch it anew after each `touch`. Colour and
        confidence in steps of `COLOUR_STEPS` and `CONFIDENCE_STEPS`."""
        return self._channels[name][: self.blocks]

    def flat_channel(self, name: str) -> Values:
        """The memory of a channel of one value per voxel, (blocks * 512,)."""
        return self.channel(name).reshape(-1)

    def march(self, usable: NDArray[np.bool_]) -> Mesh:
        """Marching cubes: zero level of the tsdf in cells whose eight corners are all `usable` (blocks, 512).

        Slab by slab along the longest axis, since Open3D holds 18 KiB beside the 9 of a block while it marches.
        Returns vertices (V,3) in world units, faces (F,3) wound towards positive tsdf, colours (V,3) 0..255.
        """
        if not usable.any():
            return _no_mesh()
        slots = self._row_of_block.active_buf_indices().to(self._core.int64)
        keys = self._row_of_block.key_tensor()[slots].numpy()
        rows = self._row_of_block.value_tensor()[slots].numpy()[:, 0]
        axis = int(np.ptp(keys, axis=0).argmax())
        count, parts = 0, []
        for first, last in _slabs(keys[:, axis]):
            inside = (keys[:, axis] >= first) & (keys[:, axis] <= last + 1)
            is_next = keys[inside, axis] == last + 1
            vertices, faces, colours = self._march_slab(keys[inside], rows[inside], usable, is_next, axis)
            parts.append((vertices, faces + count, colours))
            count += len(vertices)
        vertices, faces, colours = (np.concatenate(of) for of in zip(*parts, strict=True))
        return _in_order(vertices, faces, colours)

    def _march_slab(
        self,
        keys: NDArray[np.int32],
        rows: NDArray[np.int64],
        usable: NDArray[np.bool_],
        is_next: NDArray[np.bool_],
        axis: int,
    ) -> Mesh:
        """Marching cubes over some blocks (B,3), of those that are the next slab's only the cells that end in their
        first layer of voxels."""
        grid = self._empty_open3d_grid(len(keys))
        tensor = self._core.Tensor(np.ascontiguousarray(keys))
        grid.hashmap().activate(tensor)
        theirs = grid.hashmap().find(tensor)[0].numpy()
        tsdf, weight, colour = (
            grid.attribute(name).numpy().reshape(-1, VOXELS_PER_BLOCK, width)
            for name, width in (("tsdf", 1), ("weight", 1), ("color", 3))
        )
        first_layer = self.offsets_in_block[:, axis] == 0
        tsdf[theirs], colour[theirs] = self.channel("tsdf")[rows], self.channel("colour")[rows] / COLOUR_STEPS
        weight[theirs, :, 0] = usable[rows] & (first_layer | ~is_next[:, None])
        mesh = grid.extract_triangle_mesh(weight_threshold=0.5)
        return (
            mesh.vertex.positions.numpy().astype(np.float64),
            mesh.triangle.indices.numpy().astype(np.int64),
            mesh.vertex.colors.numpy() * 255,  # Open3D takes the channel as 0..255 and gives 0..1
        )

    def edge_voxels(self, vertices: NDArray[np.float64]) -> EdgeVoxels:
        """The two neighbouring voxels between which each vertex (V,3) of marching cubes lies on a grid line."""
        begins = range(0, max(1, len(vertices)), LOCATED)
        parts = [self._edge_voxels(vertices[first : first + LOCATED]) for first in begins]
        return EdgeVoxels(*map(np.concatenate, zip(*(vars(part).values() for part in parts), strict=True)))

    def _edge_voxels(self, vertices: NDArray[np.float64]) -> EdgeVoxels:
        position = vertices / self.voxel_size
        off_grid = np.abs(position - np.rint(position))
        along = off_grid.argmax(axis=1)
        every = np.arange(len(vertices))
        low = np.rint(position).astype(np.int64)
        low[every, along] = np.floor(position[every, along])
        high = low.copy()
        high[every, along] += 1
        low_row, low_exists = self._flat_rows(low)
        high_row, high_exists = self._flat_rows(high)
        # Rounding can put a vertex that sits on a voxel just past it, where no neighbour need exist.
        return EdgeVoxels(
            low=np.where(low_exists, low_row, high_row),
            high=np.where(high_exists, high_row, low_row),
            share_of_high=(position[every, along] - low[every, along]).astype(np.float32),
        )

    def _flat_rows(self, voxels: NDArray[np.int64]) -> tuple[NDArray[np.int64], NDArray[np.bool_]]:
        """Rows (V,) of voxels (V,3) in flattened channels, and whether they exist (V,)."""
        block = voxels // BLOCK
        x, y, z = (voxels - block * BLOCK).T
        row, exists = self._rows(self._core.Tensor(block.astype(np.int32)))
        return row * VOXELS_PER_BLOCK + (z * BLOCK + y) * BLOCK + x, exists

    def _rows(self, keys: Any) -> tuple[NDArray[np.int64], NDArray[np.bool_]]:
        """Rows (B,) of blocks given as int32 tensor (B,3), 0 for those that do not exist, and whether they do (B,)."""
        if not len(keys):
            return np.empty(0, np.int64), np.empty(0, bool)
        slots, exists = self._row_of_block.find(keys)
        rows = self._row_of_block.value_tensor().numpy()[:, 0]
        found = exists.numpy()
        return np.where(found, rows[np.where(found, slots.numpy(), 0)], 0), found

    def _add(self, keys: Any) -> None:
        """Allocate new blocks given as an int32 tensor (B,3)."""
        if not len(keys):
            return
        rows = np.arange(self.blocks, self.blocks + len(keys))
        self._grow_to(self.blocks + len(keys))
        self._row_of_block.insert(keys, self._core.Tensor(rows[:, None]))
        self.blocks += len(keys)

    def _grow_to(self, blocks: int) -> None:
        """Reallocate the channels to hold so many blocks or more."""
        capacity = len(self._channels["tsdf"])
        if blocks <= capacity:
            return
        larger = max(blocks, int(GROWTH * capacity))
        for name, old in self._channels.items():  # one channel at a time, so that little memory is held twice
            self._channels[name] = np.zeros((larger, *old.shape[1:]), old.dtype)
            self._channels[name][:capacity] = old

    def _empty_open3d_grid(self, blocks: int) -> Any:
        """An Open3D grid for marching cubes, which reads tsdf, weight and color by these names, as float32."""
        return self._open3d.t.geometry.VoxelBlockGrid(
            attr_names=("tsdf", "weight", "color"),
            attr_dtypes=(self._core.float32,) * 3,
            attr_channels=(1, 1, 3),
            voxel_size=self.voxel_size,
            block_resolution=BLOCK,
            block_count=blocks,
        )


def _no_mesh() -> Mesh:
    return np.empty((0, 3)), np.empty((0, 3), np.int64), np.empty((0, 3), np.float32)


def _slabs(layers: NDArray[np.int32]) -> Iterator[tuple[int, int]]:
    """First and last layer of slabs of about `MARCHED` blocks, one layer at least; layers (B,): of the blocks."""
    lowest = int(layers.min())
    count = np.cumsum(np.bincount(layers - lowest))
    slab = (count - 1) // MARCHED
    edges = np.flatnonzero(np.diff(slab, prepend=-1))
    for begin, end in zip(edges, [*edges[1:], len(count)], strict=True):
        yield lowest + int(begin), lowest + int(end) - 1


def _in_order(vertices: NDArray[np.float64], faces: NDArray[np.int64], colours: NDArray[np.float32]) -> Mesh:
    """The same mesh with vertices and faces sorted, as Open3D's threads number them differently in every run. Vertices
    in one place are one: those in the plane between two slabs, and those of several edges that end in a voxel whose
    tsdf is 0; faces that have two of them are none."""
    order = np.lexsort((*colours.T, *vertices.T))
    vertices, colours = vertices[order], colours[order]
    is_new = np.ones(len(order), dtype=bool)
    is_new[1:] = (vertices[1:] != vertices[:-1]).any(axis=1)
    rank = np.empty_like(order)
    rank[order] = np.cumsum(is_new) - 1
    faces = rank[faces]
    faces = faces[(faces != np.roll(faces, 1, axis=1)).all(axis=1)]
    turn = (faces.argmin(axis=1)[:, None] + np.arange(3)) % 3  # smallest first, winding kept
    faces = np.take_along_axis(faces, turn, axis=1)
    return vertices[is_new], faces[np.lexsort(faces.T)], colours[is_new]
