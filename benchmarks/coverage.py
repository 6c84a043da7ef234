"""Coverage against the phantom's own flags: error of the percentage, missed regions found, not found, false.

    python -m benchmarks.coverage SUITE/* --json coverage.json        # true depth at true poses, fused
    python -m benchmarks.coverage SUITE/flexure --run RUN             # a finished run of that film, end to end

The first isolates the coverage code from the front end: every frame's true depth, made a pinhole's, is fused at the
true pose, so what is left is how voxels end short of what was seen and how the closing stands for hidden wall. Its
figures are given for several fringes, in voxels; `measure_coverage` is used with one. "Frontier alone" leaves plain
view out. Definitions of found and false are in `reconstruction/evaluation/coverage_metrics.py`.
"""

import argparse
import sys
from dataclasses import asdict
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from benchmarks.common.runner import add_folders, run
from haustra.core.camera import read_camera
from haustra.core.ray_table import RayTable
from pipeline.compare import compare_run
from pipeline.depth.rectification import make_rectifier
from pipeline.surface.coverage_stage import half_field_of_view, lens_field_of_view
from reconstruction.coverage.coverage import measure_coverage
from reconstruction.coverage.visibility import FieldOfView
from reconstruction.evaluation.coverage_metrics import CoverageErrors, coverage_errors, read_true_wall
from reconstruction.evaluation.trajectory_io import read_tum
from reconstruction.fusion.tsdf import SurfaceFusion, TsdfSettings
from reconstruction.mesh.surface_mesh import SurfaceMesh, drop_small_components

VOXEL_MM = 0.7
TRUNCATION = 5  # voxels; true depth needs no more
WIDEST_DEG = 120.0  # as in `reconstruct`
SMALLEST_PIECE = 0.002  # share of the area
FRINGES = (0.0, 0.5, 1.0, 1.5)  # voxels
USED_FRINGE = 1.0


def fuse_truth(folder: Path, every: int) -> tuple[SurfaceMesh, NDArray[np.uint8]]:
    """Mesh in mm of every `every`-th frame's true depth and colour at its true pose; and which pixels show wall."""
    lens = read_camera(folder / "camera.json")
    rectifier = make_rectifier(lens, WIDEST_DEG)
    _, world_from_camera = read_tum(folder / "trajectory.txt")
    fusion = SurfaceFusion(TsdfSettings(VOXEL_MM, truncation=TRUNCATION))
    content = np.zeros((lens.height, lens.width), bool)
    for number in range(0, len(world_from_camera), every):
        rgb = cv2.cvtColor(cv2.imread(str(folder / "rgb" / f"{number:05d}.png")), cv2.COLOR_BGR2RGB)
        stored: Any = cv2.imread(str(folder / "depth" / f"{number:05d}.png"), cv2.IMREAD_UNCHANGED)
        content |= stored > 0
        depth = rectifier.mask(stored).astype(np.float32) * np.float32(0.01)
        fusion.integrate(rectifier.image(rgb), depth, None, rectifier.camera.matrix, world_from_camera[number])
    return drop_small_components(fusion.extract(), SMALLEST_PIECE)[0], content.astype(np.uint8)


def errors_of_truth(folder: Path, every: int) -> tuple[dict[float, CoverageErrors], CoverageErrors]:
    """Errors at each fringe, and those of the frontier alone at the fringe that is used."""
    wall = read_true_wall(folder / "mesh.ply")
    if wall is None:
        raise SystemExit(f"{folder}/mesh.ply does not know what was not seen")
    lens = read_camera(folder / "camera.json")
    rays, pinhole = RayTable(lens), make_rectifier(lens, WIDEST_DEG).camera
    (mesh, content), (_, world_from_camera) = fuse_truth(folder, every), read_tum(folder / "trajectory.txt")
    half, picture = half_field_of_view(rays, pinhole, content), lens_field_of_view(rays, content)

    def errors(fringe: float, field_of_view: FieldOfView | None) -> CoverageErrors:
        return coverage_errors(
            measure_coverage(mesh, world_from_camera, half, "mm", fringe * VOXEL_MM, field_of_view), wall
        )

    return {fringe: errors(fringe, picture) for fringe in FRINGES}, errors(USED_FRINGE, None)


def end_to_end(folder: Path, run_folder: Path) -> dict[str, Any]:
    """Errors of a finished run's coverage."""
    errors = compare_run(run_folder, folder).coverage
    print(f"{folder.name:16} {errors}")
    figures = asdict(errors) if isinstance(errors, CoverageErrors) else errors
    return {"film": folder.name, "run": run_folder.name, "end_to_end": figures}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add_folders(parser)
    parser.add_argument("--run", type=Path, help="a finished run of the one folder given")
    parser.add_argument("--every", type=int, default=1, help="use every n-th frame's depth")


def measure(arguments: argparse.Namespace) -> dict[str, Any]:
    """One run end to end, or every folder's true depth."""
    if arguments.run:
        return end_to_end(arguments.folders[0], arguments.run)
    results, totals = {}, np.zeros(4, int)
    for folder in arguments.folders:
        by_fringe, frontier = errors_of_truth(folder, arguments.every)
        used = by_fringe[USED_FRINGE]
        totals += (used.true_regions, used.found, used.estimated_regions, used.false)
        points = {fringe: errors.error_points for fringe, errors in by_fringe.items()}
        results[folder.name] = {
            "errors": asdict(used),
            "frontier_alone": asdict(frontier),
            "error_points_by_fringe": {str(fringe): error for fringe, error in points.items()},
        }
        listed = ", ".join(f"{error:+.1f} at {fringe:g}" for fringe, error in points.items())
        print(f"{folder.name:16} {used}; by fringe: {listed}; frontier alone: {frontier}", flush=True)
    true, found, reported, false = totals.tolist()
    share = 100 * found / max(true, 1)
    print(f"regions over 5 mm: {found} of {true} found ({share:.0f} %), {false} of {reported} false")
    return {"voxel_mm": VOXEL_MM, "every": arguments.every, "sequences": results}


if __name__ == "__main__":
    run(sys.modules[__name__], "benchmarks.coverage")
