"""How far from a depth its voxels are updated: finished runs fused anew at several truncations, measured against truth.

    python -m benchmarks.fusion truncation RUN=FOLDER... --role chosen --json truncation.json

RUN must be a finished run of the RGB-D folder's frames. Its keyframes, poses, voxels and completed depth stay, with
consistency and confidence as in a run, but spots too dark for their depth are not left open. Surfaces are compared as
`haustra compare` does. Runs are added to the record as they are measured.
"""

import argparse
import statistics
from dataclasses import replace
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from benchmarks.common.record import RunTable, in_percent, print_row
from benchmarks.fusion.comparison import pair
from benchmarks.fusion.measured_run import TAU, MeasuredRun, ranges
from pipeline.depth.completed_submap import CompletedKeyframe
from pipeline.surface.fusion_stage import MIN_COMPONENT, depth_filter
from reconstruction.evaluation.surface_metrics import surface_errors
from reconstruction.fusion.tsdf import SurfaceFusion, TsdfSettings
from reconstruction.mesh.surface_mesh import SurfaceMesh, drop_small_components

TRUNCATIONS = (12.0, 8.0, 6.0, 5.0, 4.0, 3.0)  # voxels


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("pairs", metavar="RUN=FOLDER", type=pair, nargs="+", help="finished run and its RGB-D folder")
    parser.add_argument("--role", default="reported", choices=("reported", "chosen"), help="what the films are to it")


def measure(arguments: argparse.Namespace) -> None:
    """Every run at every truncation, then the means."""
    cv2.setNumThreads(1)
    table = RunTable(arguments.json)
    for run, folder in arguments.pairs:
        if table.has(folder.name, 0, arguments.role):
            continue
        opened = MeasuredRun(run, folder)
        keyframes = kept_keyframes(opened)
        scores = {f"{voxels:g}": score(opened, keyframes, voxels) for voxels in TRUNCATIONS}
        table.add(folder.name, 0, {arguments.role: {"voxel_mm": opened.about["voxel_mm"], "truncations": scores}})
        print_row({"film": folder.name} | {voxels: figures["f_score"] for voxels, figures in scores.items()})
    mine = [run["truncations"] for run in table.runs if run["method"] == arguments.role]
    for voxels in mine[0]:
        values = [scores[voxels]["f_score"] for scores in mine]
        print(f"{voxels} voxels: mean {statistics.fmean(values):.2f}, median {statistics.median(values):.2f} % F")


def kept_keyframes(run: MeasuredRun) -> list[CompletedKeyframe]:
    """Keyframes with the confidence that a run fuses, without those that the others contradict."""
    completed, config = run.after.completed, run.config
    check = depth_filter(completed, config.consistency, config.fusion, ranges(completed, config))
    kept = []
    for place, row in enumerate(completed.rows):
        keyframe = completed.keyframe(int(row))
        confidence = check.confidence(place, keyframe.confidence)
        if confidence is not None:
            kept.append(replace(keyframe, confidence=confidence))
    return kept


def score(run: MeasuredRun, keyframes: list[CompletedKeyframe], voxels: float) -> dict[str, Any]:
    """F-score, precision and recall (%) of the keyframes fused at a truncation of so many voxels."""
    completed = run.after.completed
    mesh = fused(keyframes, completed.camera.matrix, replace(ranges(completed, run.config), truncation=voxels))
    moved = mesh.transformed(run.after.truth_from_map)
    return in_percent(surface_errors(moved, run.truth, TAU, np.random.default_rng(0)))


def fused(keyframes: list[CompletedKeyframe], intrinsics: NDArray[np.float64], settings: TsdfSettings) -> SurfaceMesh:
    """The surface of keyframes without its small pieces."""
    fusion = SurfaceFusion(settings)
    for keyframe in keyframes:
        images = keyframe.rgb, keyframe.depth, keyframe.confidence
        fusion.integrate(*images, intrinsics, keyframe.world_from_camera)
    return drop_small_components(fusion.extract(), MIN_COMPONENT)[0]
