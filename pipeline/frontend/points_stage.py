"""Stage 2b: each submap's features matched between more frames, its poses adjusted to them, their points found anew by
these poses and refined by what the pictures show about them; depth is completed from these.

Poses that are given stay, and those that a sensor's depth adjusted. The front end's own poses and points are kept
beside the new ones: what is judged by their residuals (`map_doubt`, `wall_motion`) was calibrated on those, and a point
that moved with the wall is an outlier here and evidence there.
"""

import shutil
from pathlib import Path

import numpy as np

from haustra.core.frame_spacing import least_of_each
from haustra.core.progress import Progress
from haustra.core.threads import single_threaded
from pipeline.frontend.odometry.frame_io import frame_reader
from pipeline.frontend.point_refinement import refine_points
from pipeline.frontend.registry import POSES
from pipeline.frontend.structure_stage import front_end_of
from pipeline.input.frames import Frames
from pipeline.input.sensor.sensor_depth import open_sensor
from pipeline.mapping.colmap_io import write_model
from pipeline.mapping.feature_triangulation import triangulate_again
from pipeline.mapping.local_map import DepthAt
from pipeline.mapping.pose_adjustment import AdjustedPoses
from pipeline.mapping.submap import Submap, read_submap
from pipeline.matching.sift_cache import SiftCache
from pipeline.run_folder.malloc import give_back_freed_memory
from pipeline.run_folder.stage import load_or_make
from pipeline.run_folder.workspace import Workspace, report_corruption

STAGE = "points"
DEPTH_STAGE = "depth"  # whose keyframes were chosen by the points that it found


def find_points(
    frames: Frames,
    features: SiftCache,
    submaps: list[Submap],
    keyframe_motion: float,
    workspace: Workspace,
    progress: Progress,
) -> list[Submap]:
    """The submaps in the same order and unit; one stays as it is, and a sentence says so, where its poses triangulate
    too few. keyframe_motion: between the frames whose features are matched, as a share of the width."""
    if workspace.is_done(DEPTH_STAGE) and not workspace.is_done(STAGE):  # a run of a version without this stage
        return submaps
    return load_or_make(
        workspace,
        STAGE,
        lambda: load_points(submaps, workspace),
        lambda: _find_all(frames, features, submaps, keyframe_motion * frames.camera.width, workspace, progress),
    )


def load_points(submaps: list[Submap], workspace: Workspace) -> list[Submap]:
    """The submaps of a finished stage; `submaps`, as structure left them, of a run without it."""
    if not workspace.is_done(STAGE):
        return submaps
    folder = points_folder(workspace)
    with report_corruption(folder):
        return [read_submap(folder / str(number)) for number in range(len(submaps))]


def _find_all(
    frames: Frames,
    features: SiftCache,
    submaps: list[Submap],
    motion_px: float,
    workspace: Workspace,
    progress: Progress,
) -> None:
    for folder in (workspace.depth, workspace.confidence, workspace.first_depth):
        shutil.rmtree(folder, ignore_errors=True)  # of a stopped run of a version without this stage: other points'
    adjusted = triangulated(frames, features, submaps, motion_px, workspace, progress)
    found = [one.submap for one in adjusted]
    give_back_freed_memory()  # patches ask for other arrays
    with single_threaded(), progress.bar("refining points", None) as advance:
        if _adjusting_depth(frames, workspace) is None:  # what a sensor measured holds points better than patches do
            found = [refine_points(one, frames.camera, frame_reader(workspace), advance) for one in found]
    keep_points(found, frames, workspace, [one.turned_deg for one in adjusted])


def triangulated(
    frames: Frames,
    features: SiftCache,
    submaps: list[Submap],
    motion_px: float,
    workspace: Workspace,
    progress: Progress,
    adjust: bool = True,
) -> list[AdjustedPoses]:
    """The submaps with adjusted poses and the points that these triangulate, before they are refined. motion_px:
    between the frames whose features are matched. adjust: False: all poses stay."""
    depth_at, found = _adjusting_depth(frames, workspace), []
    adjust = adjust and front_end_of(workspace) != POSES
    with single_threaded(), progress.bar("triangulation", None) as advance:
        least_of = least_of_each([len(submap.frames) for submap in submaps])
        for number, (submap, least) in enumerate(zip(submaps, least_of, strict=True)):
            again = triangulate_again(submap, frames.camera, motion_px, features, advance, depth_at, least, adjust)
            if again is None:
                progress.log(f"submap {number}: its poses triangulate too few features; it keeps the points it has")
            elif again.turned_deg > 0:
                progress.log(
                    f"submap {number}: its poses were adjusted to the features that are matched by them, and turned "
                    f"by {again.turned_deg:.2f} degrees in the median"
                )
            found.append(again or AdjustedPoses(submap, 0.0))
    return found


def _adjusting_depth(frames: Frames, workspace: Workspace) -> DepthAt | None:
    """What a sensor measured, where poses and points are adjusted by it."""
    sensor = open_sensor(workspace, frames.camera.width)
    return sensor.for_adjustment if sensor is not None and sensor.settings.adjust else None


def keep_points(
    submaps: list[Submap], frames: Frames, workspace: Workspace, turned_deg: list[float] | None = None
) -> None:
    """Write the submaps as what the stage found, and finish it. turned_deg: of each submap's poses, in the median; 0
    where they stayed."""
    shutil.rmtree(points_folder(workspace), ignore_errors=True)
    for number, submap in enumerate(submaps):
        write_model(submap, frames.camera, points_folder(workspace) / str(number))
    refined = [int(np.isfinite(submap.known_depth_error).sum()) for submap in submaps]
    turned = turned_deg or [0.0] * len(submaps)
    workspace.finish(STAGE, points=[len(submap.points) for submap in submaps], refined=refined, turned_deg=turned)


def points_folder(workspace: Workspace) -> Path:
    """Folder of the submaps' models, by their numbers, in scene units."""
    return workspace.log / STAGE
