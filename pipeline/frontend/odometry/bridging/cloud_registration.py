"""Registration of depth clouds against the clouds of frames before them, point to plane.

Directions in which a tube looks the same, along its axis and about it, are those eigenvectors of the Hessian along
which hardly a normal points: there the guess stays (Zhang et al., "On degeneracy of optimization-based state estimation
problems", ICRA 2016). Normals with errors point a little along any direction, so that much is taken off first.
Point to point, as in KISS-ICP (Vizzo et al., RA-L 2023), slides: docs/lab/blind_stretch.md.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from haustra.core.se3 import Array, exp_rotation, in_camera

VOXEL_MM = 1.0  # edge of a cube whose points are made one
NEIGHBOURS = 20  # points that give a plane
PLANE = 3  # numbers that a plane has
FLAT = 0.5  # least over middle spread of a plane's points
MOST_OFF_MM = 4.0  # of a match from its plane's place
NARROWING_MM = 4.0, 2.0  # the same while a cloud is registered
LOSS_MM = 0.7  # Cauchy's
# Mean square of what a unit step moves along the normals, of 1 (a third where no direction is special). Less than
# HELD and NOISY times what comes of the normals' own errors: the wall does not hold that direction.
HELD, NOISY = 0.003, 1.5
LEAST_FLAT = 0.9  # of the matched patches; with fewer the noise is more than `unsure` can tell
ITERATIONS, DONE_MM = 15, 1e-3
FEWEST = 50  # matches
BESIDE = 3  # neighbours, and the least distance as well: a point farther beside its match lies beyond the wall's edge


@dataclass(frozen=True)
class WallPatches:
    """Planes through points: centres (N,3), mm, and normals (N,3) in one world; unsure (N,3,3): covariance of the
    normals; reach (N,), mm: how far from its place along a plane a point may lie; tree: of the places (N,3) where
    planes are found."""

    centres: Array
    normals: Array
    unsure: Array
    reach: Array
    flat: NDArray[np.bool_]
    tree: cKDTree

    @staticmethod
    def of(points: Array) -> "WallPatches":
        """Of clouds' points (P,3) in one world."""
        places = _thinned(points)
        tree = cKDTree(places)
        away, neighbour = tree.query(places, k=min(NEIGHBOURS, len(places)))
        near = places[neighbour]
        reach = np.maximum(VOXEL_MM, away[:, min(BESIDE, len(places) - 1)])
        centres = near.mean(axis=1)
        off = near - centres[:, None]
        spread, axes = np.linalg.eigh(np.einsum("nki,nkj->nij", off, off))
        flat = spread[:, 0] < FLAT * spread[:, 1]
        # A normal tilts toward an axis by a variance of noise over spread (first order; noise: the least spread).
        tilt = spread[:, :1] / np.maximum(spread[:, 1:], 1e-12) / max(near.shape[1] - PLANE, 1)
        unsure = np.einsum("nik,nk,njk->nij", axes[:, :, 1:], tilt, axes[:, :, 1:])
        return WallPatches(centres, axes[:, :, 0], unsure, reach, flat, tree)

    def joined(self, other: "WallPatches") -> "WallPatches":
        """Both, in one world; where they overlap a point takes the plane whose place is nearest."""
        both = zip(self._arrays(), other._arrays(), strict=True)
        centres, normals, unsure, reach, flat, places = (np.concatenate(pair) for pair in both)
        return WallPatches(centres, normals, unsure, reach, flat, cKDTree(places))

    def _arrays(self) -> tuple[NDArray[Any], ...]:
        return self.centres, self.normals, self.unsure, self.reach, self.flat, self.tree.data

    def registered(self, cloud: Array, guess: Array) -> Array | None:
        """world_from_camera (4,4) of a cloud (N,3) in the camera's axes, near to `guess`, which stays in the directions
        that the wall does not hold; None where too little of the cloud lies on the wall."""
        world_from_camera = guess
        for most_off in NARROWING_MM:
            for _ in range(ITERATIONS):
                points, patch = self._matched(in_camera(world_from_camera, cloud), most_off)
                sure = self.flat[patch]
                if sure.sum() < FEWEST:
                    return None
                step, size = self._equations(points[sure], patch[sure]).step()
                world_from_camera = step @ world_from_camera
                if size < DONE_MM:
                    break
        return np.asarray(world_from_camera)

    def holds(self, cloud: Array, world_from_camera: Array) -> bool:
        """Whether the wall holds a cloud at a pose in all six directions, or in some any pose would do as well."""
        points, patch = self._matched(in_camera(world_from_camera, cloud), NARROWING_MM[-1])
        sure = self.flat[patch]
        if sure.sum() < max(FEWEST, LEAST_FLAT * len(sure)):
            return False
        return bool(self._equations(points[sure], patch[sure]).held.all())

    def fit(self, cloud: Array, world_from_camera: Array) -> tuple[float, float]:
        """Median distance (mm) of a cloud's points at a pose from the flat patches that they lie on, and the share that
        lies where wall is."""
        points, patch = self._matched(in_camera(world_from_camera, cloud), MOST_OFF_MM)
        flat = self.flat[patch]
        if not flat.any():
            return np.inf, 0.0
        return float(np.median(np.abs(self._off(points[flat], patch[flat])))), len(points) / len(cloud)

    def misfit(self, cloud: Array, world_from_camera: Array) -> float:
        """Mean loss of a cloud's points at a pose; one without a plane has that of the greatest distance."""
        points, patch = self._matched(in_camera(world_from_camera, cloud), MOST_OFF_MM)
        loss = float(np.log1p((self._off(points, patch) / LOSS_MM) ** 2).sum())
        return (loss + (len(cloud) - len(points)) * float(np.log1p((MOST_OFF_MM / LOSS_MM) ** 2))) / len(cloud)

    def _matched(self, points: Array, most_off: float) -> tuple[Array, NDArray[np.int64]]:
        """Those of points (N,3) that have a plane (K,3), and its index (K,). One beyond the edge of the wall that was
        seen has none: it would draw the cloud over the edge."""
        distance, patch = self.tree.query(points, distance_upper_bound=most_off)
        near = np.isfinite(distance)
        points, patch = points[near], patch[near]
        away, normals = points - self.tree.data[patch], self.normals[patch]
        beside = away - np.einsum("ni,ni->n", away, normals)[:, None] * normals
        inside = np.linalg.norm(beside, axis=1) < self.reach[patch]
        return points[inside], patch[inside]

    def _off(self, points: Array, patch: NDArray[np.int64]) -> Array:
        """(K,) signed distances, mm, of points (K,3) from their planes."""
        return np.asarray(np.einsum("ni,ni->n", points - self.centres[patch], self.normals[patch]))

    def _equations(self, points: Array, patch: NDArray[np.int64]) -> "_NormalEquations":
        """Of the step that brings points (N,3) to their planes."""
        normals = self.normals[patch]
        off = self._off(points, patch)
        weight = 1 / (1 + (off / LOSS_MM) ** 2)
        weight /= weight.sum()
        centre = points.mean(axis=0)
        arm = points - centre
        reach = float(np.sqrt((arm**2).sum(axis=1).mean()))
        slopes = np.concatenate([np.cross(arm, normals) / reach, normals], axis=1)
        strength, directions = np.linalg.eigh((slopes * weight[:, None]).T @ slopes)
        # What a unit step along each direction moves the points (6,N,3), and what of that a normal's error makes of it.
        turn, shift = directions[:3].T[:, None], directions[3:].T[:, None]
        moved = shift + np.cross(turn, arm[None] / reach)
        by_error = np.einsum("dni,nij,dnj->dn", moved, self.unsure[patch], moved, optimize=True) @ weight
        gradient = directions.T @ (slopes.T @ (weight * off))
        return _NormalEquations(directions, strength, gradient, strength > HELD + NOISY * by_error, centre, reach)


@dataclass(frozen=True)
class _NormalEquations:
    """Of a small motion of points about their centre (3,). directions: (6,6), one a column, a turn in 1 / reach
    (1 / mm) over a shift in mm; strength (6,), gradient (6,), and whether the wall holds it (6,), of each."""

    directions: Array
    strength: Array
    gradient: Array
    held: NDArray[np.bool_]
    centre: Array
    reach: float

    def step(self) -> tuple[Array, float]:
        """A motion (4,4) of the world, nothing where the wall does not hold, and its length, mm."""
        along = -self.gradient[self.held] / self.strength[self.held]
        tangent = self.directions[:, self.held] @ along
        step = np.eye(4)
        step[:3, :3] = exp_rotation(tangent[:3] / self.reach)
        step[:3, 3] = self.centre + tangent[3:] - step[:3, :3] @ self.centre
        return step, float(np.linalg.norm(tangent))


def _thinned(points: Array) -> Array:
    """The mean (M,3) of the points in each cube."""
    _, cube, count = np.unique(
        np.floor(points / VOXEL_MM).astype(np.int64), axis=0, return_inverse=True, return_counts=True
    )
    return np.stack([np.bincount(cube.ravel(), column) / count for column in points.T], axis=1)
