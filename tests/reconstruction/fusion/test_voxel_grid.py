"""Marching over voxel blocks slab by slab gives the mesh of all at once."""

from itertools import pairwise

import numpy as np
import pytest
import trimesh

from reconstruction.fusion import voxel_grid
from reconstruction.fusion.voxel_grid import VOXELS_PER_BLOCK, VoxelGrid
from reconstruction.fusion.voxel_integration import COLOUR_STEPS

SIZE = 0.1


def bumpy_ball(steps=0, seed=0, radius=1.4):
    """A grid with the signed distance to a bumpy ball, in truncations, and colours that vary. steps: that a truncation
    is rounded to, so that the surface goes through many voxels."""
    rng = np.random.default_rng(seed)
    grid = VoxelGrid(SIZE)
    points = rng.uniform(-1.9, 1.9, (40_000, 3)).astype(np.float32)
    rows, origins = grid.touch(points)
    places = origins[:, None] + grid.offsets_in_block
    distance = np.linalg.norm(places, axis=2) - radius - 0.1 * np.sin(places @ [3.0, 5.0, 4.0])
    tsdf = np.clip(distance / 0.4, -1, 1)
    grid.channel("tsdf")[rows, :, 0] = np.rint(tsdf * steps) / steps if steps else tsdf
    grid.channel("colour")[rows] = np.rint((120 + 100 * np.sin(places)) * COLOUR_STEPS)
    return grid


@pytest.fixture(scope="module", params=[0, 4])
def grid(request):
    return bumpy_ball(request.param)


@pytest.mark.parametrize("at_once", [1, 40, 100])
@pytest.mark.parametrize("holes", [0.0, 0.01])
def test_slabs_give_the_mesh_of_all_blocks_at_once(monkeypatch, grid, at_once, holes):
    usable = np.random.default_rng(1).uniform(size=(grid.blocks, VOXELS_PER_BLOCK)) >= holes
    monkeypatch.setattr(voxel_grid, "MARCHED", 10**9)
    whole = grid.march(usable)
    monkeypatch.setattr(voxel_grid, "MARCHED", at_once)
    parts = grid.march(usable)
    assert len(list(voxel_grid._slabs(np.repeat(np.arange(-3, 4), 30)))) == {1: 7, 40: 6, 100: 3}[at_once]
    for expected, found in zip(whole, parts, strict=True):
        np.testing.assert_array_equal(found, expected)


def test_a_ball_in_slabs_is_closed(monkeypatch, grid):
    monkeypatch.setattr(voxel_grid, "MARCHED", 1)
    vertices, faces, _ = grid.march(np.ones((grid.blocks, VOXELS_PER_BLOCK), bool))
    mesh = trimesh.Trimesh(vertices, faces, process=False)
    assert mesh.is_watertight
    assert mesh.volume == pytest.approx(4 / 3 * np.pi * 1.4**3, rel=0.05)


def test_slabs_hold_every_layer_once():
    layers = np.repeat([-5, -4, 0, 1, 2], [3, 3, 1, 9, 1])
    slabs = list(voxel_grid._slabs(layers))
    assert slabs[0][0] == -5
    assert slabs[-1][1] == 2
    assert all(end + 1 == begin for (_, end), (begin, _) in pairwise(slabs))


def test_nothing_usable_is_no_mesh(grid):
    vertices, faces, colours = grid.march(np.zeros((grid.blocks, VOXELS_PER_BLOCK), bool))
    assert vertices.shape == faces.shape == colours.shape == (0, 3)
