"""Finished runs as `haustra view` finds them, without any video."""

import shutil
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from pipeline.depth.depth_io import DEPTH_STEP
from pipeline.report.page.page import write_page
from pipeline.run_folder.workspace import write_json
from pipeline.surface.coverage_stage import CoverageResult
from tests.helpers.tiny_run import make_tiny_run

MADE: dict[tuple[str, int, bool], Path] = {}  # where a run of these arguments was made first


def make_shown_run(root: Path, film: str = "0", frames: int = 90, judged: bool = True) -> None:
    """A tiny run with its report, record, metrics and path; film: what stands for the digest of its source; judged:
    whether its coverage was. One that was made before is copied."""
    same = MADE.setdefault((film, frames, judged), root)
    if same != root and same.is_dir():
        shutil.copytree(same, root)
        return
    root.mkdir(parents=True)
    run = make_tiny_run(root, frames)
    run.workspace.record["source"]["sha256"]["source"] = film
    if not judged:
        run.coverage[0] = CoverageResult({"judged": False, "reason": "too open"}, None)
        run.metrics["submaps"][0]["coverage"] = run.coverage[0].record
        (root / "coverage.png").unlink()
    write_page(*run.parts)
    write_json(run.workspace.metrics, run.metrics)
    run.workspace.record["stages"]["report"] = {}
    run.workspace.record["submaps"] = [
        {
            "unit": surface.scale.unit,
            "depth_png_step": DEPTH_STEP * surface.scale.factor,
            "keyframes": completed.submap.frames[completed.rows].tolist(),
            "depth_scale": None,
        }
        for completed, surface in zip(run.completed, run.surfaces, strict=True)
    ]
    run.workspace.save()
    submap = run.completed[0].submap
    lines = [
        tum_line(
            run.frames.seconds_of(int(frame)), world_from_camera[:3, 3], Rotation.from_matrix(world_from_camera[:3, :3])
        )
        for frame, world_from_camera in zip(submap.frames, submap.world_from_camera, strict=True)
    ]
    run.workspace.trajectory.write_text("".join(lines))


def tum_line(seconds: float, centre: np.ndarray, turn: Rotation) -> str:
    return f"{seconds:.6f} " + " ".join(f"{value:.9f}" for value in (*centre, *turn.as_quat())) + "\n"
