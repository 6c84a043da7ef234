"""What physics allows on films whose wall moves: true poses, true depth and true motion in place of our own.

    python -m benchmarks.living FILMS/* --keep RUNS --name now
    python -m benchmarks.living_ceilings FILMS/* --runs RUNS --name now --json living_ceilings.json

Frames are fused by our own fusion, with its settings as `reconstruct` has them, and judged as `benchmarks.living` does:
F-score at 1 mm against the wall at rest. Poses and depth are the film's own or a run's, and the motion is left in, or
each depth is carried to the wall at rest by the true motion, which is what a perfect model of motion would do:

- true poses and depth, every SIXTH frame of the film, whether it is tracked or not;
- the keyframes of the run's largest submap, with the run's poses or true ones, and with true depth, the run's depth,
  or depth completed once more: from the run's points, each at its true depth, or from points that the true poses
  triangulate (`benchmarks/common/recompletion.py`).

A row is added as each film ends; a stopped call goes on where it was.
"""

import argparse
import sys
from collections.abc import Callable, Iterator
from functools import cache, partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from benchmarks.common.carried_depth import carried, points_of
from benchmarks.common.living_truth import TrueMotion, true_depth
from benchmarks.common.recompletion import from_true_points, from_true_poses
from benchmarks.common.record import RunTable, print_row
from benchmarks.common.runner import add_folders, run
from haustra.core.camera import read_camera
from haustra.core.errors import HaustraError
from pipeline.config import Config
from pipeline.depth.completed_submap import CompletedSubmap
from pipeline.depth.rectification import make_rectifier
from pipeline.finished_run import Run, open_run
from pipeline.surface.fusion_stage import MIN_COMPONENT, TRUNCATION_VOXELS, depth_filter, fusion_ranges
from reconstruction.evaluation.reference_surface import ReferenceSurface, read_reference_surface
from reconstruction.evaluation.surface_metrics import surface_errors
from reconstruction.evaluation.trajectory_io import read_tum
from reconstruction.evaluation.trajectory_metrics import align_poses
from reconstruction.fusion.tsdf import SurfaceFusion, TsdfSettings, choose_voxel_size
from reconstruction.mesh.surface_mesh import drop_small_components

SIXTH = 6
VOXEL_SAMPLES = 12

Array = NDArray[np.float64]
Depth = NDArray[np.float32]


class View(NamedTuple):
    """A posed frame in mm and the truth's axes: depth (H,W), confidence (H,W), world_from_camera (4,4)."""

    frame: int
    depth: Depth
    confidence: Depth
    world_from_camera: Array


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add_folders(parser)
    parser.add_argument("--runs", type=Path, help="folder of runs that `benchmarks.living` kept")
    parser.add_argument("--name", default="now", help="what those runs are called")


def measure(arguments: argparse.Namespace) -> None:
    """Every film once."""
    table = RunTable(arguments.json)
    for film in arguments.folders:
        for method, views, intrinsics in _sources(film, arguments):
            for motion in ("left in", "carried to rest"):
                name = f"{method}, motion {motion}"
                if table.has(film.name, 0, name):
                    continue
                figures = scores(film, views(), intrinsics, motion != "left in")
                table.add(film.name, 0, {name: figures})
                print_row({"film": film.name, "method": name} | figures)


def _sources(film: Path, arguments: argparse.Namespace) -> Iterator[tuple[str, Any, Array]]:
    """Names, views and pinholes (3,3) of what is fused of a film."""
    rectifier = make_rectifier(read_camera(film / "camera.json"))
    count = len(read_tum(film / "trajectory.txt")[0])
    yield "true poses, true depth", lambda: _true(film, range(0, count, SIXTH)), rectifier.camera.matrix
    folder = None if arguments.runs is None else arguments.runs / f"{film.name}_{arguments.name}"
    if folder is None or not folder.is_dir():
        return
    try:
        made = open_run(folder)
    except HaustraError:
        return
    completed = made.completed_submaps[0]
    intrinsics = completed.camera.matrix
    yield "run's poses, true depth", lambda: _with_true_depth(film, made, completed), intrinsics
    yield "run's poses, run's depth", lambda: _of_run(film, made, completed), intrinsics
    yield "true poses, run's depth", lambda: _with_true_poses(film, made, completed), intrinsics
    for name, complete in (("points at true depth", from_true_points), ("points of true poses", from_true_poses)):
        again = partial(_completed_again, film, made, cache(partial(complete, film, made)))
        yield f"true poses, depth from {name}", again, intrinsics


