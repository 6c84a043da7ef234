"""Bundle adjustment of a map: of its latest keyframes while it grows, of all of them when it is finished."""

from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from haustra.core.progress import ProgressCallback, no_progress
from haustra.core.se3 import Array, compose, in_camera
from pipeline.mapping.local_map import WINDOW, Keyframe, LocalMap
from pipeline.mapping.metric_map import measured_depth
from pipeline.optimization.bundle_adjustment import DAMPING, TOLERANCE, Bundle, adjust

MOST_FIXED = 6  # other keyframes that saw the same points and stay
MIN_SHARED = 10  # points that such a one must share; fewer do not hold a scene
WINDOW_ITERATIONS = 2  # each keyframe is in several windows; six iterations gave no better a path in the end
LOSS_PX = 0.8  # Cauchy; tracking errs by 0.2 to 0.5 px
MAX_ERROR_PX = 2.0  # of an observation that is kept
CHUNK = 50_000  # points fitted at once: a few hundred megabytes

LONG = 300  # keyframes over which the scale may have drifted too far for one adjustment of all
PIECE = 60  # keyframes that are adjusted at once of a long map
FIXED_KEYFRAMES = 30  # older ones that hold them
REFERENCES = 5  # keyframes at a piece's end that say by how much it grew; the last one, how it moved
MIN_POINTS = 20  # points of such a keyframe
MOST_GROWTH = 3.0  # of a piece; the tracker's unit has drifted by half over two hundred keyframes
FINAL_ITERATIONS = 25
POINT_ITERATIONS = 10  # of points alone, poses fixed
# With the usual 1e-4 the first steps leave a bend where it is, gain nothing, and are taken for the last ones.
FINAL_DAMPING = 1e-8
FINAL_TOLERANCE = 1e-5  # share of the cost; a bent scale costs little, and taking that back gains little at each step
LOSS_SCHEDULE = ((5.0, 12.0), (2.0, 5.0))  # loss and largest error, pixels

Mask = NDArray[np.bool_]


@dataclass(frozen=True)
class Solver:
    """How a bundle is adjusted, and which observations stay. loss_px: of the Cauchy loss; tolerance: see `adjust`."""

    iterations: int = WINDOW_ITERATIONS
    loss_px: float = LOSS_PX
    max_error_px: float = MAX_ERROR_PX  # of an observation that is kept
    tolerance: float = TOLERANCE
    damping: float = DAMPING


FINAL = Solver(FINAL_ITERATIONS, tolerance=FINAL_TOLERANCE, damping=FINAL_DAMPING)


def adjust_window(
    local_map: LocalMap, window: int = WINDOW, iterations: int = WINDOW_ITERATIONS, end: int | None = None
) -> None:
    """Adjust the `window` keyframes before number `end` (None: the latest ones) and their points; forget what does not
    fit."""
    end = len(local_map.keyframes) if end is None else end
    _adjust(local_map, max(0, end - window), end, MOST_FIXED, Solver(iterations))


def adjust_all(
    local_map: LocalMap, changed: bool = False, advance: ProgressCallback = no_progress, among: Mask | None = None
) -> None:
    """Adjust all keyframes and points together, cull, and adjust what is left.

    A map that was just `changed`, merged from two or given another lens, is first let settle: it starts some pixels
    off, and must not be culled for that. among (T,): tracks that take part; None: all.
    """
    count = len(local_map.keyframes)
    if changed and count > LONG:
        _adjust_progressively(local_map, advance, among)
    passes = LOSS_SCHEDULE * changed + 2 * ((LOSS_PX, MAX_ERROR_PX),)
    for number, (loss_px, max_error_px) in enumerate(passes):
        advance(number, len(passes), "adjusting all keyframes")
        _adjust(local_map, 0, count, 0, replace(FINAL, loss_px=loss_px, max_error_px=max_error_px), among)
    advance(len(passes), len(passes), "adjusted")


