"""Stage 5b: whether the wall moved while it was filmed, by each submap's own points. Nothing is changed by it.

Long films are asked piece by piece, so that memory does not grow with the film.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass

import numpy as np
from numpy.typing import NDArray

from haustra.core.progress import Progress
from pipeline.depth.completed_submap import CompletedSubmap
from pipeline.input.frames import Frames
from pipeline.mapping.submap import Submap, refined_camera
from pipeline.run_folder.stage import load_or_make
from pipeline.run_folder.workspace import Workspace
from reconstruction.motion.held_out_motion import Residuals, held_out_motion

STAGE = "motion"
PIECE_S = 30.0
MOST_OBSERVATIONS = 60_000  # of a piece
MIN_TRACK_LENGTH = 3  # frames that saw a point; fewer miss nothing
NEAREST = 0.05  # scene units; nearer than that is no wall

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]


@dataclass(frozen=True)
class WallMotion:
    """Of a submap: whether neighbouring points miss a still map together; explained: the share of held-out residuals
    that a motion of the wall foretells."""

    told: bool
    explained: float

    def sentence(self, number: int) -> str:
        """For a person."""
        return (
            f"points of submap {number} miss a still wall as their neighbours do: the wall moved while it was filmed, "
            "or the lens, the shutter or the path is a little wrong; path, depth and scale are not to be trusted to "
            "millimetres"
        )


def wall_motion_stage(
    frames: Frames, completed: list[CompletedSubmap], submaps: list[Submap], workspace: Workspace, progress: Progress
) -> list[WallMotion | None]:
    """Motion of each submap's wall; None where too little is tracked to tell, and where closed loops moved points off
    what was adjusted to the pictures.

    submaps: as the front end left them; points found anew have lost the sightings that a moving wall puts off.
    """
    return load_or_make(
        workspace,
        STAGE,
        lambda: load_motion(workspace),
        lambda: _ask_all(frames, _unmoved(completed, submaps), workspace, progress),
    )


def _unmoved(completed: list[CompletedSubmap], submaps: list[Submap]) -> list[Submap | None]:
    """Of each completed submap the one that the front end left; None of those that closed loops moved."""
    by_frames = {tuple(submap.frames.tolist()): submap for submap in submaps}
    return [
        None if one.depth_scale is not None else by_frames.get(tuple(one.submap.frames.tolist())) for one in completed
    ]


def load_motion(workspace: Workspace) -> list[WallMotion | None]:
    """What a finished stage found; none in runs of earlier versions."""
    if not workspace.is_done(STAGE):
        return []
    records = workspace.result(STAGE)["submaps"]
    return [None if r is None else WallMotion(r["told"], r["explained"]) for r in records]


def _ask_all(frames: Frames, submaps: list[Submap | None], workspace: Workspace, progress: Progress) -> None:
    found = [None if submap is None else measure_motion(frames, submap) for submap in submaps]
    workspace.finish(STAGE, submaps=[None if one is None else asdict(one) for one in found])
    for sentence in sentences(found):
        progress.log(sentence)


def sentences(found: list[WallMotion | None]) -> list[str]:
    """One for each submap whose points miss a still wall together."""
    return [one.sentence(number) for number, one in enumerate(found) if one is not None and one.told]


def measure_motion(frames: Frames, submap: Submap) -> WallMotion | None:
    """Motion of one submap's wall; None where too little is tracked to tell."""
    seconds, (order, starts) = frames.seconds_of_numbers(submap.frames), submap.by_frame()
    pieces = max(1, round((seconds[-1] - seconds[0]) / PIECE_S))
    edges = np.searchsorted(seconds, np.linspace(seconds[0], seconds[-1], pieces + 1)[1:-1])
    found = []
    for mine in np.split(order, starts[edges]):
        kept = mine[_thinned(submap.observations[mine, 1])]
        if len(kept) and (one := held_out_motion(residuals(frames, submap, seconds, kept))) is not None:
            found.append(one)
    if not found:
        return None
    whole = sum(found[1:], start=found[0])
    return WallMotion(whole.is_told, whole.explained)


def _thinned(point: NDArray[np.int64]) -> Mask:
    """(M,) observations of points with enough of them, and of no more points than a piece can hold."""
    count = np.bincount(point)
    usable = np.flatnonzero(count >= MIN_TRACK_LENGTH)
    step = max(1, -(-int(count[usable].sum()) // MOST_OBSERVATIONS))
    kept = np.zeros(len(count), dtype=bool)
    kept[usable[::step]] = True
    return kept[point]


def residuals(frames: Frames, submap: Submap, seconds: Array, mine: Mask | NDArray[np.int64]) -> Residuals:
    """Residuals of the observations `mine` (rows or mask) of a submap whose frames are at `seconds` (N,)."""
    camera = refined_camera(frames.camera, submap)
    row, point = submap.observations[mine].T
    plane, valid = camera.unproject(submap.pixels[mine])
    rotation, world = np.swapaxes(submap.world_from_camera[row, :3, :3], 1, 2), submap.points[point]
    local = np.einsum("mij,mj->mi", rotation, world - submap.centres[row])
    good = valid & (local[:, 2] > NEAREST)
    row, point, plane, rotation, world, local = (a[good] for a in (row, point, plane, rotation, world, local))
    depth, focal = local[:, 2], float(np.sqrt(camera.focal[0] * camera.focal[1]))
    slope = np.zeros((len(local), 2, 3))
    slope[:, 0, 0] = slope[:, 1, 1] = focal / depth
    slope[:, :, 2] = -focal * local[:, :2] / depth[:, None] ** 2
    pixels = focal * (local[:, :2] / depth[:, None] - plane)
    return Residuals(point, world, seconds[row], pixels, slope @ rotation)
