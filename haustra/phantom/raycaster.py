"""Ray casting against a triangle mesh, by Open3D's Embree.

Open3D is imported on first use: it takes a second and most of the package does without it.
"""

from __future__ import annotations

import ctypes
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float32]


@cache
def _open3d() -> Any:
    """The open3d module, with libusb of `libusb-package` loaded first, which Open3D needs at import."""
    import libusb_package

    ctypes.CDLL(str(libusb_package.get_library_path()), mode=ctypes.RTLD_GLOBAL)
    import open3d

    return open3d


@dataclass(frozen=True)
class Hits:
    """First surface along each ray; arrays share the rays' leading shape. A miss has an infinite length."""

    length: Floats  # mm along the unit direction
    triangle: NDArray[np.uint32]  # index into the mesh's triangles
    bary: Floats  # (..., 2) weights of the triangle's second and third corner

    @property
    def valid(self) -> NDArray[np.bool_]:
        """Rays that hit the mesh."""
        return np.isfinite(self.length)


class RayCaster:
    """Ray casting, occlusion, crossings and nearest points of vertices (V,3) float32 mm, triangles (F,3) int."""

    def __init__(self, vertices: NDArray[Any], triangles: NDArray[Any], threads: int = 0) -> None:
        """`threads` 0 uses every core; worker processes pass 1."""
        o3d = _open3d()
        self._tensor = o3d.core.Tensor.from_numpy
        self._scene = o3d.t.geometry.RaycastingScene(nthreads=threads)
        self._threads = threads
        self._scene.add_triangles(
            self._tensor(np.ascontiguousarray(vertices, np.float32)),
            self._tensor(np.ascontiguousarray(triangles, np.uint32)),
        )

    def cast(self, origins: NDArray[Any], directions: NDArray[Any]) -> Hits:
        """Rays with origins and unit directions (...,3), broadcast against each other, to first hits."""
        answer = self._scene.cast_rays(self._pack(origins, directions), nthreads=self._threads)
        return Hits(answer["t_hit"].numpy(), answer["primitive_ids"].numpy(), answer["primitive_uvs"].numpy())

    def blocked(self, origins: NDArray[Any], directions: NDArray[Any], reach: float) -> NDArray[np.bool_]:
        """Whether a ray meets the mesh within `reach` times its direction's norm."""
        rays = self._pack(origins, directions)
        return self._scene.test_occlusions(rays, tfar=reach, nthreads=self._threads).numpy()

    def crossings(self, origins: NDArray[Any], targets: NDArray[Any]) -> NDArray[np.int64]:
        """Number (...) of triangles that each segment from origins to targets (...,3) crosses."""
        rays = self._pack(origins, targets - origins)
        beyond = self._pack(targets, targets - origins)
        all_along, behind = (self._scene.count_intersections(r, nthreads=self._threads).numpy() for r in (rays, beyond))
        return all_along.astype(np.int64) - behind

    def nearest(self, points: NDArray[Any]) -> tuple[Floats, NDArray[np.uint32]]:
        """Closest surface point (N,3) mm to each of points (N,3), and its triangle (N,)."""
        query = self._tensor(np.ascontiguousarray(points, np.float32))
        answer = self._scene.compute_closest_points(query, nthreads=self._threads)
        return answer["points"].numpy(), answer["primitive_ids"].numpy()

    def _pack(self, origins: NDArray[Any], directions: NDArray[Any]) -> Any:
        rays = np.empty((*np.broadcast_shapes(origins.shape, directions.shape)[:-1], 6), np.float32)
        rays[..., :3], rays[..., 3:] = origins, directions
        return self._tensor(rays)
