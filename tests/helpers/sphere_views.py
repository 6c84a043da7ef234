"""Depth maps of a sphere seen from inside, and their fusion."""

import numpy as np
from scipy.spatial.transform import Rotation

from reconstruction.fusion.tsdf import SurfaceFusion, TsdfSettings

SIZE = 120
INTRINSICS = np.array([[60.0, 0, 60.0], [0, 60.0, 60.0], [0, 0, 1]])  # COLMAP's pixel centres: symmetric
RED = np.full((SIZE, SIZE, 3), [200, 40, 30], np.uint8)
RADIUS = 20.0
VOXEL = 0.7


def pixel_rays(intrinsics=INTRINSICS):
    """Points (H,W,3) at z-depth 1 through the pixels' centres, which lie at half integers."""
    x, y = np.meshgrid(np.arange(SIZE) + 0.5, np.arange(SIZE) + 0.5)
    return np.stack([x, y, np.ones_like(x)], axis=-1) @ np.linalg.inv(intrinsics).T


def sphere_depth(world_from_camera, radius=RADIUS):
    """z-depth (H,W) of a sphere about the origin, seen from inside."""
    rays = pixel_rays() @ world_from_camera[:3, :3].T
    squared, along = np.sum(rays**2, axis=-1), rays @ world_from_camera[:3, 3]
    root = np.sqrt(along**2 - squared * (world_from_camera[:3, 3] @ world_from_camera[:3, 3] - radius**2))
    return ((root - along) / squared).astype(np.float32)


def views(count=10, seed=0):
    """Poses near the sphere's centre that look all around."""
    rng = np.random.default_rng(seed)
    poses = np.tile(np.eye(4), (count, 1, 1))
    poses[:, :3, :3] = Rotation.random(count, rng=rng).as_matrix()
    poses[:, :3, 3] = rng.uniform(-4, 4, (count, 3))
    return poses


def fuse(poses, depths, confidences=None, rgb=RED, intrinsics=INTRINSICS, **settings):
    fusion = SurfaceFusion(TsdfSettings(**{"voxel_size": VOXEL, "truncation": 5.0, **settings}))
    for number, (world_from_camera, depth) in enumerate(zip(poses, depths, strict=True)):
        fusion.integrate(
            rgb, depth, None if confidences is None else confidences[number], intrinsics, world_from_camera
        )
    return fusion.extract()
