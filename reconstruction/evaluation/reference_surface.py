"""Reference surface: the part of the true surface that the camera saw, which a reconstruction is measured against.

Protocol. Of every `every`-th frame of an RGB-D folder, each pixel's true depth becomes a world point by the true
world_from_camera; points are thinned to one, the mean, per cube of `spacing_mm`. `seen` keeps them all: a reconstructed
point far from every one of them is wrong. `required` keeps those that came nearer than `max_depth_mm` to a camera: what
was only seen deeper was seen small and at a glancing angle, so building it is right but missing it is no fault. (One
set cut at 60 mm for both would put the precision of a perfect fusion at 86 %.) Even a perfect surface shows an accuracy
of a third of the spacing, the distance to the nearest of such points. A wall that lies askew to the axes passes through
more cubes than one square to them and counts for more: turning run and truth together moved recall by half a point.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from haustra.core.camera import Camera, read_camera
from haustra.core.errors import ReconstructionError
from haustra.core.natural_order import in_natural_order
from haustra.core.text import counted, read_json
from reconstruction.evaluation.surface_metrics import sample_surface
from reconstruction.evaluation.trajectory_io import read_tum
from reconstruction.mesh.mesh_io import read_face_property, read_mesh
from reconstruction.mesh.surface_mesh import SurfaceMesh

Array = NDArray[np.float64]

SPACING_MM = 0.5  # half of the 1 mm at which surfaces are compared; a wider one would cost a perfect surface precision
SAMPLES_PER_CUBE = 8  # random points per cube of a true mesh before thinning, so that hardly a cube is left empty
ALL_TIMES = (-np.inf, np.inf)
FRAMES_PER_THINNING = 16  # frames of points held before they are thinned, which bounds memory


@dataclass(frozen=True)
class ReferenceSurface:
    """Points in mm, world axes of the truth; both sets are the same where depth is not known."""

    seen: Array  # (N,3)
    required: Array  # (M,3)


def read_reference_surface(
    folder: Path | str,
    every: int = 1,
    max_depth_mm: float = 60.0,
    spacing_mm: float = SPACING_MM,
    between_s: tuple[float, float] = ALL_TIMES,
) -> ReferenceSurface:
    """Reference surface of an RGB-D folder: from its depth images, or where it has none from its `mesh.ply`.

    Where the wall moves, all the time or in contractions, depth images show it at many places; the
    reference is then the wall at rest, the mesh.ply. between_s: of frames from the first second to before the last
    alone; a mesh.ply knows no times and is taken whole.
    """
    folder = Path(folder)
    if not has_wall_by_frames(folder):
        return reference_from_mesh(folder / "mesh.ply", max_depth_mm, spacing_mm)
    return reference_from_views(_views(folder, every, between_s), max_depth_mm, spacing_mm)


def has_wall_by_frames(folder: Path) -> bool:
    """Whether the reference of an RGB-D folder comes from depth images, which say what each frame saw."""
    return (folder / "depth").is_dir() and not _wall_moves(folder)


def _wall_moves(folder: Path) -> bool:
    """Whether a phantom's folder says that its wall moves: by a wall_motion.json, or contractions in events.json."""
    if (folder / "wall_motion.json").exists():
        return True
    events = read_json(folder / "events.json") if (folder / "events.json").exists() else None
    return isinstance(events, dict) and bool(events.get("contractions"))


def reference_from_views(
    views: Iterable[tuple[Array, Array]], max_depth_mm: float = 60.0, spacing_mm: float = SPACING_MM
) -> ReferenceSurface:
    """Reference surface of the world points (N,3) that each of many views saw, at their z-depths (N,), mm."""
    # Thinned to half the spacing on the way, so that memory follows the surface and not the length of the video.
    pending: list[tuple[Array, Array]] = []
    for points_and_depth in views:
        pending.append(points_and_depth)
        if len(pending) > FRAMES_PER_THINNING:
            pending = [_thin_views(pending, spacing_mm / 2)]
    points, nearest = _thin_views(pending, spacing_mm)
    return ReferenceSurface(seen=points, required=points[nearest <= max_depth_mm])


def reference_from_mesh(
    path: Path | str, max_depth_mm: float = 60.0, spacing_mm: float = SPACING_MM, seed: int = 0
) -> ReferenceSurface:
    """Reference surface sampled on a true mesh, by its face properties where it has them.

    `seen`: faces where it is 1 are sampled. `nearest_mm`: the smallest depth at which a face was seen; those deeper
    than `max_depth_mm` are not required.
    """
    mesh, seen = read_mesh(path), read_face_property(path, "seen")
    nearest = read_face_property(path, "nearest_mm")
    nowhere = int((~np.isfinite(mesh.vertices[mesh.faces]).all(axis=(1, 2))).sum())
    if nowhere:
        raise ReconstructionError(f"{path} has {counted(nowhere, 'face')} with a corner whose place is no number")
    whole = np.ones(len(mesh.faces), bool) if seen is None else seen == 1
    if not whole.any():
        raise ReconstructionError(f"{path} has no face that was seen")
    near = whole if nearest is None else whole & (nearest <= max_depth_mm)
    points = _points_on(mesh.with_faces(whole), spacing_mm, seed)
    return ReferenceSurface(
        seen=points, required=points if near.all() else _points_on(mesh.with_faces(near), spacing_mm, seed)
    )


