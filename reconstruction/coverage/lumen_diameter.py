"""Median diameter of the lumen along the camera's path: the one length in a colonoscopy that is roughly known."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from reconstruction.mesh.open3d_import import import_open3d, ray_scene

DIRECTIONS = 72  # rays of a cross-section
MIN_HITS = 0.7  # share of them that must meet the surface for a station to count
MAX_CAMERAS = 400  # along the path; more would measure the same cross-sections again
MIN_CHORD = 0.25  # of `reach`; below, the camera stands still and its viewing direction is the path's


@dataclass(frozen=True)
class LumenWidth:
    """Diameter of the lumen, and how many stations it rests on."""

    diameter: float  # median over stations, mesh unit
    stations: int  # that were measured
    tried: int  # stations in all


def measure_lumen(
    vertices: NDArray[np.float64],
    faces: NDArray[np.int64],
    world_from_camera: NDArray[np.float64],
    reach: float,
) -> LumenWidth | None:
    """Median diameter across the path of the cameras (N,4,4) in a mesh (V,3), (F,3); None if nothing surrounds it.

    At each camera centre, and `reach` ahead of it, rays are cast square to the path. Where enough of them meet the
    surface they bound a polygon (gaps are bridged), and the station's diameter is that of the circle of its area, so
    that it does not depend on where in the lumen the camera is. `reach` (mesh unit) also is the chord over which the
    path's direction is taken, so that wobble does not turn it.
    """
    o3d = import_open3d()
    scene = ray_scene(vertices, faces)
    step = -(-len(world_from_camera) // MAX_CAMERAS)
    origins, axes = _stations(world_from_camera[::step], reach)
    angles = np.arange(DIRECTIONS) * 2 * np.pi / DIRECTIONS
    first, second = _square_to(axes)
    rays = np.cos(angles)[None, :, None] * first[:, None] + np.sin(angles)[None, :, None] * second[:, None]
    packed = np.concatenate([np.broadcast_to(origins[:, None], rays.shape), rays], axis=2)
    radius = scene.cast_rays(o3d.core.Tensor(packed.astype(np.float32)))["t_hit"].numpy()
    enough = np.isfinite(radius).mean(axis=1) >= MIN_HITS
    if not enough.any():
        return None
    diameters = [_diameter(angles, r) for r in radius[enough].astype(np.float64)]
    return LumenWidth(float(np.median(diameters)), int(enough.sum()), len(enough))


def _diameter(angles: NDArray[np.float64], radius: NDArray[np.float64]) -> float:
    """Diameter of the circle of a cross-section's area; radii (K,) at `angles` (K,), infinite ones interpolated."""
    hit = np.isfinite(radius)
    filled = np.interp(angles, angles[hit], radius[hit], period=2 * np.pi)
    area = 0.5 * np.sin(angles[1] - angles[0]) * float(filled @ np.roll(filled, 1))
    return 2 * float(np.sqrt(area / np.pi))


def _stations(world_from_camera: NDArray[np.float64], reach: float) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Origins (S,3) and unit axes (S,3): every camera centre, and the point `reach` ahead of it along the path."""
    centres = world_from_camera[:, :3, 3]
    gaps = np.linalg.norm(centres[:, None] - centres[None], axis=2)
    forward = world_from_camera[:, :3, 2]
    axes = np.empty_like(centres)
    for i in range(len(centres)):
        # The nearest frames on either side that are half the chord away; the view's direction where there are none.
        before = np.flatnonzero(gaps[i, :i] >= reach / 2)
        after = i + np.flatnonzero(gaps[i, i:] >= reach / 2)
        start = before[-1] if len(before) else i
        end = after[0] if len(after) else i
        chord = centres[end] - centres[start]
        axes[i] = chord if np.linalg.norm(chord) > MIN_CHORD * reach else forward[i]
    axes /= np.linalg.norm(axes, axis=1, keepdims=True)
    axes *= np.where(np.einsum("ij,ij->i", axes, forward) < 0, -1, 1)[:, None]
    return np.concatenate([centres, centres + reach * axes]), np.concatenate([axes, axes])


def _square_to(axes: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Two unit vectors square to each axis and to each other, (S,3) each."""
    helper = np.eye(3)[np.abs(axes).argmin(axis=1)]
    first = np.cross(axes, helper)
    first /= np.linalg.norm(first, axis=1, keepdims=True)
    return first, np.cross(axes, first)
