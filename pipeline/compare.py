"""A run against truth: errors of the camera path, the surface and the coverage, each with protocol, unit and count."""

from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from haustra.core.errors import HaustraError
from pipeline.finished_run import Run, open_run
from pipeline.input.pose_files.colmap_poses import images_file
from pipeline.input.pose_files.pairing import paired
from pipeline.truth.data_set_truth import DataSetTruth
from pipeline.truth.film_part import FilmPart, cut_note
from pipeline.truth.hints import Timed, path_hints, surface_hint
from pipeline.truth.registry import TRUTH_READERS, read_data_set_truth
from reconstruction.coverage.centreline import NotATube
from reconstruction.evaluation.coverage_metrics import CoverageErrors, coverage_errors, read_true_wall
from reconstruction.evaluation.reference_surface import (
    SPACING_MM,
    ReferenceSurface,
    has_wall_by_frames,
    read_reference_surface,
)
from reconstruction.evaluation.surface_metrics import SurfaceErrors, surface_errors
from reconstruction.evaluation.trajectory_io import read_tum
from reconstruction.evaluation.trajectory_metrics import (
    SimCol3DErrors,
    TrajectoryErrors,
    align_poses,
    simcol3d_errors,
    trajectory_errors,
)
from reconstruction.mesh.formats import MESH_FORMATS
from reconstruction.mesh.mesh_io import read_mesh
from reconstruction.mesh.surface_mesh import SurfaceMesh

LEAST_TAU_MM = 0.2  # the truth's points must be half as far apart, and those of a colon are then two million


@dataclass(frozen=True)
class Comparison:
    """Errors of the main submap; `surface` is None where the truth has none, `se3` and `surface_se3`, in the run's own
    millimetres, where it has none.

    `coverage` is a sentence where it cannot be judged or compared, and None where the truth has no wall. `hints`:
    sentences on poses, clocks and units that would explain a bad fit. `notes`: what of the truth was left out.
    """

    posed: int
    total: int
    submaps: int
    sim3: TrajectoryErrors
    se3: TrajectoryErrors | None
    simcol3d: SimCol3DErrors
    surface: SurfaceErrors | None
    coverage: CoverageErrors | str | None = None
    hints: tuple[str, ...] = ()
    surface_se3: SurfaceErrors | None = None
    notes: tuple[str, ...] = ()

    def to_dict(self) -> dict[str, Any]:
        return asdict(self)

    def __str__(self) -> str:
        others = f" in {self.submaps} submaps, of which the largest alone is compared" if self.submaps > 1 else ""
        lines = [f"frames      {self.posed} of {self.total} posed{others}"]
        for errors, name in ((self.sim3, "Sim(3)"), (self.se3, "SE(3)")):
            if errors is not None:
                scale = f", scale {errors.scale:.4f}" if name == "Sim(3)" else " without a scale"
                lines.append(
                    f"ATE         RMSE {errors.ate_rmse:.4f}, median {errors.ate_median:.4f} {errors.unit}; rotation "
                    f"median {errors.rotation_median_deg:.3f}, max {errors.rotation_max_deg:.3f} deg "
                    f"({errors.count} camera centres after {name} alignment{scale})"
                )
        chained = self.simcol3d
        lines.append(
            f"SimCol3D    by its protocol: ATE {chained.ate_median:.4f} {chained.unit}, RTE {chained.rte_median:.4f} "
            f"{chained.unit}, ROT {chained.rot_median_deg:.3f} deg (medians over {chained.count} motions between "
            "neighbouring posed frames, chained from the first pose, one scale, no rotation fitted)"
        )
        if self.surface is not None:
            lines.append(f"surface     {self.surface}")
        if self.surface_se3 is not None:
            lines.append(f"  in mm     {self.surface_se3}, moved by the path's SE(3)")
        if self.coverage is not None:
            lines.append(f"coverage    {self.coverage}")
        lines += [f"truth       {note}" for note in self.notes]
        lines += [f"CAUTION     {hint}" for hint in self.hints]
        return "\n".join(lines)


def compare_run(run: Path, truth: Path, tau: float = 1.0) -> Comparison:
    """Compare a finished run with an RGB-D folder or a TUM file.

    The surface is moved by the Sim(3) that is fitted to the camera poses alone, so that a wrong surface cannot hide
    behind its own alignment; of a run in mm by their SE(3), too. A mesh without a path is refused: the run's frame and
    unit are arbitrary.
    """
    if not 0 < tau < np.inf:
        raise HaustraError(f"the F-score needs a positive distance, not {tau:g}")
    finished = open_run(run)
    metrics = finished.metrics
    seconds, world_from_camera = finished.trajectory()
    true_seconds, true_world_from_camera = true_path(truth, finished)
    if len(true_seconds) < 3:
        raise HaustraError(f"{truth} has {len(true_seconds)} poses; three are needed")
    mine, theirs = paired(seconds, true_seconds, truth)
    estimated, true = world_from_camera[mine], true_world_from_camera[theirs]
    sim3 = trajectory_errors(estimated, true, "sim3", "mm")
    # Without a scale of its own the run's path has another unit: only Sim(3) means anything.
    se3 = trajectory_errors(estimated, true, "se3", "mm") if metrics["submaps"][0]["unit"] == "mm" else None
    simcol3d = simcol3d_errors(estimated, true, "mm")
    part = FilmPart.of(finished.workspace)
    of_whole = not part.is_less_than(true_seconds)
    known = read_data_set_truth(truth) if truth.is_dir() else None
    points, surface, surface_se3 = _true_surface(truth, known, spacing_of(tau), true_seconds, part), None, None
    truth_from_run = align_poses(estimated, true)
    coverage = _coverage(finished, truth_from_run, truth, known, of_whole)
    if points is not None:
        mesh = read_mesh(finished.mesh)
        surface = _surface(mesh, truth_from_run, points, tau)
        if se3 is not None:
            surface_se3 = _surface(mesh, align_poses(estimated, true, with_scale=False), points, tau)
    true_path_of_run = Timed(true_seconds, true_world_from_camera[:, :3, 3])
    path = Timed(seconds, world_from_camera[:, :3, 3])
    hints = path_hints(path, true_path_of_run, estimated, true, sim3.scale, se3 is not None)
    of_wall = surface_hint(points.seen, true_path_of_run.centres) if points is not None else ""
    of_part = part_hint(truth, known) if points is not None and not of_whole else ""
    found = tuple(hint for hint in (*hints, of_wall, of_part) if hint)
    notes = cut_note(part, true_seconds) if points is not None and _knows_wall_by_frames(truth, known) else ()
    counts = metrics["frames"]["posed"], metrics["frames"]["total"], len(finished.submaps)
    return Comparison(*counts, sim3, se3, simcol3d, surface, coverage, found, surface_se3, notes)


