"""Blocks along a depth image's truncation band, against all of its points."""

import numpy as np
import pytest

from reconstruction.fusion.band_points import band_points
from reconstruction.fusion.tsdf import SurfaceFusion, TsdfSettings

SIDE, FOCAL = 160, 80.0
CENTRED = np.array([[FOCAL, 0, (SIDE - 1) / 2], [0, FOCAL, (SIDE - 1) / 2], [0, 0, 1]])


def tube_depth(farthest):
    """z-depth (H,W) of a tube of radius 1 along the view: ever more slanted towards its far end."""
    x, y = (np.mgrid[:SIDE, :SIDE] - (SIDE - 1) / 2) / FOCAL
    z = 1 / np.hypot(x, y)
    return np.where(z < farthest, z, 0).astype(np.float32)


def blocks_of(points, edge):
    """Blocks that points (...,3) lie in, a whole number each."""
    cells = np.floor(points / edge).astype(np.int64) + 2**20
    return np.unique((cells[..., 0] << 42) + (cells[..., 1] << 21) + cells[..., 2])


def touching(points, edge):
    """Blocks that points lie on the face of, to single precision."""
    corners = 1e-5 * np.array([[i, j, k] for i in (-1, 1) for j in (-1, 1) for k in (-1, 1)])
    return np.unique(np.concatenate([blocks_of(points + corner, edge) for corner in corners]))


@pytest.mark.parametrize("seed", [0, *(pytest.param(seed, marks=pytest.mark.slow) for seed in (1, 2))])
def test_blocks_are_those_of_every_point_of_the_band(seed):
    rng = np.random.default_rng(seed)
    depth = tube_depth(5.0) * (rng.random((SIDE, SIDE)) > 0.2).astype(np.float32)
    world_from_camera = np.eye(4)
    world_from_camera[:3, :3] = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    world_from_camera[:3, 3] = rng.normal(size=3)
    reach, edge = 0.1, 0.2
    rows, columns = np.nonzero(depth)
    rays = np.stack([columns, rows, np.ones_like(rows)]).T @ np.linalg.inv(CENTRED).T @ world_from_camera[:3, :3].T
    steps = np.linspace(-reach, reach, 101)  # far finer than a block
    along = depth[rows, columns].astype(np.float64)[:, None] + steps
    every = along[..., None] * rays[:, None] + world_from_camera[:3, 3]
    found = band_points(depth, CENTRED, world_from_camera, reach, edge)
    mine, theirs = blocks_of(found, edge), blocks_of(every, edge)
    assert np.isin(mine, touching(every, edge)).all()
    assert np.isin(theirs, mine, invert=True).mean() <= 0.02  # corners of blocks that a ray cuts
    assert len(found) < 0.02 * every[..., 0].size


def test_no_depth_has_no_block():
    assert band_points(np.zeros((4, 5), np.float32), np.eye(3), np.eye(4), 0.1, 0.2).shape == (0, 3)


def test_far_wall_seen_at_a_slant_has_no_holes():
    """From z = 3 to 4 the tube's wall is seen at 72 to 76 degrees from its normal, within the limit of 80."""
    fusion = SurfaceFusion(TsdfSettings(voxel_size=0.04, truncation=5.0))
    rgb = np.full((SIDE, SIDE, 3), 128, np.uint8)
    intrinsics = CENTRED.copy()
    intrinsics[:2, 2] += 0.5
    fusion.integrate(rgb, tube_depth(5.0), None, intrinsics, np.eye(4))
    mesh = fusion.extract()
    middle = mesh.vertices[mesh.faces].mean(axis=1)[:, 2]
    area = mesh.face_areas[(middle > 3) & (middle < 4)].sum()
    assert area == pytest.approx(2 * np.pi, rel=0.05)
