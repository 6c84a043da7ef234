"""One connected piece of structure: posed frames, points, and who saw what."""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from haustra.core.camera import Camera
from haustra.core.ray_table import RayTable

MIN_FRAMES = 3  # of a submap that is kept
SIGHTINGS = 200_000  # projected at once


@dataclass(frozen=True)
class Submap:
    """Posed frames and points in one scene frame and unit: what every front end returns.

    N frames, P points, M observations. "Row" is a place in `frames`, "frame" the number of a frame in the source.
    """

    frames: NDArray[np.int64]  # (N,) numbers in the source, ascending
    world_from_camera: NDArray[np.float64]  # (N,4,4)
    points: NDArray[np.float64]  # (P,3)
    error_px: NDArray[np.float64]  # (P,) mean reprojection error
    observations: NDArray[np.int32]  # (M,2) row in `frames` and row in `points`
    pixels: NDArray[np.float64]  # (M,2) in the working frame, as filmed through its lens; COLMAP's convention
    camera_params: tuple[float, ...]  # of the working frames' camera, as refined with the submap
    camera_sigma: tuple[float, ...] = ()  # standard deviations of the refined ones, focal length first; empty: given
    # (P,) corners that KLT tracked from frame to frame; others are features that each frame detected for itself.
    # None: all are features.
    klt: NDArray[np.bool_] | None = None
    # (P,) relative, 1 sigma, of points that were refined by their patches, NaN of others. None: no point was.
    depth_error: NDArray[np.float64] | None = None

    def __post_init__(self) -> None:
        # Of a long film there are millions of them: whatever they were made of, they are held in as few bytes as do.
        object.__setattr__(self, "observations", np.asarray(self.observations, np.int32))

    @property
    def is_klt(self) -> NDArray[np.bool_]:
        """(P,) `klt`, whatever the front end."""
        return np.zeros(len(self.points), dtype=bool) if self.klt is None else self.klt

    @property
    def known_depth_error(self) -> NDArray[np.float64]:
        """(P,) `depth_error`, NaN where none was refined."""
        return np.full(len(self.points), np.nan) if self.depth_error is None else self.depth_error

    @property
    def centres(self) -> NDArray[np.float64]:
        """(N,3) camera centres."""
        return self.world_from_camera[:, :3, 3]

    def points_in_camera(self, row: int, points: NDArray[np.float64]) -> NDArray[np.float64]:
        """World points (K,3) in the axes of frame row `row`."""
        rotation, centre = self.world_from_camera[row, :3, :3], self.world_from_camera[row, :3, 3]
        return (points - centre) @ rotation

    def depths(self) -> NDArray[np.float64]:
        """(M,) z-depth of each observation in its frame."""
        frame, point = self.observations.T
        axis = self.world_from_camera[frame, :3, 2]
        return np.einsum("ij,ij->i", self.points[point] - self.centres[frame], axis)

    def by_frame(self) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """The observations' rows frame after frame, (M,), and where each frame's begin, (N+1,)."""
        frame = self.observations[:, 0]
        return np.argsort(frame, kind="stable"), np.cumsum(np.bincount(frame + 1, minlength=len(self.frames) + 1))

    def track_lengths(self) -> NDArray[np.int64]:
        """(P,) number of frames that saw each point."""
        return np.bincount(self.observations[:, 1], minlength=len(self.points))

    def triangulation_angles(self) -> NDArray[np.float64]:
        """(P,) widest angle, in degrees, between two rays to each point.

        By two sweeps: the ray farthest from the first one, then the ray farthest from that; at most a factor of two
        below the true maximum, and exact for rays in a plane, which those of a moving camera nearly are.
        """
        order = np.argsort(self.observations[:, 1], kind="stable")
        frame, point = self.observations[order].T
        rays = self.points[point] - self.centres[frame]
        rays /= np.maximum(np.linalg.norm(rays, axis=1, keepdims=True), 1e-12)
        angles = np.zeros(len(self.points))
        if len(point) == 0:
            return angles
        seen, starts = np.unique(point, return_index=True)
        group = np.cumsum(np.bincount(starts, minlength=len(point))) - 1
        pivot = rays[starts]
        for _ in range(2):
            cosine = np.einsum("ij,ij->i", rays, pivot[group])
            lowest = np.minimum.reduceat(cosine, starts)
            farthest = np.lexsort((cosine, group))[starts]
            pivot = rays[farthest]
        angles[seen] = np.degrees(np.arccos(np.clip(lowest, -1, 1)))
        return angles

    def ray_spreads(self) -> NDArray[np.float64]:
        """(P,) root of the summed squared deviations of each point's unit rays from their mean, in radians.

        For small angles this is sqrt(sum (alpha_i - mean)^2), the lever arm of triangulation.
        """
        frame, point = self.observations.T
        rays = self.points[point] - self.centres[frame]
        rays /= np.maximum(np.linalg.norm(rays, axis=1, keepdims=True), 1e-12)
        count = np.maximum(self.track_lengths(), 1)
        total = np.stack([np.bincount(point, rays[:, k], minlength=len(self.points)) for k in range(3)], axis=1)
        return np.sqrt(np.maximum(self.track_lengths() - (total**2).sum(axis=1) / count, 0))

    def without_frames(self, frames: set[int]) -> "Submap":
        """The same points, seen by the other frames only."""
        kept = ~np.isin(self.frames, sorted(frames))
        mine = kept[self.observations[:, 0]]
        observations = self.observations[mine].copy()
        observations[:, 0] = (np.cumsum(kept) - 1)[observations[:, 0]]
        return replace(
            self,
            frames=self.frames[kept],
            world_from_camera=self.world_from_camera[kept],
            observations=observations,
            pixels=self.pixels[mine],
        )

    def without_points(self, drop: NDArray[np.bool_]) -> "Submap":
        """The same frames without the points of a mask (P,)."""
        mine = ~drop[self.observations[:, 1]]
        observations = self.observations[mine].copy()
        observations[:, 1] = (np.cumsum(~drop) - 1)[observations[:, 1]]
        return replace(
            self,
            points=self.points[~drop],
            error_px=self.error_px[~drop],
            observations=observations,
            pixels=self.pixels[mine],
            klt=self.is_klt[~drop],
            depth_error=None if self.depth_error is None else self.depth_error[~drop],
        )

    def scaled(self, factor: float) -> "Submap":
        """The same submap in another unit."""
        world_from_camera = self.world_from_camera.copy()
        world_from_camera[:, :3, 3] *= factor
        return replace(self, world_from_camera=world_from_camera, points=self.points * factor)


