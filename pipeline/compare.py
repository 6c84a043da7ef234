"""A run against truth: the camera path's error, and the surface's, each with protocol, unit and count."""

import json
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pipeline.errors import HaustraError
from pipeline.workspace import open_workspace
from reconstruction.export import read_mesh
from reconstruction.observed_truth import ObservedTruth, observed_truth, truth_from_mesh
from reconstruction.surface_metrics import SurfaceErrors, surface_errors
from reconstruction.trajectory import (
    SimCol3DErrors,
    TrajectoryErrors,
    align_umeyama,
    associate,
    read_tum,
    simcol3d_errors,
    trajectory_errors,
)

Path3D = tuple[NDArray[np.float64], NDArray[np.float64]]


@dataclass(frozen=True)
class Comparison:
    """Errors of the main submap; None where the truth has no path or no surface."""

    posed: int
    total: int
    sim3: TrajectoryErrors | None
    se3: TrajectoryErrors | None
    simcol3d: SimCol3DErrors | None
    surface: SurfaceErrors | None

    def to_dict(self) -> dict[str, Any]:
        return asdict(self)

    def __str__(self) -> str:
        lines = [f"frames      {self.posed} of {self.total} posed"]
        for errors, name in ((self.sim3, "Sim(3)"), (self.se3, "SE(3)")):
            if errors is not None:
                lines.append(
                    f"ATE         RMSE {errors.ate_rmse:.4f}, median {errors.ate_median:.4f} {errors.unit}; rotation "
                    f"median {errors.rotation_median_deg:.3f}, max {errors.rotation_max_deg:.3f} deg "
                    f"({errors.count} camera centres after {name} alignment, scale {errors.scale:.4f})"
                )
        if (chained := self.simcol3d) is not None:
            lines.append(
                f"SimCol3D    ATE {chained.ate_median:.4f}, RTE {chained.rte_median:.4f} {chained.unit}, "
                f"ROT {chained.rot_median_deg:.3f} deg (medians over {chained.count} motions, chained from the first "
                "pose, one scale, no rotation fitted)"
            )
        if self.surface is not None:
            lines.append(f"surface     {self.surface}")
        return "\n".join(lines)


def compare_run(run: Path, truth: Path, tau: float = 1.0) -> Comparison:
    """Compare a finished run with an RGB-D folder, a TUM file, or a mesh that is in the run's own frame.

    The surface is moved by the Sim(3) that is fitted to the camera centres alone, so that a wrong surface cannot
    hide behind its own alignment.
    """
    workspace = open_workspace(run)
    if not workspace.is_done("report"):
        raise HaustraError(f"the run {run} is not finished; go on with --resume")
    metrics = json.loads(workspace.metrics.read_text())
    seconds, poses = read_tum(workspace.trajectory)
    path, points = _load_truth(truth)
    sim3 = se3 = simcol3d = None
    truth_from_run = np.eye(4)
    if path is not None:
        # Half the truth's frame spacing: closer than any other frame.
        mine, theirs = associate(seconds, path[0], max_difference=0.5 * float(np.median(np.diff(path[0]))))
        if len(mine) < 3:
            raise HaustraError(f"only {len(mine)} frames of {run} have a true pose in {truth}; three are needed")
        estimated, true = poses[mine], path[1][theirs]
        truth_from_run = align_umeyama(estimated[:, :3, 3], true[:, :3, 3], with_scale=True)
        sim3 = trajectory_errors(estimated, true, "sim3", "mm")
        # Without a scale of its own the run's path has another unit: only Sim(3) means anything.
        se3 = trajectory_errors(estimated, true, "se3", "mm") if metrics["submaps"][0]["unit"] == "mm" else None
        simcol3d = simcol3d_errors(estimated, true, "mm")
    surface = None
    if points is not None:
        mesh = read_mesh(workspace.mesh).transformed(truth_from_run)
        surface = surface_errors(mesh, points, tau, np.random.default_rng(0), "mm")
    return Comparison(metrics["frames"]["posed"], metrics["frames"]["total"], sim3, se3, simcol3d, surface)


def _load_truth(truth: Path) -> tuple[Path3D | None, ObservedTruth | None]:
    """(seconds and poses, surface points) of a truth, each None where it is not given."""
    if truth.is_dir():
        trajectory = truth / "trajectory.txt"
        if not trajectory.exists():
            raise HaustraError(f"{truth} is no RGB-D folder with truth: it has no trajectory.txt")
        return read_tum(trajectory), observed_truth(truth)
    if truth.suffix in (".tum", ".txt") and truth.is_file():
        return read_tum(truth), None
    if truth.suffix in (".ply", ".obj", ".stl", ".glb") and truth.is_file():
        return None, truth_from_mesh(truth)
    raise HaustraError(f"{truth} is neither an RGB-D folder, nor a TUM trajectory, nor a mesh")
