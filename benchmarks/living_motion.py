"""How much of a wall's motion a still map takes up, and what is told of the rest.

    python -m benchmarks.living FILMS/* --keep RUNS --name now
    python -m benchmarks.living_motion FILMS/* --runs RUNS --name now --json living_motion.json

Of the largest submap of each kept run: the true motion of what its points show, about the mean of each point's own
sightings, from true depth and the true wall; what its map misses them by, across the view, at the true scale (median
and 90 % of all sightings, mm); and what `pipeline.surface.wall_motion` tells: share of held-out residuals that a motion
foretells, and the share of the wall that moved. A row is added as each film ends.
"""

import argparse
import sys
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.common.living_truth import TrueMotion, true_depth
from benchmarks.common.record import RunTable, print_row
from benchmarks.common.runner import add_folders, run
from haustra.core.camera import Camera, read_camera
from haustra.core.errors import HaustraError
from haustra.core.sim3 import scale_of
from pipeline.depth.rectification import Rectifier
from pipeline.finished_run import Run, open_run
from pipeline.mapping.submap import Submap
from pipeline.surface.wall_motion import measure_motion, residuals
from reconstruction.evaluation.trajectory_io import read_tum
from reconstruction.evaluation.trajectory_metrics import align_poses

SAME_SPOT_MM = 1.0  # at rest; a sighting farther from the point's median is of another spot

Array = NDArray[np.float64]


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add_folders(parser)
    parser.add_argument("--runs", type=Path, required=True, help="folder of runs that `benchmarks.living` kept")
    parser.add_argument("--name", default="now", help="what those runs are called")


def measure(arguments: argparse.Namespace) -> None:
    """Every film once."""
    table = RunTable(arguments.json)
    for film in arguments.folders:
        if table.has(film.name, 0, arguments.name):
            continue
        try:
            made = open_run(arguments.runs / f"{film.name}_{arguments.name}")
        except HaustraError as error:
            print(error)
            continue
        figures = figures_of(film, made)
        table.add(film.name, 0, {arguments.name: figures})
        print_row({"film": film.name} | figures)


def figures_of(film: Path, made: Run) -> dict[str, Any]:
    """Of the largest submap."""
    submap = made.submaps_of_front_end[0]
    truth = read_tum(film / "trajectory.txt")[1]
    unit = float(scale_of(align_poses(submap.world_from_camera, truth[submap.frames])))
    seen = residuals(made.frames, submap, submap.frames.astype(np.float64), np.ones(len(submap.observations), bool))
    # The jacobian by the point is focal / depth across the view, nearly so off its middle.
    across = np.linalg.norm(seen.pixels, axis=1) / np.linalg.norm(seen.jacobian[:, 0], axis=1) * unit
    moved = true_motion(film, submap, truth)
    told = measure_motion(made.frames, submap)
    assert told is not None
    return {
        "moved_median_mm": float(np.median(moved)),
        "moved_90_mm": float(np.percentile(moved, 90)),
        "missed_median_mm": float(np.median(across)),
        "missed_90_mm": float(np.percentile(across, 90)),
        "told": told.told,
        "explained_percent": 100 * told.explained,
    }


def true_motion(film: Path, submap: Submap, truth: Array) -> Array:
    """(M,) mm: of all sightings of one spot, how far the wall is from its mean over the point's sightings."""
    camera, motion = read_camera(film / "camera.json"), TrueMotion.of(film)
    now, rest = np.full((2, len(submap.pixels), 3), np.nan)
    for row, frame in enumerate(submap.frames.tolist()):
        mine = np.flatnonzero(submap.observations[:, 0] == row)
        points, known = _seen_points(film, frame, camera, submap.pixels[mine])
        world = points @ truth[frame, :3, :3].T + truth[frame, :3, 3]
        now[mine[known]] = rest[mine[known]] = world
        if motion is not None and len(world):
            rest[mine[known]] += motion.to_rest(world, frame)
    return _about_own_mean(submap.observations[:, 1], now - rest, rest)


def _seen_points(film: Path, frame: int, camera: Camera, pixels: Array) -> tuple[Array, NDArray[np.bool_]]:
    """Points (K,3) in camera axes at those of the pixels (M,2) that have depth, and which (M,) they are."""
    depth = true_depth(film, frame, Rectifier(camera, None, 1.0))
    column, row = np.clip(np.floor(pixels).astype(int), 0, [camera.width - 1, camera.height - 1]).T
    plane, valid = camera.unproject(pixels)
    known = valid & (depth[row, column] > 0)
    z = depth[row, column][known, None].astype(np.float64)
    return np.column_stack([plane[known] * z, z]), known


def _about_own_mean(point: NDArray[np.int64], offset: Array, rest: Array) -> Array:
    """(K,) of the sightings of one spot, twice or more; offset, rest (M,3) mm."""
    moved = []
    order = np.argsort(point, kind="stable")
    for rows in np.split(order, np.flatnonzero(np.diff(point[order])) + 1):
        rows = rows[np.isfinite(rest[rows, 0])]
        if len(rows) > 1:
            off = np.linalg.norm(rest[rows] - np.median(rest[rows], axis=0), axis=1)
            rows = rows[off < SAME_SPOT_MM]
        if len(rows) > 1:
            moved.append(np.linalg.norm(offset[rows] - offset[rows].mean(axis=0), axis=1))
    return np.concatenate(moved)


if __name__ == "__main__":
    run(sys.modules[__name__], "benchmarks.living_motion")
