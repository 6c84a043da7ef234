"""From grown maps to the `Submap` that the other front end gives: last adjustment, poses of all frames, errors."""

import numpy as np
from numpy.typing import NDArray

from haustra.core.progress import Advance, unheard
from haustra.core.se3 import Array, compose, in_camera, inverse
from pipeline.mapping.local_map import LOSS_PX, MAX_ERROR_PX, LocalMap
from pipeline.mapping.submap import Submap
from pipeline.optimization.bundle_adjustment import reprojections
from pipeline.optimization.resection import refine_poses

LONG = 300  # keyframes over which the scale may have drifted too far for one adjustment of all
PIECE = 60  # keyframes that are adjusted at once while a long map is straightened
HELD = 30  # older ones that hold them
GUIDES = 5  # keyframes at a piece's end that say by how much it grew; the last one, how it moved
MIN_HELD = 20  # points of such a keyframe
MOST_GROWTH = 3.0  # of a piece; the tracker's unit has drifted by half over two hundred keyframes
FINAL_ITERATIONS = 25
# With the usual 1e-4 the first steps leave a bend where it is, gain nothing, and are taken for the last ones.
FINAL_DAMPING = 1e-8
FINAL_TOLERANCE = 1e-5  # share of the cost; a bent scale costs little, and straightening it gains little at each step
SETTLING = ((5.0, 12.0), (2.0, 5.0))  # loss and largest error, pixels
MIN_SEEN = 8  # points that a frame must see to be called posed
CHUNK = 500  # frames refined at once


def polish(local_map: LocalMap, changed: bool = False, advance: Advance = unheard) -> None:
    """Adjust all keyframes and points together, cull, and adjust what is left.

    A map that was just `changed`, joined from two or given another lens, is first let settle: it starts some pixels
    off, and must not be culled for that.
    """
    count = len(local_map.keyframes)
    if changed and count > LONG:
        _straighten(local_map, advance)
    passes = SETTLING * changed + 2 * ((LOSS_PX, MAX_ERROR_PX),)
    for number, (loss_px, max_error_px) in enumerate(passes):
        advance(number, len(passes), "adjusting all keyframes")
        local_map.adjust(count, FINAL_ITERATIONS, count, loss_px, max_error_px, 0, FINAL_TOLERANCE, FINAL_DAMPING)
    advance(len(passes), len(passes), "adjusted")


