"""Rendering: shaded images of a mesh by ray casting, without window or OpenGL, the same pixels on every machine."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from haustra.core.errors import ReconstructionError
from reconstruction.mesh.open3d_import import import_open3d, ray_scene
from reconstruction.mesh.surface_mesh import SurfaceMesh

Floats = NDArray[np.float32]

SUBPIXELS = ((-0.25, -0.25), (0.25, -0.25), (-0.25, 0.25), (0.25, 0.25))  # px; ray offsets averaged for antialiasing
TWO_SUBPIXELS = (SUBPIXELS[0], SUBPIXELS[3])  # half the time, for pictures beside which there is the mesh itself
AMBIENT = 0.2  # share of the shading that does not depend on the normal
KEY_LIGHT = np.array([-0.37, -0.57, -0.73])  # unit vector towards the light, camera axes: over the left shoulder
OUTER_WALL = np.array([232, 220, 208], np.float32)  # sRGB, plaster, of the side that no camera looked at
WHITE = 255
BRIGHT = 240  # grey level that `brightened` puts the 95th percentile of the brightest channel at
CHUNK = 65_536  # rays cast and shaded in one go: some twenty megabytes
MAX_LAYERS = 24  # back faces that one ray passes in a cut-away image before it is given up
RAY_OFFSET = 1e-5  # relative step past a face, so that the next cast does not meet it again
TURNED_FOR = 1.2  # times as much of the lumen's side, for which a view is taken that is not the preferred one
FRAME_MARGIN = 1.06  # image extent over object extent in the automatic view


def render_mesh(
    mesh: SurfaceMesh,
    world_from_camera: NDArray[np.float64] | None = None,
    width: int = 960,
    height: int = 720,
    fov_deg: float = 40.0,
    cut_away: bool = False,
    colours: NDArray[np.uint8] | None = None,
    subpixels: Sequence[tuple[float, float]] = SUBPIXELS,
) -> NDArray[np.uint8]:
    """Shaded image (height, width, 3) uint8 on white; `fov_deg` is the angle across the wider side.

    Without `world_from_camera` (4,4) the camera stands outside, square to the mesh's long axis. The lumen's side
    shows `colours` (V,3) sRGB, by default the mesh's own brightened; the outer side is plaster. With `cut_away`, back
    faces are transparent, so that the image looks into the opened lumen. subpixels: a pixel's rays, px off its centre.
    """
    if not len(mesh.faces):
        raise ReconstructionError("a mesh without faces cannot be drawn")
    if world_from_camera is None:
        world_from_camera = outside_view(mesh, width, height, fov_deg)
    paint = brightened(mesh.colours) if colours is None else colours.astype(np.float32)
    scene, normals = ray_scene(mesh.vertices, mesh.faces), mesh.normals.astype(np.float32)
    total = np.zeros((height * width, 3), np.float32)
    for shift in subpixels:
        directions = _pixel_directions(width, height, fov_deg, shift)
        for part in (slice(first, first + CHUNK) for first in range(0, len(directions), CHUNK)):
            some, seen = directions[part], total[part]
            face, share = _cast(scene, world_from_camera, some, cut_away)
            met = face >= 0
            seen[~met] += WHITE
            seen[met] += _shade(mesh.faces[face[met]], normals, paint, share[met], some[met], world_from_camera)
    return np.rint(total / len(subpixels)).astype(np.uint8).reshape(height, width, 3)


def outside_view(mesh: SurfaceMesh, width: int, height: int, fov_deg: float) -> NDArray[np.float64]:
    """`world_from_camera` (4,4) that shows all of a mesh, longest axis across the wider side of the image.

    Of four such views, a quarter turn apart, the one that shows most of the lumen's side: wall that was seen on one
    side alone would show its back, or nothing where back faces are transparent.
    """
    centre = (mesh.vertices.min(axis=0) + mesh.vertices.max(axis=0)) / 2
    axes = np.linalg.eigh(np.cov(mesh.vertices.T))[1][:, ::-1].T  # longest first
    long_axis, second_axis = (axis * np.sign(axis[np.abs(axis).argmax()]) for axis in axes[:2])
    third_axis = np.cross(long_axis, second_axis)
    turns = (second_axis, third_axis, -second_axis, -third_axis)
    views = [(long_axis, across) if width >= height else (across, long_axis) for across in turns]
    right, down = views[clearest_view(mesh, np.cross(*np.transpose(views, (1, 0, 2))))]
    world_from_camera = np.eye(4)
    world_from_camera[:3, :3] = np.column_stack([right, down, np.cross(right, down)])
    x, y, z = ((mesh.vertices - centre) @ world_from_camera[:3, :3]).T
    half = np.tan(np.radians(fov_deg) / 2) / FRAME_MARGIN * np.array([width, height]) / max(width, height)
    distance = np.max(np.maximum(np.abs(x) / half[0], np.abs(y) / half[1]) - z)
    world_from_camera[:3, 3] = centre - distance * world_from_camera[:3, 2]
    return world_from_camera


def clearest_view(mesh: SurfaceMesh, forward: NDArray[np.float64]) -> int:
    """Row of the direction of view (N,3), preferred ones first, in which most of the lumen's side faces a camera far
    away, by apparent area; a later one must show `TURNED_FOR` times as much. What hides a face does not count."""
    shown = np.maximum(-(mesh.area_vectors @ forward.T), 0).sum(axis=0)
    best = 0
    for row in range(1, len(shown)):
        if shown[row] > TURNED_FOR * shown[best]:
            best = row
    return best


def brightened(colours: NDArray[np.uint8]) -> Floats:
    """Colours (V,3) scaled so that the 95th percentile of the brightest channel is `BRIGHT`: far walls are dark."""
    gain = max(1.0, BRIGHT / max(1.0, float(np.percentile(colours.max(axis=1), 95))))
    return np.minimum(colours * np.float32(gain), WHITE)


def _pixel_directions(width: int, height: int, fov_deg: float, shift: tuple[float, float]) -> Floats:
    """Unit directions (H*W,3), camera axes, through the pixels' centres moved by `shift` pixels."""
    focal = max(width, height) / 2 / np.tan(np.radians(fov_deg) / 2)
    x = (np.arange(width) + 0.5 + shift[0] - width / 2) / focal
    y = (np.arange(height) + 0.5 + shift[1] - height / 2) / focal
    direction = np.ones((height, width, 3), np.float32)
    direction[..., 0], direction[..., 1] = x, y[:, None]
    return (direction / np.linalg.norm(direction, axis=-1, keepdims=True)).reshape(-1, 3)


