"""Rays from inside the lumen to its wall."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from reconstruction.mesh.open3d_import import import_open3d, ray_scene
from reconstruction.mesh.surface_mesh import SurfaceMesh

Array = NDArray[np.float64]


class WallRays:
    """Ray casting against a mesh of which only front faces, seen from the lumen's side, count as wall."""

    def __init__(self, mesh: SurfaceMesh) -> None:
        self._core = import_open3d().core
        self._scene = ray_scene(mesh.vertices, mesh.faces)

    def distance(self, origins: Array, directions: Array) -> Array:
        """Distance (...) along unit rays (...,3) to the wall; infinite where the first hit is a back face or none."""
        rays = np.concatenate(np.broadcast_arrays(origins, directions), axis=-1).astype(np.float32)
        answer: dict[str, Any] = self._scene.cast_rays(self._core.Tensor(rays))
        inner = np.sum(answer["primitive_normals"].numpy() * rays[..., 3:], axis=-1) < 0
        return np.where(inner, answer["t_hit"].numpy(), np.inf).astype(np.float64)
