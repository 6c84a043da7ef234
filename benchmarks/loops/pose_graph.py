"""What closing loops is worth: drift, path and surface before and after, and whether any loop is false.

    haustra phantom LOOPS --suite --config benchmarks/loops.yaml
    python -m benchmarks.loops pose-graph LOOPS/* SUITE/* ../shared/data/ctcolon --surface --json pose_graph.json
    python -m benchmarks.loops pose-graph LOOPS/long_c SUITE/easy_withdrawal --kidnapped --json kidnapped.json

Each folder's frames go through `odometry` and completion with the folder's own camera; then the largest submap's loops
are closed: `graph` is what the pose graph alone makes of it, `after` is adjusted to the images. End to start: each of
the last 15 % of the frames relative to that of the first 15 % which is truly nearest, against truth, median; the unit
of length comes from one Sim(3) over the whole path. A link is false if its own relative pose is off by more than
5 degrees or a tenth of the median depth. Surface: F-score at 1 mm as `haustra compare` has it.

`--kidnapped` cuts the film in two halves that share a tenth of it, reconstructs each alone, the second in another unit
(halved), and joins them. Scale error: the factor that brings the joined second half to truth over that of the first.
"""

import argparse
import tempfile
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from scipy.spatial.transform import Rotation

from benchmarks.common.runner import add_folders
from haustra.core.errors import HaustraError
from haustra.core.progress import SilentProgress
from haustra.core.sim3 import scale_of
from pipeline.config import Config, FrameSettings
from pipeline.depth.completed_submap import CompletedSubmap
from pipeline.depth.completion_stage import complete_depth
from pipeline.depth.multiview_stage import refine_depth
from pipeline.depth.preparation import load_completer
from pipeline.frontend.odometry.frame_io import frame_features
from pipeline.frontend.structure_stage import solve_structure
from pipeline.input.frames import Frames, read_frames
from pipeline.input.video import Source
from pipeline.loop_closing.detection import (
    LoopClosure,
    SubmapFeatures,
    find_features,
    loop_candidates,
    merge_candidates,
    verify_loops,
)
from pipeline.loop_closing.keyframe_pose_graph import close_loops, merge_by_loops
from pipeline.loop_closing.loop_adjustment import adjust_loops
from pipeline.matching.place_recognition import VisualWords
from pipeline.run_folder.creating import create_workspace
from pipeline.surface.fusion_stage import MIN_COMPONENT, depth_filter, fusion_ranges
from reconstruction.evaluation.reference_surface import ReferenceSurface, read_reference_surface
from reconstruction.evaluation.surface_metrics import surface_errors
from reconstruction.evaluation.trajectory_io import read_tum
from reconstruction.evaluation.trajectory_metrics import align_poses, trajectory_errors
from reconstruction.fusion.tsdf import SurfaceFusion
from reconstruction.mesh.surface_mesh import drop_small_components

ENDS = 0.15  # of the frames
RETURNS_MM = 15.0  # between first and last camera of a film that comes back
FALSE_DEG, FALSE_SHIFT = 5.0, 0.1
OVERLAP = 0.1  # of the film, that both halves have
HALF_UNIT = 0.5


def dense_submaps(folder: Path, config: Config, root: Path) -> list[CompletedSubmap]:
    workspace, silent = create_workspace(root, folder, config, overwrite=True), SilentProgress()
    with workspace, frame_features(workspace) as features:
        frames = read_frames(Source(folder), config.camera, config.frames, workspace, silent)
        submaps = solve_structure(frames, features, config.front_end, config.front_end_settings, workspace, silent)
        network = partial(load_completer, config.model, config.device, config.depth.iterations)
        completed = complete_depth(frames, submaps, network, config.depth, workspace, silent)
        return refine_depth(frames, completed, network, config.depth, workspace, silent)


