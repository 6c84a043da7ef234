"""Of each submap: whether it is wrong by the film's truth, and what it says about itself."""

from collections.abc import Callable
from dataclasses import asdict
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.map_doubt.maps import JudgedMap
from haustra.core.rank_correlation import rank_correlation
from pipeline.input.frames import Frames
from pipeline.mapping.map_doubt import PREDICTORS, WRONG_DEG, WRONG_SHARE, MapEvidence, gather_evidence
from pipeline.mapping.readjustment import PathDifference, path_difference
from pipeline.surface.wall_motion import measure_motion
from reconstruction.evaluation.trajectory_metrics import trajectory_errors

QUARTER_POINTS = 8  # of a quarter of the picture, for a rank correlation
# Tried beside the predictors of `map_doubt`; they need the pictures, or a later stage.
ALSO_TRIED: dict[str, Callable[[dict[str, Any]], float]] = {
    "light by quarters": lambda row: row["by_quarters"],
    "explained motion": lambda row: float(np.clip(row["explained"] or 0.0, -0.1, 0.3)),
    "frames": lambda row: -float(np.log(row["frames"])),
}


def row_of(one: JudgedMap) -> dict[str, Any]:
    """For the record."""
    error = path_difference(one.submap.world_from_camera, one.truth)
    centres_alone = trajectory_errors(one.submap.world_from_camera, one.truth)
    return {
        "frames": len(one.submap.frames),
        "kept": one.kept,
        "path_mm": float(np.linalg.norm(np.diff(one.truth[:, :3, 3], axis=0), axis=1).sum()),
        "error": asdict(error),
        "rotation_by_centres_deg": centres_alone.rotation_median_deg,
        "wrong": error.share > WRONG_SHARE or error.angle_deg > WRONG_DEG,
        "evidence": asdict(gather_evidence(one.submap, one.camera, one.check, one.total, one.submaps)),
        "by_quarters": light_by_quarters(one),
        "explained": _explained(one),
    }


def predictors_of(row: dict[str, Any]) -> dict[str, float]:
    """Every predictor that was tried, by name; larger where a map is wrong."""
    evidence = evidence_of(row)
    shipped = {name: predictor.of(evidence) for name, predictor in PREDICTORS.items()}
    return shipped | {name: of(row) for name, of in ALSO_TRIED.items()}


def evidence_of(row: dict[str, Any]) -> MapEvidence:
    """The evidence that a row of the record holds."""
    values = dict(row["evidence"])
    for name in ("stretches", "halves"):
        values[name] = None if values[name] is None else PathDifference(**values[name])
    return MapEvidence(**values)


def light_by_quarters(one: JudgedMap) -> float:
    """Median over frames, and over quarters of the picture, of the rank correlation of distance and brightness."""
    submap, found = one.submap, []
    order, starts = submap.by_frame()
    row, point = submap.observations[order].T
    distance = np.linalg.norm(submap.points[point] - submap.centres[row], axis=1)
    right_low = submap.pixels[order] > np.array([one.camera.width, one.camera.height]) / 2
    quarter, bright = right_low @ np.array([1, 2]), one.brightness[order]
    for begin, end in pairwise(starts):
        mine = np.arange(begin, end)
        parts = [mine[quarter[mine] == number] for number in range(4)]
        known = [rank_correlation(distance[part], bright[part]) for part in parts if len(part) >= QUARTER_POINTS]
        if len(known) >= 2:
            found.append(float(np.nanmedian(known)))
    return float(np.nanmedian(found)) if np.isfinite(found).any() else 0.0


def _explained(one: JudgedMap) -> float | None:
    content: NDArray[np.uint8] = np.ones((one.camera.height, one.camera.width), np.uint8)
    frames = Frames(one.submap.frames, one.seconds, one.camera, content, {})
    depth = one.submap.depths()
    found = measure_motion(frames, one.submap.scaled(1 / float(np.median(depth[depth > 0]))))
    return None if found is None else found.explained


def path_of(film: str) -> str:
    """Films of one path with several walls are one group."""
    name = Path(film).name
    return name.rsplit("_", 1)[0] if name.rsplit("_", 1)[-1].replace(".", "").isdigit() and name[1] == "_" else name
