"""What the pages ask of one run: its frames, painted depth and confidence, coverage, and the report's 3-D data."""

import json
import re
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from haustra.core.errors import HaustraError
from pipeline.depth.depth_io import read_confidence
from pipeline.report.page.keyframe_gallery import CONFIDENCE_MAP, DEPTH_MAP, painted, ramp
from pipeline.report.viewer.depth_colours import depth_scales, painted_depth
from pipeline.run_folder.workspace import Workspace, open_workspace, report_corruption
from pipeline.surface.scale import unit_label
from reconstruction.evaluation.trajectory_io import read_tum
from reconstruction.evaluation.trajectory_metrics import associate

NEAR_S = 1.0  # a missed region is shown while the film is so near to the frame that looked towards it
SCENE = re.compile(r'<script type="application/json" id="run-data">(.*?)</script>', re.DOTALL)


def scene_json(folder: Path) -> bytes:
    """The data of the report's 3-D view, as the report holds it. HaustraError without a report."""
    report = Workspace(folder).report
    found = SCENE.search(report.read_text(encoding="utf-8")) if report.exists() else None
    if found is None:
        raise HaustraError(f"the run {folder} has no report")
    return found.group(1).encode()


def player_data(folder: Path) -> dict[str, Any]:
    """Frames on disk with their times, keyframes, unit; coverage and missed regions of the largest submap."""
    workspace = open_workspace(folder)
    with report_corruption(workspace.frames):
        frames = json.loads(workspace.frames.read_text())["frames"]
    with report_corruption(workspace.metrics):
        metrics = json.loads(workspace.metrics.read_text())
    used = [(index, seconds) for index, seconds, verdict in frames if verdict == "used"]
    keyframes = sorted(int(path.stem) for path in workspace.depth.glob("*.png"))
    main = metrics["submaps"][0]
    coverage = main["coverage"]
    return {
        "name": folder.resolve().name,
        "frames": used,
        "keyframes": keyframes,
        "unit": unit_label(main["unit"]),
        "ramps": {"depth": ramp(DEPTH_MAP), "confidence": ramp(CONFIDENCE_MAP)},
        "depths": [scale.to_dict() for scale in depth_scales(folder)],
        "regions": coverage.get("missed_regions", []),
        "near": NEAR_S,
        "coverage": coverage.get("covered_percent"),
        "reason": coverage.get("reason", ""),
        "submaps": len(metrics["submaps"]),
        "warnings": metrics["warnings"],
    }


def picture(folder: Path, kind: str, index: int) -> bytes:
    """A frame as JPEG; depth or confidence of a keyframe as PNG. HaustraError where there is none."""
    workspace = Workspace(folder)
    path = {
        "frame": workspace.image_path(index),
        "depth": workspace.depth_path(index),
        "confidence": workspace.confidence_path(index),
    }[kind]
    if not path.is_file():
        raise HaustraError(f"the run has no {kind} {index}")
    if kind == "frame":
        return path.read_bytes()
    if kind == "depth":
        shown = painted_depth(folder, index)
    else:
        shown = painted(read_confidence(path), (0.0, 1.0), CONFIDENCE_MAP)
    return bytes(cv2.imencode(".png", shown, [cv2.IMWRITE_PNG_COMPRESSION, 3])[1].tobytes())


def turn_between(first: Path, second: Path) -> list[list[float]] | None:
    """Rotation (3,3) that takes directions of the second run to the first, from the poses that both have of one time;
    None where they are of other films or share too little."""
    records = [open_workspace(folder).record["source"]["sha256"]["source"] for folder in (first, second)]
    if records[0] != records[1]:
        return None
    paths = [read_tum(Workspace(folder).trajectory) for folder in (first, second)]
    try:
        mine, theirs = associate(paths[0][0], paths[1][0], 1e-3)
    except HaustraError:
        return None
    if len(mine) < 3:
        return None
    return _rotation(paths[1][1][theirs], paths[0][1][mine]).tolist()


def _rotation(source: NDArray[np.float64], target: NDArray[np.float64]) -> NDArray[np.float64]:
    """Of Sim(3) between poses (N,4,4): their orientations vote, since centres on a line would leave a roll open."""
    products = target[:, :3, :3] @ source[:, :3, :3].transpose(0, 2, 1)
    left, _, right = np.linalg.svd(products.sum(axis=0))
    return left @ np.diag([1, 1, np.linalg.det(left @ right)]) @ right