def links_of(
    parts: tuple[CompletedSubmap, CompletedSubmap], config: Config
) -> tuple[tuple[SubmapFeatures, SubmapFeatures], list[LoopClosure], int]:
    """Features, loop closures, and how many pairs were tried; the same submap twice: its own loops."""
    most, seed = config.loop_closing.max_keyframes, config.seed
    first = find_features(parts[0], most)
    own = parts[0] is parts[1]
    second = first if own else find_features(parts[1], most)
    words = VisualWords.of(first.features if own else [*first.features, *second.features], seed)
    pairs = loop_candidates(first, words) if own else merge_candidates(first, second, words)
    return (first, second), verify_loops(first, second, pairs, seed), len(pairs)


def path_figures(completed: CompletedSubmap, truth: np.ndarray) -> dict[str, float]:
    world_from_camera, true = completed.submap.world_from_camera, truth[completed.submap.frames]
    errors = trajectory_errors(world_from_camera, true)
    figures = {"ate_mm": errors.ate_rmse, "rotation_deg": errors.rotation_median_deg}
    if np.linalg.norm(true[0, :3, 3] - true[-1, :3, 3]) > RETURNS_MM:
        return figures
    return figures | end_to_start(world_from_camera, true, errors.scale)


def end_to_start(world_from_camera: np.ndarray, true: np.ndarray, mm_per_unit: float) -> dict[str, float]:
    """Errors of the last poses (N,4,4) relative to the first ones that are truly nearest to them, medians."""
    count = int(ENDS * len(world_from_camera))
    shift, turn = [], []
    for last in range(len(world_from_camera) - count, len(world_from_camera)):
        first = int(np.linalg.norm(true[:count, :3, 3] - true[last, :3, 3], axis=1).argmin())
        found, wanted = (np.linalg.inv(p[first]) @ p[last] for p in (world_from_camera, true))
        shift.append(float(np.linalg.norm(mm_per_unit * found[:3, 3] - wanted[:3, 3])))
        turn.append(float(np.degrees(Rotation.from_matrix(found[:3, :3].T @ wanted[:3, :3]).magnitude())))
    return {"end_to_start_mm": float(np.median(shift)), "end_to_start_deg": float(np.median(turn))}


def is_false(
    link: LoopClosure, rows: tuple[int, int], completed: CompletedSubmap, truth: np.ndarray, unit_mm: float
) -> bool:
    first, second = (truth[completed.submap.frames[row]] for row in rows)
    wanted, found = np.linalg.inv(first) @ second, link.match.first_from_second
    turn = Rotation.from_matrix((found[:3, :3] / scale_of(found)).T @ wanted[:3, :3]).magnitude()
    shift = np.linalg.norm(found[:3, 3] - wanted[:3, 3] / unit_mm)
    return bool(np.degrees(turn) > FALSE_DEG or shift > FALSE_SHIFT)


def surface_figures(
    completed: CompletedSubmap, truth: np.ndarray, wall: ReferenceSurface, config: Config
) -> dict[str, float]:
    settings = fusion_ranges(completed, config.fusion)
    assert settings is not None
    fusion, check = (
        SurfaceFusion(settings),
        depth_filter(completed, config.consistency, config.fusion, settings),
    )
    for place, keyframe in enumerate(completed):
        confidence = check.confidence(place, keyframe.confidence)
        if confidence is not None:
            fusion.integrate(
                keyframe.rgb, keyframe.depth, confidence, completed.camera.matrix, keyframe.world_from_camera
            )
    truth_from_run = align_poses(completed.submap.world_from_camera, truth[completed.submap.frames])
    mesh = drop_small_components(fusion.extract(), MIN_COMPONENT)[0].transformed(truth_from_run)
    errors = surface_errors(mesh, wall, 1.0, np.random.default_rng(0))
    return {"f_score": errors.f_score, "precision": errors.precision, "recall": errors.recall}