def fit_points(local_map: LocalMap) -> None:
    """All points fitted to the keyframes as they stand, `CHUNK` at a time, and those dropped that do not fit."""
    for first in range(0, len(local_map.tracks), CHUNK):
        chunk = np.zeros_like(local_map.tracks.has_point)
        chunk[first : first + CHUNK] = True
        bundle, tracks = _bundle(local_map, [], local_map.keyframes, chunk)
        if len(tracks) == 0:
            continue
        fixed = np.ones(len(bundle.fixed), dtype=bool)
        result = adjust(replace(bundle, fixed=fixed), POINT_ITERATIONS, LOSS_PX)
        local_map.tracks.points[tracks] = result.points
        _cull(local_map, result, tracks, local_map.keyframes, MAX_ERROR_PX)


def growth(before: Array, after: Array) -> float:
    """By how much points in a camera's axes (N,3) moved away from it, in the median; NaN if there are none."""
    depths = [np.maximum(local[:, 2], 1e-9) for local in (before, after)]
    return float(np.exp(np.median(np.log(depths[1] / depths[0])))) if len(before) else float("nan")


def sharing(
    local_map: LocalMap, free: list[Keyframe], others: list[Keyframe], most: int, among: Mask | None = None
) -> list[Keyframe]:
    """Those of `others` that see most points of `free`, at most so many, in their order."""
    wanted = _wanted(local_map, free, among)
    shared = np.array([int(wanted[k.ids].sum()) for k in others], dtype=np.int64)
    best = np.argsort(-shared, kind="stable")[:most]
    return [others[k] for k in np.sort(best[shared[best] >= MIN_SHARED])]


def _adjust(
    local_map: LocalMap, first: int, end: int, most_fixed: int, solver: Solver, among: Mask | None = None
) -> None:
    """Adjust the keyframes from number `first` to before `end`, and their points; forget what does not fit.

    At most `most_fixed` older keyframes, those that share most points with them, are held fixed; without any, keyframe
    `first` is. among (T,): tracks that take part; None: all.
    """
    keyframes = local_map.keyframes
    free = keyframes[first:end]
    fixed_keyframes = sharing(local_map, free, keyframes[:first], most_fixed, among)
    bundle, tracks = _bundle(local_map, fixed_keyframes, free, among)
    if len(tracks) == 0:
        return
    result = adjust(bundle, solver.iterations, solver.loss_px, solver.tolerance, solver.damping)
    for number, keyframe in enumerate(free, start=len(fixed_keyframes)):
        keyframe.camera_from_world = compose(result.rotation[number], result.translation[number])
    local_map.tracks.points[tracks] = result.points
    _cull(local_map, result, tracks, fixed_keyframes + free, solver.max_error_px)