def _cast(
    scene: Any, world_from_camera: NDArray[np.float64], directions: Floats, cut_away: bool
) -> tuple[NDArray[np.int64], Floats]:
    """First face (N,) that each ray hits, -1 for none, and the hit's barycentric weights (N,3).

    directions (N,3) in camera axes. With `cut_away`, rays pass through back faces.
    """
    rays = np.empty((len(directions), 6), np.float32)
    rays[:, :3], rays[:, 3:] = world_from_camera[:3, 3], directions @ world_from_camera[:3, :3].T
    face, share = np.full(len(rays), -1), np.zeros((len(rays), 3), np.float32)
    pending = np.arange(len(rays))
    for _ in range(MAX_LAYERS if cut_away else 1):
        answer = {name: value.numpy() for name, value in scene.cast_rays(import_open3d().core.Tensor(rays)).items()}
        met = np.isfinite(answer["t_hit"])
        done = met & (np.sum(answer["primitive_normals"] * rays[:, 3:], axis=1) < 0) if cut_away else met
        face[pending[done]] = answer["primitive_ids"][done]
        u, v = answer["primitive_uvs"][done].T
        share[pending[done]] = np.stack([1 - u - v, u, v], axis=1)
        onward = met & ~done
        if not onward.any():
            break
        pending, rays = pending[onward], rays[onward]
        rays[:, :3] += answer["t_hit"][onward, None] * (1 + RAY_OFFSET) * rays[:, 3:]
    return face, share


def _shade(
    corners: NDArray[np.int64],
    normals: Floats,
    paint: Floats,
    share: Floats,
    direction: Floats,
    world_from_camera: NDArray[np.float64],
) -> Floats:
    """Shaded colour (N,3) of hits between vertices `corners` (N,3) at barycentric `share` (N,3) along `direction` (N,3,
    camera axes); normals, paint (V,3): of all vertices."""
    normal = np.einsum("nc,nci->ni", share, normals[corners]) @ world_from_camera[:3, :3]
    normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-12)
    facing = -np.sum(normal * direction, axis=1, keepdims=True)
    colour = np.where(facing > 0, np.einsum("nc,nci->ni", share, paint[corners]), OUTER_WALL)
    # Half-Lambert: the cosine is mapped to [0,1], so that faces turned away still show relief.
    key = 0.5 + 0.5 * np.sign(facing) * (normal @ KEY_LIGHT)[:, None]
    return colour * (AMBIENT + (1 - AMBIENT) * (0.5 * np.abs(facing) + 0.5 * key))