def _straighten(local_map: LocalMap, advance: Advance = unheard) -> None:
    """Adjust a long map from its beginning on, half a piece at a time; what lies ahead is carried along.

    Where the scale drifts by half over a long film, the far end must come back by a factor and a turn. To an adjustment
    of all at once, which goes in straight lines, that is too far: it ends in wrinkles, and culling then breaks the map.
    Nothing is culled here: what does not fit a bent piece speaks against the bend.
    """
    for end in range(PIECE, len(local_map.keyframes), PIECE // 2):
        piece = range(end - PIECE // 2, end)
        advance(end, len(local_map.keyframes), "straightening")
        poses = [local_map.keyframes[number].pose for number in piece]
        before = local_map.points.copy()
        for loss_px, _ in SETTLING:
            local_map.adjust(PIECE, FINAL_ITERATIONS, end, loss_px, np.inf, HELD, FINAL_TOLERANCE, FINAL_DAMPING)
        grown = [_growth_of(local_map, number, pose, before) for number, pose in zip(piece, poses, strict=True)]
        held = np.flatnonzero(np.isfinite(grown))[-GUIDES:]
        if len(held) == 0:  # nothing says how it moved: what lies ahead stays
            continue
        scale = float(np.median([grown[k] for k in held]))
        local_map.carry(end, piece[held[-1]], poses[held[-1]], scale)


def _growth_of(local_map: LocalMap, number: int, old: Array, before: Array) -> float:
    """Of a keyframe that was at pose `old` with the points at `before`; NaN where too few points hold it, or say what
    no piece can have done."""
    keyframe = local_map.keyframes[number]
    mine = keyframe.ids[local_map.known[keyframe.ids]]
    if len(mine) < MIN_HELD:
        return float("nan")
    found = growth(in_camera(old, before[mine]), in_camera(keyframe.pose, local_map.points[mine]))
    return found if 1 / MOST_GROWTH < found < MOST_GROWTH else float("nan")


def growth(before: Array, after: Array) -> float:
    """By how much points in a camera's axes (N,3) moved away from it, in the median; NaN if there are none."""
    depths = [np.maximum(local[:, 2], 1e-9) for local in (before, after)]
    return float(np.exp(np.median(np.log(depths[1] / depths[0])))) if len(before) else float("nan")


def to_submap(
    local_map: LocalMap, camera_params: tuple[float, ...], camera_sigma: tuple[float, ...] = ()
) -> Submap | None:
    """The result; None if no frame sees enough."""
    frames, poses, counts, ids, pixels = _gather(local_map)
    row = np.repeat(np.arange(len(frames)), counts)
    poses, error = _refine(local_map, poses, row, ids, pixels)
    good = error < MAX_ERROR_PX
    while True:  # frames with too few points, and points with too few frames, until neither is left
        views = np.bincount(ids[good], minlength=len(local_map.known))
        seen = np.bincount(row[good], minlength=len(frames))
        kept = good & (views[ids] >= 2) & (seen[row] >= MIN_SEEN)
        if (kept == good).all():
            break
        good = kept
    if not good.any():
        return None
    tracks, point = np.unique(ids[good], return_inverse=True)
    used, frame = np.unique(row[good], return_inverse=True)
    summed = np.bincount(point, error[good], minlength=len(tracks))
    return Submap(
        frames[used],
        np.stack([inverse(poses[k]) for k in used]),
        local_map.points[tracks],
        summed / np.bincount(point, minlength=len(tracks)),
        np.stack([frame, point], axis=1),
        pixels[good].astype(np.float64),
        camera_params,
        camera_sigma,
        local_map.followed[tracks],
    )


def _gather(local_map: LocalMap) -> tuple[NDArray[np.int64], Array, NDArray[np.int64], NDArray[np.int64], NDArray]:
    """Frames ascending, their poses (N,4,4), numbers of observations, then all observations: track, pixels."""
    found: dict[int, tuple[Array, NDArray, NDArray]] = {}
    for posed in local_map.posed:
        found[posed.frame] = (local_map.pose_of(posed), posed.ids, posed.pixels)
    for keyframe in local_map.keyframes:
        found[keyframe.frame] = (keyframe.pose, keyframe.ids, keyframe.pixels)
    frames = np.array(sorted(found), dtype=np.int64)
    masks = [local_map.known[found[f][1]] for f in frames]
    return (
        frames,
        np.stack([found[f][0] for f in frames]),
        np.array([int(m.sum()) for m in masks]),
        np.concatenate([found[f][1][m] for f, m in zip(frames, masks, strict=True)]).astype(np.int64),
        np.concatenate([found[f][2][m] for f, m in zip(frames, masks, strict=True)]),
    )


def _refine(
    local_map: LocalMap, poses: Array, row: NDArray[np.int64], ids: NDArray[np.int64], pixels: NDArray
) -> tuple[Array, Array]:
    """All poses fitted once more to the final points, and the error of each observation in pixels."""
    poses, errors = poses.copy(), np.zeros(len(ids))
    for first in range(0, len(poses), CHUNK):
        part = slice(*np.searchsorted(row, [first, first + CHUNK]))
        block = poses[first : first + CHUNK]
        seen, gain = local_map.rays.look_up(pixels[part])
        points, mine = local_map.points[ids[part]], row[part] - first
        rotation, shift = refine_poses(block[:, :3, :3], block[:, :3, 3], mine, points, seen, gain, LOSS_PX)
        poses[first : first + CHUNK] = [compose(r, t) for r, t in zip(rotation, shift, strict=True)]
        local = np.einsum("mij,mj->mi", rotation[mine], points) + shift[mine]
        off = np.linalg.norm(reprojections(local, seen, gain), axis=1)
        errors[part] = np.where(local[:, 2] > 1e-9, off, np.inf)
    return poses, errors