def _true(film: Path, frames: range) -> Iterator[View]:
    rectifier = make_rectifier(read_camera(film / "camera.json"))
    world_from_camera = read_tum(film / "trajectory.txt")[1]
    for frame in frames:
        depth = true_depth(film, frame, rectifier)
        yield View(frame, depth, (depth > 0).astype(np.float32), world_from_camera[frame])


def _of_run(film: Path, made: Run, completed: CompletedSubmap) -> Iterator[View]:
    """Keyframes of the largest submap as they are fused, moved by the Sim(3) of its poses."""
    config = made.workspace.config
    ranges = fusion_ranges(completed, config.fusion)
    assert ranges is not None
    check = depth_filter(completed, config.consistency, config.fusion, ranges)
    truth = read_tum(film / "trajectory.txt")[1]
    truth_from_run = align_poses(completed.submap.world_from_camera, truth[completed.submap.frames])
    scale = float(np.cbrt(np.linalg.det(truth_from_run[:3, :3])))
    for place, row in enumerate(map(int, completed.rows)):
        depth, confidence, world_from_camera = completed.depth(row)
        kept = check.confidence(place, confidence)
        if kept is not None:
            moved = truth_from_run @ world_from_camera
            moved[:3, :3] /= scale
            yield View(int(completed.submap.frames[row]), depth * np.float32(scale), kept, moved)


def _with_true_depth(film: Path, made: Run, completed: CompletedSubmap) -> Iterator[View]:
    for view in _of_run(film, made, completed):
        depth = true_depth(film, view.frame, completed.rectifier)
        yield View(view.frame, depth, (depth > 0).astype(np.float32), view.world_from_camera)


def _with_true_poses(film: Path, made: Run, completed: CompletedSubmap) -> Iterator[View]:
    truth = read_tum(film / "trajectory.txt")[1]
    for view in _of_run(film, made, completed):
        yield view._replace(world_from_camera=truth[view.frame])


def _completed_again(film: Path, made: Run, complete: Callable[[], CompletedSubmap]) -> Iterator[View]:
    return _with_true_poses(film, made, complete())


def scores(film: Path, views: Iterator[View], intrinsics: Array, to_rest: bool) -> dict[str, Any]:
    """F-score, precision and recall (%) of the views, fused."""
    chosen = list(views)
    samples = [view.depth for view in chosen[:: max(1, len(chosen) // VOXEL_SAMPLES)]]
    settings = Config().fusion
    voxel = choose_voxel_size(samples, intrinsics)
    fusion = SurfaceFusion(TsdfSettings(voxel, TRUNCATION_VOXELS, min_observations=settings.min_observations))
    motion = TrueMotion.of(film) if to_rest else None
    for view in chosen:
        rgb = np.zeros((*view.depth.shape, 3), np.uint8)
        view = view if motion is None else _at_rest(view, motion, intrinsics)
        fusion.integrate(rgb, view.depth, view.confidence, intrinsics, view.world_from_camera)
    mesh, _ = drop_small_components(fusion.extract(), MIN_COMPONENT)
    found = surface_errors(mesh, _reference(film), 1.0, np.random.default_rng(0))
    return {
        "frames": len(chosen),
        "voxel_mm": voxel,
        "f_score_percent": 100 * found.f_score,
        "precision_percent": 100 * found.precision,
        "recall_percent": 100 * found.recall,
    }


def _at_rest(view: View, motion: TrueMotion, intrinsics: Array) -> View:
    """The view of the wall at rest from the same place."""
    rotation, centre = view.world_from_camera[:3, :3], view.world_from_camera[:3, 3]
    known = view.depth > 0
    offsets = np.zeros((*view.depth.shape, 3), np.float32)
    offsets[known] = (
        motion.to_rest(points_of(view.depth, intrinsics)[known] @ rotation.T + centre, view.frame) @ rotation
    )
    found = carried(view.depth, offsets, intrinsics)
    return view._replace(depth=found.depth, confidence=found.image(view.confidence))


def _reference(film: Path) -> ReferenceSurface:
    return read_reference_surface(film)


if __name__ == "__main__":
    run(sys.modules[__name__], "benchmarks.living_ceilings")