def part_hint(truth: Path, known: DataSetTruth | None) -> str:
    """A sentence where a run is of a part of the film, and its surface is measured against the wall of the whole."""
    if _knows_wall_by_frames(truth, known):
        return ""
    return "the run is of a part of the film and the true wall of the whole: recall counts what the run never saw"


def _knows_wall_by_frames(truth: Path, known: DataSetTruth | None) -> bool:
    return known is not None or has_wall_by_frames(truth)


def spacing_of(tau: float) -> float:
    """Spacing of the truth's points, mm: wider than half the distance of the F-score, they would cost a perfect surface
    it."""
    return min(SPACING_MM, tau / 2)


def _surface(
    mesh: SurfaceMesh, truth_from_run: NDArray[np.float64], points: ReferenceSurface, tau: float
) -> SurfaceErrors:
    return surface_errors(mesh.transformed(truth_from_run), points, tau, np.random.default_rng(0), "mm")


def _coverage(
    run: Run, truth_from_run: NDArray[np.float64], truth: Path, known: DataSetTruth | None, of_whole: bool
) -> CoverageErrors | str | None:
    """The run's own coverage, moved to the truth, against the true wall's own flags."""
    if not truth.is_dir():
        return None
    wall = known.wall if known is not None else None
    if wall is None and (truth / "mesh.ply").exists():
        wall = read_true_wall(truth / "mesh.ply")
        if wall is None:
            return "not compared: mesh.ply of the truth does not hold the wall that no frame saw"
    if wall is None:
        return None
    if not of_whole:
        return "not compared: the run is of a part of the film, and the truth knows what the whole of it saw"
    try:
        coverage = run.measure_coverage()
    except NotATube as reason:
        return f"not judged: {reason}"
    return coverage_errors(coverage.transformed(truth_from_run), wall)


def is_colmap_model(path: Path) -> bool:
    """Whether a path is that of a COLMAP model: its images file, or a folder with one that is no RGB-D folder, with
    trajectory.txt, and no data set's, whose own truth counts."""
    if not path.exists() or (path / "trajectory.txt").exists() or images_file(path) is None:
        return False
    return path.is_file() or read_data_set_truth(path) is None


def true_path(truth: Path, run: Run) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Seconds (N,) and world_from_camera (N,4,4), mm, of an RGB-D folder, a data set's folder or a TUM file."""
    if is_colmap_model(truth):
        raise HaustraError(
            f"{truth} holds images of a COLMAP model, which have no times: compare it with --protocol climb, or give a "
            "TUM file or an RGB-D folder"
        )
    if truth.is_dir() and (known := read_data_set_truth(truth)) is not None:
        seconds = known.seconds
        if seconds is None:  # a pose for each frame: at the time that the run gives it
            seconds = run.frames.seconds_of_numbers(np.arange(len(known.world_from_camera)))
        return seconds, known.world_from_camera
    if truth.is_dir():
        trajectory = truth / "trajectory.txt"
        if not trajectory.exists():
            others = ", ".join(TRUTH_READERS)
            raise HaustraError(f"{truth} has no truth: neither trajectory.txt of an RGB-D folder, nor one of {others}")
        return read_tum(trajectory)
    if not truth.exists():
        raise HaustraError(f"there is no file or folder {truth}")
    if truth.suffix.lower() in (".tum", ".txt", ".csv", "") and truth.is_file():
        return read_tum(truth)
    if truth.suffix.lower() in MESH_FORMATS and truth.is_file():
        raise HaustraError(f"{truth} is a mesh without a path to align by; put trajectory.txt beside a mesh.ply")
    raise HaustraError(f"{truth} is neither an RGB-D folder nor a TUM trajectory")


def _true_surface(
    truth: Path, known: DataSetTruth | None, spacing_mm: float, seconds: NDArray[np.float64], part: FilmPart
) -> ReferenceSurface | None:
    """The surface that the truth shows, in points `spacing_mm` apart, to frames of a part of the film alone where it
    knows what each frame saw; None where it has none. seconds: (N,) of the true poses."""
    if not truth.is_dir():
        return None
    if 2 * spacing_mm < LEAST_TAU_MM:
        raise HaustraError(
            f"the F-score at {2 * spacing_mm:g} mm cannot be measured; from {LEAST_TAU_MM:g} mm on it can (--tau-mm)"
        )
    if known is not None:
        return known.surface(spacing_mm, part.holds(seconds))
    has_surface = (truth / "depth").is_dir() or (truth / "mesh.ply").exists()
    between_s = part.from_s, part.to_s
    return read_reference_surface(truth, spacing_mm=spacing_mm, between_s=between_s) if has_surface else None
