"""Surface from true poses by `--poses`, beside the ceiling: completed depth of a run without them, fused at true poses.

    haustra phantom SUITE --suite
    python -m benchmarks.reconstruction known-poses SUITE/* --json benchmarks/results/known_poses.json

Both runs are `--fast` with the lens given, by lossless frames. F-score at 1 mm of the run with poses after SE(3), in
its own mm; of the run without (odometry) after its path's Sim(3), as it is and with its keyframes put where they truly
were. A row is added as each film ends; a stopped call goes on where it was. Rendered by
`python scripts/pages/known_poses_page.py`.
"""

import argparse
import tempfile
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.common.record import RunTable, print_row
from benchmarks.common.runner import add_folders
from haustra.core.errors import HaustraError
from haustra.core.progress import SilentProgress
from haustra.core.sim3 import scale_of
from pipeline.compare import compare_run
from pipeline.config import FAST_KEYFRAME_MOTION, Config, OdometrySettings
from pipeline.depth.completed_submap import CompletedSubmap
from pipeline.finished_run import Run
from pipeline.given_settings import PoseSettings
from pipeline.run import reconstruct
from pipeline.surface.fusion_stage import SurfaceSettings, fuse_submap
from pipeline.surface.scale import Scale, ScaleSource
from reconstruction.evaluation.reference_surface import read_reference_surface
from reconstruction.evaluation.surface_metrics import surface_errors
from reconstruction.evaluation.trajectory_io import read_tum
from reconstruction.evaluation.trajectory_metrics import align_poses

METHOD = "true poses"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add_folders(parser)


def measure(arguments: argparse.Namespace) -> None:
    table = RunTable(arguments.json)
    for folder in arguments.folders:
        if not table.has(folder.name, 0, METHOD):
            figures = figures_of(folder)
            table.add(folder.name, 0, {METHOD: figures})
            print_row({"film": folder.name} | figures)


def figures_of(folder: Path) -> dict[str, Any]:
    """Of one film; a run that fails leaves its sentence."""
    given = PoseSettings(file=str(folder / "trajectory.txt"), mm_per_unit=1.0)
    figures: dict[str, Any] = {"with_poses": None, "without": None, "ceiling": None, "failed": None}
    with tempfile.TemporaryDirectory() as scratch:
        try:
            run = reconstruct(
                folder,
                Path(scratch) / "posed",
                _config(folder).model_copy(update={"poses": given, "front_end": "auto"}),
            )
            posed = compare_run(run.folder, folder)
            assert posed.surface_se3 is not None
            figures["with_poses"] = 100 * posed.surface_se3.f_score
            figures["frames"], figures["posed"] = posed.total, posed.posed
            run = reconstruct(folder, Path(scratch) / "tracked", _config(folder))
            tracked = compare_run(run.folder, folder)
            assert tracked.surface is not None
            figures |= {"without": 100 * tracked.surface.f_score, "tracked": tracked.posed}
            figures["ceiling"] = 100 * at_true_poses(run, folder)
        except HaustraError as error:
            figures["failed"] = str(error)
    return figures


def at_true_poses(run: Run, folder: Path) -> float:
    """F-score at 1 mm of the run's completed depth, fused with its keyframes where they truly were."""
    truth, completed = read_tum(folder / "trajectory.txt")[1], run.completed_submaps[0]
    mm_per_unit = float(scale_of(align_poses(completed.submap.world_from_camera, truth[completed.submap.frames])))
    moved = _moved(completed, truth[completed.submap.frames], mm_per_unit)
    config = run.workspace.config
    scale = ScaleSource(given=(Scale(mm_per_unit, "mm", "the true path"),))
    settings = SurfaceSettings(config.fusion, config.consistency, scale, config.seed)
    mesh = fuse_submap(moved, settings, "at true poses", SilentProgress()).mesh
    return surface_errors(mesh, read_reference_surface(folder), 1.0, np.random.default_rng(0), "mm").f_score


def _moved(completed: CompletedSubmap, truth: np.ndarray, mm_per_unit: float) -> CompletedSubmap:
    world_from_camera = truth.copy()
    world_from_camera[:, :3, 3] /= mm_per_unit
    return replace(completed, submap=replace(completed.submap, world_from_camera=world_from_camera))


def _config(folder: Path) -> Config:
    odometry = OdometrySettings(keyframe_motion=FAST_KEYFRAME_MOTION)
    return Config(camera=str(folder / "camera.json"), front_end="odometry", odometry=odometry)