def sighting_errors(submap: Submap, rays: RayTable) -> NDArray[np.float64]:
    """(M,) px by which each observation is missed by its point; infinite where the frame cannot see it."""
    errors = np.zeros(len(submap.observations))
    for first in range(0, len(errors), SIGHTINGS):
        part = slice(first, first + SIGHTINGS)
        frame, point = submap.observations[part].T
        pose = submap.world_from_camera[frame]
        local = np.einsum("mi,mij->mj", submap.points[point] - pose[:, :3, 3], pose[:, :3, :3])
        off = np.linalg.norm(rays.project(local) - submap.pixels[part], axis=1)
        errors[part] = np.nan_to_num(off, nan=np.inf)
    return errors


def refined_camera(camera: Camera, submap: Submap) -> Camera:
    """The camera with the parameters that were refined together with the submap."""
    return Camera(camera.model, camera.width, camera.height, submap.camera_params, camera.trusted)


def read_submap(folder: Path) -> Submap:
    """A submap from the arrays that the COLMAP worker or `write_model` wrote; the file calls `klt` "followed"."""
    sigma = folder / "camera_sigma.txt"
    with np.load(folder / "model.npz", allow_pickle=False) as arrays:
        return Submap(
            np.array([int(name.split(".")[0]) for name in arrays["names"]], dtype=np.int64),
            arrays["world_from_camera"],
            arrays["points"],
            arrays["error_px"],
            arrays["observations"],
            arrays["pixels"],
            tuple(float(p) for p in arrays["camera_params"]),
            tuple(float(s) for s in sigma.read_text().split()) if sigma.exists() else (),
            arrays.get("followed"),
            arrays.get("depth_error"),
        )