def _points_on(mesh: SurfaceMesh, spacing_mm: float, seed: int) -> Array:
    """Points (N,3), about one in each cube of edge `spacing_mm` that the mesh intersects."""
    count = int(np.ceil(SAMPLES_PER_CUBE * mesh.face_areas.sum() / spacing_mm**2))
    return thin(sample_surface(mesh.vertices, mesh.faces, count, np.random.default_rng(seed)), spacing_mm)


def thin(points: Array, spacing: float) -> Array:
    """Voxel downsampling: the mean (M,3) of the points (N,3) in each occupied cube of edge `spacing`."""
    return _thin_views([(points, np.zeros(len(points)))], spacing)[0]


def _thin_views(views: list[tuple[Array, Array]], spacing: float) -> tuple[Array, Array]:
    """Mean point (M,3) and smallest depth (M,) in each occupied cube, of pairs of points (N,3) and depths (N,)."""
    points, depth = (np.concatenate(parts) for parts in zip(*views, strict=True))
    if not len(points):
        raise ReconstructionError("the truth has no point: its depth is empty")
    cube = np.floor(points / spacing).astype(np.int64)
    cube -= cube.min(axis=0)
    key = np.ravel_multi_index(tuple(cube.T), tuple(cube.max(axis=0) + 1))
    order = np.argsort(key, kind="stable")
    starts = np.flatnonzero(np.diff(key[order], prepend=-1))
    count = np.diff(starts, append=len(points))
    return np.add.reduceat(points[order], starts, axis=0) / count[:, None], np.minimum.reduceat(depth[order], starts)


def _views(folder: Path, every: int, between_s: tuple[float, float]) -> Iterator[tuple[Array, Array]]:
    """World points (N,3) of each frame's pixels with depth, and their z-depth (N,), mm."""
    camera, unit_mm = _read_camera(folder / "camera.json")
    rays, valid = _rays(camera)
    seconds, world_from_camera = read_tum(folder / "trajectory.txt")
    files = in_natural_order(list((folder / "depth").glob("[!.]*.png")))
    if len(files) != len(world_from_camera):
        raise ReconstructionError(f"{folder} has {len(files)} depth images for {len(world_from_camera)} poses")
    asked = (seconds >= between_s[0]) & (seconds < between_s[1])
    if not asked.any():
        raise ReconstructionError(f"{folder} has no pose from {between_s[0]:g} to {between_s[1]:g} s")
    for path, transform in [(files[k], world_from_camera[k]) for k in np.flatnonzero(asked)[::every]]:
        depth = _read_depth(path, camera, unit_mm)
        known = (depth > 0) & valid
        yield (rays[known] * depth[known, None]) @ transform[:3, :3].T + transform[:3, 3], depth[known]


def _read_camera(path: Path) -> tuple[Camera, float]:
    """Camera, and the unit of its depth images in mm."""
    try:
        unit_mm = float(read_json(path)["depth_unit_mm"])
        if not 0 < unit_mm < np.inf:
            raise ValueError(f"depth_unit_mm is {unit_mm:g}")
        return read_camera(path), unit_mm
    except (ValueError, KeyError, TypeError, OverflowError) as error:
        message = f"{path} is not a camera file with model, params, size and depth unit ({error})"
        raise ReconstructionError(message) from error


def _read_depth(path: Path, camera: Camera, unit_mm: float) -> Array:
    """z-depth (H,W) in mm, 0 = none."""
    import cv2

    image = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
    if image is None or image.dtype != np.uint16 or image.shape != (camera.height, camera.width):
        raise ReconstructionError(f"{path} is not a 16-bit depth image of the size in camera.json")
    return image * unit_mm


def _rays(camera: Camera) -> tuple[Array, NDArray[np.bool_]]:
    """Rays (H,W,3) of z = 1 through the pixels' centres, and which pixels (H,W) the lens model covers."""
    x, y = np.meshgrid(np.arange(camera.width) + 0.5, np.arange(camera.height) + 0.5)
    plane, valid = camera.unproject(np.stack([x.ravel(), y.ravel()], axis=1))
    shape = (camera.height, camera.width)
    return np.column_stack([plane, np.ones(len(plane))]).reshape(*shape, 3), valid.reshape(shape)