def loops_of(folder: Path, config: Config, with_surface: bool, scratch: Path) -> dict[str, Any]:
    truth = read_tum(folder / "trajectory.txt")[1]
    dense = dense_submaps(folder, config, scratch)
    completed = dense[0]
    places, links, tried = links_of((completed, completed), config)
    closed = close_loops(places[0], links)
    unit_mm = trajectory_errors(completed.submap.world_from_camera, truth[completed.submap.frames]).scale
    at = {k: (places[0].rows[link.match.first], places[1].rows[link.match.second]) for k, link in enumerate(links)}
    false = {k: is_false(link, at[k], completed, truth, unit_mm) for k, link in enumerate(links)}
    kept = {k for k in at if tuple(int(completed.submap.frames[row]) for row in at[k]) in closed.accepted_pairs}
    figures: dict[str, Any] = {
        "frames": len(completed.submap.frames),
        "submaps": len(dense),
        "tried": tried,
        "links": len(links),
        "false_links": sum(false.values()),
        "supported": closed.consistent,
        "kept": len(kept),
        "false_kept": sum(false[k] for k in kept),
    }
    states = {"before": completed}
    if closed.accepted_pairs:
        adjusted = adjust_loops(places[0], closed)
        states |= {"graph": closed.completed} | ({"after": adjusted} if adjusted else {})
    wall = read_reference_surface(folder) if with_surface and closed.accepted_pairs else None
    for name, state in states.items():
        figures[name] = path_figures(state, truth)
        if wall is not None:
            figures[name] |= surface_figures(state, truth, wall, config)
    return figures


def kidnapped(folder: Path, config: Config, scratch: Path) -> dict[str, Any]:
    """Two halves of a film, the second in another unit, joined."""
    seconds, truth = read_tum(folder / "trajectory.txt")
    first, second = halves_of(folder, float(seconds[-1]), config, scratch)
    submap, scales = second.submap.scaled(HALF_UNIT), np.full(len(second.submap.frames), HALF_UNIT)
    parts = (first, replace(second, submap=submap, depth_scale=scales))
    places, links, tried = links_of(parts, config)
    joined = merge_by_loops(places, links)
    figures: dict[str, Any] = {"tried": tried, "links": len(links), "joined": joined is not None}
    if joined is None:
        return figures
    middle, index, world_from_camera = int(0.5 * len(truth)), joined.submap.frames, joined.submap.world_from_camera
    before, after = (
        float(scale_of(align_poses(world_from_camera[mine], truth[index[mine]])))
        for mine in (index < middle, index >= middle)
    )
    errors = trajectory_errors(world_from_camera, truth[index])
    return figures | {"scale_error": after / before - 1, "ate_mm": errors.ate_rmse}


def halves_of(
    folder: Path, length_s: float, config: Config, scratch: Path
) -> tuple[Frames, CompletedSubmap, CompletedSubmap]:
    """The largest submap of either half of the film, each reconstructed alone."""
    halves: list[CompletedSubmap] = []
    for start, end in ((0.0, (0.5 + OVERLAP / 2) * length_s), ((0.5 - OVERLAP / 2) * length_s, None)):
        own = config.model_copy(update={"frames": FrameSettings(start_s=start, end_s=end)})
        halves.append(dense_submaps(folder, own, scratch / str(len(halves)))[0])
    return halves[0], halves[1]


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add_folders(parser)
    parser.add_argument("--kidnapped", action="store_true", help="two halves of each film, joined")
    parser.add_argument("--surface", action="store_true", help="fuse before and after, where loops were closed")
    parser.add_argument("--front-end", default="odometry", choices=["sfm", "odometry"])
    parser.add_argument("--seed", type=int, default=0)


def measure(arguments: argparse.Namespace) -> dict[str, Any]:
    """Every folder once; a run that fails is entered with its sentence."""
    cv2.setNumThreads(1)
    config = Config(front_end=arguments.front_end, seed=arguments.seed)
    figures: dict[str, Any] = {}
    for folder in arguments.folders:
        with tempfile.TemporaryDirectory() as scratch:
            try:
                if arguments.kidnapped:
                    found = kidnapped(folder, config, Path(scratch))
                else:
                    found = loops_of(folder, config, arguments.surface, Path(scratch))
            except HaustraError as error:
                found = {"failure": str(error)}
        figures[folder.name] = found
        print(folder.name, found, flush=True)
    return {"front_end": arguments.front_end, "seed": arguments.seed, "figures": figures}
