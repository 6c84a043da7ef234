"""Coverage against the phantoms' own flags: error of the percentage, missed regions found, not found and false.

    python -m benchmarks.coverage FILMS/* --json coverage.json
    python -m benchmarks.coverage CHOOSING/* --role chosen --json coverage.json

Each film by both methods, or by those named. *reconstruct*: a run of the lossless frames with default settings, lens
given, odometry. *true depth*: every frame's true depth, made a pinhole's, fused at the true pose in voxels of 0.7 mm,
with one voxel of edge tolerance and without the test of depth support, which is for completed depth. Definitions of
found and false, and of the shares, are in `reconstruction/evaluation/coverage_metrics.py`; regions are those over 5 mm.
A film that cannot be judged has its sentence in place of figures. A row is added as each ends; a stopped call goes on
where it was. Rendered by `python -m scripts.pages.surface.coverage_page > docs/lab/coverage.md`.
"""

import argparse
import sys
import tempfile
from dataclasses import asdict
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from benchmarks.common.record import RunTable, print_row
from benchmarks.common.runner import add_folders, run
from haustra.core.camera import read_camera
from haustra.core.errors import HaustraError
from haustra.core.ray_table import RayTable
from pipeline.compare import compare_run
from pipeline.config import Config
from pipeline.depth.rectification import make_rectifier
from pipeline.run import reconstruct
from pipeline.surface.coverage_stage import half_field_of_view, lens_field_of_view
from reconstruction.coverage.coverage import measure_coverage
from reconstruction.evaluation.coverage_metrics import CoverageErrors, coverage_errors, read_true_wall
from reconstruction.evaluation.trajectory_io import read_tum
from reconstruction.fusion.tsdf import SurfaceFusion, TsdfSettings
from reconstruction.mesh.surface_mesh import SurfaceMesh, drop_small_components

VOXEL_MM = 0.7
TRUNCATION = 5  # voxels; true depth needs no more
EDGE_VOXELS = 1.0  # true depth ends no earlier than its voxels
SMALLEST_PIECE = 0.002  # share of the area
# What a film is to the coverage code: rendered when all was settled; known while something was settled; or chosen on.
ROLES = ("reported", "looked at", "chosen")
TRUE_DEPTH, RECONSTRUCT = "true depth", "reconstruct"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add_folders(parser)
    parser.add_argument("--role", choices=ROLES, default=ROLES[0], help="what the films are to the coverage code")
    parser.add_argument("--method", choices=(TRUE_DEPTH, RECONSTRUCT), action="append", help="repeatable; both if none")
    parser.add_argument("--keep", type=Path, help="folder for the runs, which are removed otherwise")


def measure(arguments: argparse.Namespace) -> None:
    """Every film by every method."""
    table = RunTable(arguments.json)
    for film in arguments.folders:
        for method in arguments.method or (TRUE_DEPTH, RECONSTRUCT):
            if not table.has(film.name, 0, method):
                found = of_true_depth(film) if method == TRUE_DEPTH else of_a_run(film, arguments.keep)
                row = {"role": arguments.role, "suite": film.resolve().parent.name} | found
                table.add(film.name, 0, {method: row})
                print_row({"film": film.name, "method": method} | row | {"regions": len(row.get("regions", []))})


def of_true_depth(film: Path) -> dict[str, Any]:
    """True depth of every frame at its true pose."""
    wall = read_true_wall(film / "mesh.ply")
    if wall is None:
        raise HaustraError(f"{film}/mesh.ply does not know what was not seen")
    lens = read_camera(film / "camera.json")
    rays, pinhole = RayTable(lens), make_rectifier(lens).camera
    (mesh, content), (_, world_from_camera) = fuse_truth(film), read_tum(film / "trajectory.txt")
    try:
        half, picture = half_field_of_view(rays, pinhole, content), lens_field_of_view(rays, content)
        coverage = measure_coverage(mesh, world_from_camera, half, "mm", EDGE_VOXELS * VOXEL_MM, picture)
        return figures_of(coverage_errors(coverage, wall))
    except HaustraError as reason:
        return {"failed": str(reason)}


def fuse_truth(film: Path) -> tuple[SurfaceMesh, NDArray[np.uint8]]:
    """Mesh in mm of every frame's true depth and colour at its true pose; and which pixels (H,W) ever show wall."""
    lens = read_camera(film / "camera.json")
    rectifier = make_rectifier(lens)
    _, world_from_camera = read_tum(film / "trajectory.txt")
    fusion = SurfaceFusion(TsdfSettings(VOXEL_MM, truncation=TRUNCATION))
    content = np.zeros((lens.height, lens.width), bool)
    for number, pose in enumerate(world_from_camera):
        rgb = cv2.cvtColor(cv2.imread(str(film / "rgb" / f"{number:05d}.png")), cv2.COLOR_BGR2RGB)
        stored: Any = cv2.imread(str(film / "depth" / f"{number:05d}.png"), cv2.IMREAD_UNCHANGED)
        content |= stored > 0
        depth = rectifier.mask(stored).astype(np.float32) * np.float32(0.01)
        fusion.integrate(rectifier.image(rgb), depth, None, rectifier.camera.matrix, pose)
    return drop_small_components(fusion.extract(), SMALLEST_PIECE)[0], content.astype(np.uint8)


def of_a_run(film: Path, keep: Path | None) -> dict[str, Any]:
    """A run, or the finished one that `keep` has of this film."""
    with tempfile.TemporaryDirectory() as scratch:
        folder = (keep or Path(scratch)) / film.name
        config = Config(camera=str(film / "camera.json"), front_end="odometry")
        try:
            reconstruct(film, folder, config, resume=folder.exists())
        except HaustraError as reason:
            return {"failed": str(reason)}
        compared = compare_run(folder, film)
    assert compared.surface is not None
    if not isinstance(compared.coverage, CoverageErrors):
        return {"failed": str(compared.coverage).removeprefix("not judged: ")}
    surface = {"f_score_percent": 100 * compared.surface.f_score, "recall_percent": 100 * compared.surface.recall}
    return figures_of(compared.coverage) | surface


def figures_of(errors: CoverageErrors) -> dict[str, Any]:
    """Percentages, lengths in mm, counts of regions."""
    return {
        "visited_mm": errors.length,
        "estimated_percent": 100 * errors.estimated,
        "true_percent": 100 * errors.true,
        "error_points": errors.error_points,
        "area_of_true": errors.estimated_area / errors.true_area,
        "true_regions": errors.true_regions,
        "found": errors.found,
        "reported_regions": errors.estimated_regions,
        "false": errors.false,
        "hidden_called_seen_percent": 100 * errors.hidden_called_seen,
        "seen_called_missed_percent": 100 * errors.seen_called_missed,
        "regions": [asdict(region) for region in errors.judged],
        "failed": None,
    }


if __name__ == "__main__":
    run(sys.modules[__name__], "benchmarks.coverage")
