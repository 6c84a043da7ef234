"""Points in a tube, poses, and what a pinhole sees of them."""

import numpy as np
from scipy.spatial.transform import Rotation

from haustra.core.camera import Camera
from haustra.core.se3 import inverse
from pipeline.frontend.odometry.two_view import TwoViewRays

PINHOLE = Camera("PINHOLE", 320, 320, (160.0, 160.0, 160.0, 160.0))
FOCAL = 160.0


def tube(count, rng, radius=20.0):
    angle, height = rng.uniform(0, 2 * np.pi, count), rng.uniform(15, 90, count)
    return np.stack([radius * np.cos(angle), radius * np.sin(angle), height], axis=1)


def camera_from_world_at(turn_deg, centre):
    """Of a camera at `centre`."""
    world_from_camera = np.eye(4)
    world_from_camera[:3, :3] = Rotation.from_euler("xyz", turn_deg, degrees=True).as_matrix()
    world_from_camera[:3, 3] = centre
    return inverse(world_from_camera)


def on_plane(camera_from_world, points):
    local = points @ camera_from_world[:3, :3].T + camera_from_world[:3, 3]
    return local[:, :2] / local[:, 2:], local[:, 2]


def jacobians(count):
    return np.tile(FOCAL * np.eye(2), (count, 1, 1))


def sight(camera_from_world, points, rng=None, noise_px=0.0):
    seen = on_plane(camera_from_world, points)[0]
    if rng is not None:
        seen = seen + rng.normal(0, noise_px / FOCAL, seen.shape)
    return TwoViewRays(seen, jacobians(len(seen)))
