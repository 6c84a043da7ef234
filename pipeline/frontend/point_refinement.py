"""Depth of points by what the pictures show around them, where their poses stand.

A feature is found to half a pixel, and a corner that KLT tracks slides; small patches about a point in up to nine
frames say more. The point moves along its ray in a reference frame; its surroundings there are a plane, whose slope is
that of the points about it (inverse depth is linear in the picture of a plane). What the pictures do not confirm stays
as it was. A point that they confirm, but whose place is unsure for the contrast about it, may slide along an edge, such
as the outline of a fold, beside which the depth is another; it is dropped.

Poses are held fixed. Constants: chosen on films kept for choosing (docs/lab/points.md).
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import lru_cache, partial

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from haustra.core.camera import Camera
from haustra.core.progress import ProgressCallback, no_progress
from haustra.core.ray_table import RayTable, ray_table
from haustra.core.threads import prefetched
from pipeline.mapping.submap import Submap, refined_camera, sighting_errors
from pipeline.matching.patch_alignment import (
    HALF_WIDTH,
    LEAST_AREA,
    PROBES,
    SEARCH_PX,
    Alignment,
    PatchViews,
    ReferencePatches,
    align_patches,
    expected_error,
    groups,
    pictured,
    read_patches,
)
from pipeline.matching.sift_cache import ReadFrame

VIEWS = 8  # frames with which the reference is compared, at most
MOST_ERROR = 0.1  # expected, of a depth that is taken,
MOST_SHIFT = 0.3  # relative change of inverse depth
UNSURE_EDGE = 3.0  # times the submap's median of sigma times contrast, above which a point is dropped
CHUNK = 1000  # points aligned in one go: some fifty megabytes, mostly pictures
AT_ONCE = 2  # chunks, each by a thread of its own
HELD = 128  # frames whose pictures are kept, some twenty megabytes
NEIGHBOURS, NEIGHBOUR_PX = 14, 15.0  # whose inverse depths have the slope of the wall, and the radius of their weight
SAME_WALL = 0.3  # relative difference of inverse depth within which a neighbour counts
SLOPE_SIGMA = 0.02  # of relative inverse depth a pixel, expected before any neighbour is asked
NEIGHBOUR_SIGMA = 0.02  # relative depth, of the surest neighbour
PIXEL_NOISE = 0.5  # px, of a point before

Array = NDArray[np.float64]
Rows = NDArray[np.int64]
Picture = NDArray[np.uint8]
NONE = np.zeros(0, bool)


def refine_points(
    submap: Submap,
    camera: Camera,
    read: ReadFrame,
    advance: ProgressCallback = no_progress,
) -> Submap:
    """The submap with the points that the pictures confirm moved, and their `depth_error`; poses and other points stay.

    camera: of the working frames. read: rgb and mask of a frame; what the mask leaves out (the border, highlights) is
    not compared.
    """
    scene = _Scene(submap, ray_table(refined_camera(camera, submap)), read)
    reference, others = sightings(submap, submap.observations[_in_frames_of_features(submap)])
    points, (error, unsure) = submap.points.copy(), np.full((2, len(submap.points)), np.nan)
    order = np.argsort(reference, kind="stable")
    order = order[reference[order] >= 0]
    chunks = [order[first : first + CHUNK] for first in range(0, len(order), CHUNK)]

    def aligned_of(mine: Rows) -> Alignment:
        return scene.aligned(mine, reference[mine], others[mine])

    done = 0
    for mine, aligned in zip(chunks, prefetched(aligned_of, chunks, 1, AT_ONCE), strict=True):
        expected = expected_error(aligned)
        confirmed = aligned.confirmed
        good = confirmed & (np.abs(aligned.shift) < MOST_SHIFT) & (expected < MOST_ERROR)
        centre = submap.centres[reference[mine]]
        moved = centre + (points[mine] - centre) / (1 + aligned.shift)[:, None]
        points[mine[good]], error[mine[good]] = moved[good], expected[good]
        unsure[mine[confirmed]] = (aligned.sigma * aligned.contrast)[confirmed]
        done += len(mine)
        advance(done, len(order))
    refined = replace(submap, points=points, depth_error=error)
    error_px = np.where(np.isfinite(error), _mean_reprojection(refined, scene.rays), submap.error_px)
    known = np.isfinite(unsure)
    limit = UNSURE_EDGE * np.median(unsure[known]) if known.any() else np.inf
    contradicted = ~np.isfinite(error_px)  # moved to where a frame that saw it cannot
    return replace(refined, error_px=error_px).without_points((unsure > limit) | contradicted)


def _mean_reprojection(submap: Submap, rays: RayTable) -> Array:
    """(P,) px, of each point over all that see it; infinite where one of these cannot."""
    summed = np.bincount(submap.observations[:, 1], sighting_errors(submap, rays), len(submap.points))
    return summed / np.maximum(submap.track_lengths(), 1)


def _in_frames_of_features(submap: Submap) -> Rows:
    """Rows of the observations in frames that see features: KLT corners are seen in all frames, far more than it
    takes. All rows, where no point is a feature."""
    feature = ~submap.is_klt[submap.observations[:, 1]]
    frames = np.zeros(len(submap.frames), bool)
    frames[submap.observations[feature, 0]] = True
    return np.flatnonzero(frames[submap.observations[:, 0]] | ~feature.any())


def sightings(submap: Submap, observations: NDArray[np.int32]) -> tuple[Rows, Rows]:
    """(P,) row of each point's reference frame, the middle one of those that see it, and (P,VIEWS) rows of others,
    spread evenly; -1 where there is none. Points that fewer than three frames see have no reference."""
    frame, point = observations[np.lexsort(observations.T)].T
    seen = np.bincount(point, minlength=len(submap.points))
    start, middle = np.cumsum(seen) - seen, seen // 2
    asked = np.minimum(seen - 1, VIEWS)
    number = np.arange(VIEWS)
    place = np.rint(number * ((seen - 2) / np.maximum(asked - 1, 1))[:, None]).astype(np.int64)
    place += place >= middle[:, None]
    enough = seen >= 3
    known = enough[:, None] & (number < asked[:, None])
    reference, others = np.full(len(seen), -1), np.full((len(seen), VIEWS), -1)
    reference[enough] = frame[(start + middle)[enough]]
    others[known] = frame[(start[:, None] + place)[known]]
    return reference, others


@dataclass(frozen=True)
class _Patches:
    """Of P points: in their reference frames, what is read there, and `PROBES` in the world (P,4,3). whole: the patch
    shows the wall alone."""

    reference: ReferencePatches
    world: Array
    whole: NDArray[np.bool_]


class _Scene:
    """A submap, its rays and its pictures."""

    def __init__(self, submap: Submap, rays: RayTable, read: ReadFrame) -> None:
        self.submap, self.rays = submap, rays
        # Chunks share most of their frames, which are files: a picture and a mask are read once for a few chunks.
        self.picture = lru_cache(HELD)(partial(_picture, read, rays))
        order, self.starts = submap.by_frame()
        self.seen = submap.observations[order, 1]
        # Before: relative errors of points that are found to half a pixel in each frame.
        self.error = PIXEL_NOISE / (rays.focal_px * np.maximum(submap.ray_spreads(), 1e-6))

    def aligned(self, points: Rows, reference: Rows, others: Rows) -> Alignment:
        """Of points (P,), sorted by their reference frames."""
        rows = np.unique(np.concatenate([reference, others[others >= 0]])).tolist()
        read = {row: self.picture(int(self.submap.frames[row])) for row in rows}
        pictures = {row: grey for row, (grey, _) in read.items()}
        clear = {row: whole for row, (_, whole) in read.items()}
        patches = self._patches(points, reference, pictures, clear)
        return align_patches(patches.reference, self._views(patches, others, clear), pictures)

    def _patches(
        self, points: Rows, reference: Rows, pictures: dict[int, Picture], clear: dict[int, Picture]
    ) -> _Patches:
        world, whole, read = np.zeros((len(points), 4, 3)), np.zeros(len(points), bool), []
        for row, mine in groups(reference):
            local = self.submap.points_in_camera(row, self.submap.points[points[mine]])
            pixels = np.nan_to_num(self.rays.project(local), nan=-1.0)
            read.append(read_patches(pictures[row], pixels))
            whole[mine] = _is_clear(clear[row], pixels)
            world[mine] = self._probes(row, local, pixels, self._slopes(row, local, pixels))
        return _Patches(ReferencePatches(*(np.concatenate(part) for part in _columns(read))), world, whole)

    def _probes(self, row: int, local: Array, pixels: Array, slopes: Array) -> Array:
        """(N,4,3) of `_Patches.world`; local (N,3) the points in the camera of frame row `row`."""
        pose, probes = self.submap.world_from_camera[row], np.zeros((len(local), 4, 3))
        for number, (x, y, shift) in enumerate(PROBES):
            plane, _ = self.rays.unproject(pixels + np.array([x, y]))
            inverse = np.clip(1 + slopes @ np.array([x, y]), 0.5, 2) * (1 + shift) / local[:, 2]
            probes[:, number] = np.column_stack([plane, np.ones(len(plane))]) / inverse[:, None]
        return np.asarray(probes @ pose[:3, :3].T + pose[:3, 3])

    def _slopes(self, row: int, local: Array, pixels: Array) -> Array:
        """(N,2) relative change of inverse depth a pixel, about points (N,3) in the camera of a frame row.

        A weighted plane through the inverse depths of the points that the frame sees near by.
        """
        seen = self.seen[self.starts[row] : self.starts[row + 1]]
        around = self.submap.points_in_camera(row, self.submap.points[seen])
        at = self.rays.project(around)
        known = np.isfinite(at).all(axis=1) & (around[:, 2] > 0)
        at, inverse, error = at[known], 1 / around[known, 2], self.error[seen[known]]
        if len(at) == 0:
            return np.zeros((len(local), 2))
        count = min(NEIGHBOURS, len(at))
        distance, near = cKDTree(at).query(pixels, k=[*range(1, count + 1)])
        relative = inverse[near] * local[:, 2:] - 1
        weight = np.hypot(error[near], NEIGHBOUR_SIGMA) ** -2 / (1 + (distance / NEIGHBOUR_PX) ** 2)
        weight *= np.abs(relative) < SAME_WALL
        design = np.concatenate([at[near] - pixels[:, None], np.ones((*near.shape, 1))], axis=2)
        normal = np.einsum("nk,nki,nkj->nij", weight, design, design)
        normal += np.diag([SLOPE_SIGMA**-2, SLOPE_SIGMA**-2, 1e-3])
        right = np.einsum("nk,nki,nk->ni", weight, design, relative)
        return np.asarray(np.linalg.solve(normal, right[:, :, None])[:, :2, 0])

    def _views(self, patches: _Patches, others: Rows, clear: dict[int, Picture]) -> PatchViews:
        """Pictures of whole patches in other frames, where they are whole too."""
        patch, column = np.nonzero((others >= 0) & patches.whole[:, None])
        row = others[patch, column]
        order = np.argsort(row, kind="stable")
        patch, row = patch[order], row[order]
        pose = self.submap.world_from_camera[row]
        local = np.einsum("vki,vij->vkj", patches.world[patch] - pose[:, None, :3, 3], pose[:, :3, :3])
        pixels = self.rays.project(local.reshape(-1, 3)).reshape(-1, 4, 2)
        centre, shape, motion = pictured(pixels)
        finite: NDArray[np.bool_] = np.asarray(np.isfinite(pixels).all(axis=(1, 2)))
        at = np.where(finite[:, None], centre, -1.0)
        seen = np.concatenate([_is_clear(clear[number], at[mine]) for number, mine in groups(row)] or [NONE])
        whole = np.flatnonzero(seen)
        whole = whole[np.linalg.det(shape[whole]) > LEAST_AREA]  # of what is seen from behind it is negative
        return PatchViews(patch[whole], row[whole], centre[whole], shape[whole], motion[whole])


def _picture(read: ReadFrame, rays: RayTable, frame: int) -> tuple[Picture, Picture]:
    """Of a frame: grey (H,W), and 1 where a patch that moves as far as it is looked for touches nothing masked."""
    rgb, mask = read(frame)
    size = 2 * int(HALF_WIDTH + SEARCH_PX) + 1
    clear = cv2.erode(np.minimum(rays.masked(mask), 1), np.ones((size, size), np.uint8), borderValue=0)
    return cv2.cvtColor(rgb, cv2.COLOR_RGB2GRAY), clear


def _is_clear(clear: Picture, pixels: Array) -> NDArray[np.bool_]:
    """(N,) True where pixels (N,2) lie in the picture and are clear."""
    height, width = clear.shape
    within = (pixels >= 0).all(axis=1) & (pixels < [width, height]).all(axis=1)
    x, y = np.clip(np.floor(pixels), 0, [width - 1, height - 1]).astype(int).T
    return np.asarray(within & (clear[y, x] > 0))


def _columns(read: list[ReferencePatches]) -> Iterator[list[NDArray[np.float32]]]:
    for name in ("grey", "by_x", "by_y"):
        yield [getattr(one, name) for one in read]