def _adjust_progressively(local_map: LocalMap, advance: ProgressCallback, among: Mask | None) -> None:
    """Adjust a long map from its beginning on, half a piece at a time; what lies ahead is carried along.

    Where the scale drifts by half over a long film, the far end must come back by a factor and a turn. To an adjustment
    of all at once, which goes in straight lines, that is too far: it ends in wrinkles, and culling then breaks the map.
    Nothing is culled here: what does not fit a bent piece speaks against the bend.
    """
    for end in range(PIECE, len(local_map.keyframes), PIECE // 2):
        piece = range(end - PIECE // 2, end)
        advance(end, len(local_map.keyframes), "adjusting a long map in pieces")
        cameras_from_world = [local_map.keyframes[number].camera_from_world for number in piece]
        before = local_map.tracks.points.copy()
        for loss_px, _ in LOSS_SCHEDULE:
            solver = replace(FINAL, loss_px=loss_px, max_error_px=np.inf)
            _adjust(local_map, max(0, end - PIECE), end, FIXED_KEYFRAMES, solver, among)
        grown = [
            _growth_of(local_map, number, camera_from_world, before, among)
            for number, camera_from_world in zip(piece, cameras_from_world, strict=True)
        ]
        held = np.flatnonzero(np.isfinite(grown))[-REFERENCES:]
        if len(held) == 0:  # nothing says how it moved: what lies ahead stays
            continue
        scale = float(np.median([grown[k] for k in held]))
        local_map.propagate(end, piece[held[-1]], cameras_from_world[held[-1]], scale, among)


def _growth_of(local_map: LocalMap, number: int, old: Array, before: Array, among: Mask | None) -> float:
    """Of a keyframe that was at pose `old` with the points at `before`; NaN where too few points hold it, or say what
    no piece can have done."""
    keyframe = local_map.keyframes[number]
    mine = keyframe.ids[_usable(local_map, among)[keyframe.ids]]
    if len(mine) < MIN_POINTS:
        return float("nan")
    found = growth(in_camera(old, before[mine]), in_camera(keyframe.camera_from_world, local_map.tracks.points[mine]))
    return found if 1 / MOST_GROWTH < found < MOST_GROWTH else float("nan")


def _usable(local_map: LocalMap, among: Mask | None) -> Mask:
    """(T,) tracks that have a point, `among` these."""
    return local_map.tracks.has_point if among is None else local_map.tracks.has_point & among


def _wanted(local_map: LocalMap, keyframes: list[Keyframe], among: Mask | None) -> Mask:
    """(T,) usable tracks that any of the keyframes sees."""
    wanted = np.zeros(len(local_map.tracks), dtype=bool)
    for keyframe in keyframes:
        wanted[keyframe.ids] = True
    return wanted & _usable(local_map, among)


def _bundle(
    local_map: LocalMap, fixed_keyframes: list[Keyframe], free: list[Keyframe], among: Mask | None = None
) -> tuple[Bundle, NDArray[np.int64]]:
    """The problem, and the track number of each of its points."""
    wanted, cameras = _wanted(local_map, free, among), fixed_keyframes + free
    masks = [wanted[k.ids] for k in cameras]
    ids = np.concatenate([k.ids[m] for k, m in zip(cameras, masks, strict=True)])
    tracks, point = np.unique(ids, return_inverse=True)
    fixed = np.zeros(len(cameras), dtype=bool)
    fixed[: max(1, len(fixed_keyframes))] = True
    cameras_from_world = np.stack([k.camera_from_world for k in cameras])
    bundle = Bundle(
        cameras_from_world[:, :3, :3],
        cameras_from_world[:, :3, 3],
        local_map.tracks.points[tracks],
        np.repeat(np.arange(len(cameras)), [int(m.sum()) for m in masks]),
        point,
        np.concatenate([k.xy[m] for k, m in zip(cameras, masks, strict=True)]),
        np.concatenate([k.jacobian[m] for k, m in zip(cameras, masks, strict=True)]),
        fixed,
        None if local_map.depth_at is None else measured_depth(local_map.depth_at, cameras, masks),
    )
    return bundle, tracks


def _cull(
    local_map: LocalMap, bundle: Bundle, tracks: NDArray[np.int64], cameras: list[Keyframe], max_error_px: float
) -> None:
    """Forget observations that do not fit, and points that too few observations hold."""
    local = np.einsum("mij,mj->mi", bundle.rotation[bundle.camera], bundle.points[bundle.point])
    depth = local[:, 2] + bundle.translation[bundle.camera, 2]
    bad = (bundle.errors() > max_error_px) | (depth <= 0)
    if not bad.any():
        return
    left = np.bincount(bundle.point[~bad], minlength=len(tracks))
    lost = tracks[left < 2]
    local_map.tracks.has_point[lost] = False
    local_map.tracks.rejected[lost] = True
    starts = np.searchsorted(bundle.camera, np.arange(len(cameras) + 1))
    for keyframe, (begin, end) in zip(cameras, pairwise(starts.tolist()), strict=True):
        if bad[begin:end].any():
            keyframe.keep(~np.isin(keyframe.ids, tracks[bundle.point[begin:end][bad[begin:end]]]))
