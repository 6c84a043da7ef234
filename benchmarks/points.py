"""Points that a front end leaves, that its poses triangulate anew, and that patches refine; and the surface from each.

    python -m benchmarks.points FILMS/* --json benchmarks/results/points.json

Of the largest submap, every film once, default settings, lens given: points from which depth is completed, number and
error. The error of a point is the median over its sightings of |log(z-depth / true depth)|, in the scale of the path's
Sim(3); median and mean over the points, the share that is off by more than a tenth, and the share that is off by less
than the error that completion is told to expect (63 to 68 %, if that is calibrated). Then F-score at 1 mm, precision
and recall of the mesh that is completed from them: one run, and the same run with depth and all that follows made from
the other two kinds of points. A row is added as each film ends; a stopped call goes on where it was. Rendered by
`python scripts/pages/points_page.py`.
"""

import argparse
import sys
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.common.living_truth import true_depth
from benchmarks.common.record import RunTable, in_percent, print_row
from benchmarks.common.rerun import without_depth
from benchmarks.common.runner import add_folders, run
from haustra.core.errors import HaustraError
from haustra.core.progress import SilentProgress
from haustra.core.sim3 import scale_of
from pipeline.compare import compare_run
from pipeline.config import Config
from pipeline.depth.rectification import Rectifier, make_rectifier
from pipeline.depth.sparse_depth import SparseDepthMaker
from pipeline.finished_run import Run
from pipeline.frontend.odometry.frame_io import frame_features
from pipeline.frontend.points_stage import STAGE, keep_points, triangulated
from pipeline.mapping.submap import Submap, refined_camera
from pipeline.run import reconstruct
from reconstruction.evaluation.trajectory_io import read_tum
from reconstruction.evaluation.trajectory_metrics import align_poses

OWN, ANEW, REFINED = "the front end's own", "triangulated anew", "refined"
FAR_OFF = 0.1

Array = NDArray[np.float64]


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add_folders(parser)
    parser.add_argument("--front-end", default="auto")


def measure(arguments: argparse.Namespace) -> None:
    table = RunTable(arguments.json)
    for film in arguments.folders:
        name = film.name if arguments.front_end == "auto" else f"{film.name}, {arguments.front_end}"
        if table.has(name, 0, REFINED):
            continue
        try:
            found = figures_of(film, arguments.front_end)
        except HaustraError as error:
            print(f"{name}: {error}")
            continue
        table.add(name, 0, found)
        for method, figures in found.items():
            print_row({"film": name, "kind": method} | figures)


def figures_of(film: Path, front_end: str) -> dict[str, dict[str, Any]]:
    """Of the three kinds of points."""
    with tempfile.TemporaryDirectory() as scratch:
        folder, config = Path(scratch), Config(camera=str(film / "camera.json"), front_end=front_end)
        made = reconstruct(film, folder / "refined", config)
        points = {OWN: made.submaps_of_front_end, ANEW: _triangulated(made, config)}
        runs = {REFINED: made}
        for number, (method, submaps) in enumerate(points.items()):
            with_points(made, submaps, folder / str(number))
            runs[method] = reconstruct(film, folder / str(number), config, resume=True)
        return {method: _figures(film, runs[method]) for method in (OWN, ANEW, REFINED)}


def _triangulated(made: Run, config: Config) -> list[Submap]:
    motion_px = config.odometry.keyframe_motion * made.frames.camera.width
    with frame_features(made.workspace) as features:
        again = triangulated(
            made.frames, features, made.submaps_of_front_end, motion_px, made.workspace, SilentProgress(), adjust=False
        )
    return [one.submap for one in again]


def with_points(made: Run, submaps: list[Submap], folder: Path) -> None:
    """A copy of a run whose depth is still to be made, from the points of `submaps`."""
    workspace = without_depth(made, folder)
    workspace.record["stages"].pop(STAGE)
    keep_points(submaps, made.frames, workspace)


def _figures(film: Path, made: Run) -> dict[str, Any]:
    submap = made.submaps_before_loops[0].submap
    rectifier = make_rectifier(refined_camera(made.frames.camera, submap))
    maker = SparseDepthMaker(submap, rectifier.camera)
    error = point_errors(film, submap, rectifier, maker.good)
    known = np.isfinite(error)
    error, within = error[known], (error < maker.error)[known]
    confirmed = np.isfinite(submap.known_depth_error)[known]
    compared = compare_run(made.folder, film)
    assert compared.surface is not None
    return {
        "points": len(error),
        "off_median_percent": float(100 * np.median(error)),
        "off_mean_percent": float(100 * error.mean()),
        "far_off_percent": float(100 * (error > FAR_OFF).mean()),
        "within_expected_percent": _percent(within),
        "confirmed": int(confirmed.sum()),
        "confirmed_within_expected_percent": _percent(within[confirmed]),
        "keyframes": made.metrics["submaps"][0]["keyframes"],
        **in_percent(compared.surface),
    }


def _percent(flags: NDArray[np.bool_]) -> float | None:
    """None of no flags."""
    return float(100 * flags.mean()) if len(flags) else None


def point_errors(film: Path, submap: Submap, rectifier: Rectifier, good: NDArray[np.bool_]) -> Array:
    """(P,) of the points that are good and seen where there is true depth; NaN of the others."""
    truth = read_tum(film / "trajectory.txt")[1][submap.frames]
    mm = float(scale_of(align_poses(submap.world_from_camera, truth)))
    row, point = submap.observations.T
    off, camera = np.full(len(row), np.nan), rectifier.camera
    depths = submap.depths()
    for number, frame in enumerate(submap.frames.tolist()):
        mine = np.flatnonzero((row == number) & good[point] & (depths > 0))
        pixels = camera.project(submap.points_in_camera(number, submap.points[point[mine]]))
        x, y = np.floor(pixels).astype(int).T
        inside = (x >= 0) & (y >= 0) & (x < camera.width) & (y < camera.height)
        true = true_depth(film, frame, rectifier)[y[inside], x[inside]]
        with np.errstate(divide="ignore"):
            off[mine[inside]] = np.abs(np.log(mm * depths[mine[inside]] / true))
    off[~np.isfinite(off)] = np.nan
    return _median_by(point, off, len(submap.points))


def _median_by(point: NDArray[np.int64], off: Array, count: int) -> Array:
    """(P,) the median of each point's finite values; NaN of a point without any."""
    known = np.isfinite(off)
    order = np.lexsort((off[known], point[known]))
    point, off = point[known][order], off[known][order]
    number = np.bincount(point, minlength=count)
    starts = np.cumsum(number) - number
    some = number > 0
    low, high = starts[some] + (number[some] - 1) // 2, starts[some] + number[some] // 2
    median = np.full(count, np.nan)
    median[some] = (off[low] + off[high]) / 2
    return median


if __name__ == "__main__":
    run(sys.modules[__name__], "benchmarks.points")
