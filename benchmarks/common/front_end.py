"""Kernels of a front end that several benchmarks run alone, and the errors of the submaps that it leaves."""

import os
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from haustra.core.camera import Camera
from haustra.core.progress import SilentProgress
from haustra.core.ray_table import RayTable
from pipeline.config import Config
from pipeline.frontend.odometry.tracking import Odometry
from pipeline.input.frames import Frames, read_frames
from pipeline.input.video import Source
from pipeline.mapping.local_map import LocalMap
from pipeline.mapping.submap import Submap
from pipeline.matching.sift_cache import ReadFrame
from pipeline.run_folder.creating import create_workspace
from pipeline.run_folder.workspace import Workspace
from reconstruction.evaluation.trajectory_metrics import trajectory_errors

WRONG_DEG = 5.0
MIN_FRAMES = 3  # for an alignment


def store(folder: Path, config: Config, root: Path) -> tuple[Frames, Workspace]:
    """The working frames of a film, decoded and judged into a new run folder."""
    workspace = create_workspace(root, folder, config, overwrite=True)
    return read_frames(Source(folder), config.camera, config.frames, workspace, SilentProgress()), workspace


def tracked_maps(camera: Camera, read: ReadFrame, index: NDArray[np.int64]) -> list[LocalMap]:
    """The maps of these frames (N,) as odometry's tracking leaves them."""
    odometry = Odometry(RayTable(camera), 0)
    for frame in index.tolist():
        rgb, mask = read(frame)
        odometry.process(frame, rgb, odometry.view(rgb, mask))
    return odometry.finish()


def processor_seconds() -> float:
    """Of this process and of the children that have ended: COLMAP runs in one."""
    spent = os.times()
    return spent.user + spent.system + spent.children_user + spent.children_system


def path_errors(submaps: list[Submap], truth: NDArray[np.float64]) -> dict[str, Any]:
    """Against true poses (N,4,4) in mm; each submap aligned for itself, as each has a world and a scale of its own.

    ate_mm: over all posed frames; largest: of the first submap alone; wrong: a submap's median rotation error exceeds
    `WRONG_DEG`. Empty where no submap has `MIN_FRAMES` frames.
    """
    judged = [
        (len(submap.frames), trajectory_errors(submap.world_from_camera, truth[submap.frames]))
        for submap in submaps
        if len(submap.frames) >= MIN_FRAMES
    ]
    if not judged:
        return {}
    total = sum(count for count, _ in judged)
    return {
        "ate_mm": float(np.sqrt(sum(count * e.ate_rmse**2 for count, e in judged) / total)),
        "largest": {"frames": judged[0][0], "ate_mm": judged[0][1].ate_rmse},
        "rotation_deg": float(np.average([e.rotation_median_deg for _, e in judged], weights=[c for c, _ in judged])),
        "wrong": any(e.rotation_median_deg > WRONG_DEG for _, e in judged),
    }
