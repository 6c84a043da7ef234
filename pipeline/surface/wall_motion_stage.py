"""Stage 5b: what the points stage found of the wall's motion, for each submap as it is fused, and said to the user."""

from __future__ import annotations

from dataclasses import asdict

from haustra.core.progress import Progress
from pipeline.depth.completed_submap import CompletedSubmap
from pipeline.frontend.points_stage import load_motion_of_points
from pipeline.frontend.wall_motion import WallMotion, measure_motion
from pipeline.input.frames import Frames
from pipeline.mapping.submap import Submap
from pipeline.run_folder.stage import load_or_make
from pipeline.run_folder.workspace import Workspace

STAGE = "motion"


def wall_motion_stage(
    frames: Frames, completed: list[CompletedSubmap], submaps: list[Submap], workspace: Workspace, progress: Progress
) -> list[WallMotion | None]:
    """Of each submap; None where too little is followed to tell, and where closed loops moved points off what was
    adjusted to the pictures.

    submaps: as the front end left them; points found anew have lost the sightings that a moving wall puts off.
    """
    return load_or_make(
        workspace,
        STAGE,
        lambda: load_motion(workspace),
        lambda: _ask_all(frames, _unmoved(completed, submaps), submaps, workspace, progress),
    )


def _unmoved(completed: list[CompletedSubmap], submaps: list[Submap]) -> list[int | None]:
    """Of each completed submap the number of the one that the front end left; None of those that closed loops moved."""
    by_frames = {tuple(submap.frames.tolist()): number for number, submap in enumerate(submaps)}
    return [
        None if one.depth_scale is not None else by_frames.get(tuple(one.submap.frames.tolist())) for one in completed
    ]


def load_motion(workspace: Workspace) -> list[WallMotion | None]:
    """What a finished stage found; none in runs of earlier versions."""
    if not workspace.is_done(STAGE):
        return []
    records = workspace.result(STAGE)["submaps"]
    return [None if r is None else WallMotion(r["told"], r["explained"]) for r in records]


def _ask_all(
    frames: Frames, numbers: list[int | None], submaps: list[Submap], workspace: Workspace, progress: Progress
) -> None:
    known = load_motion_of_points(workspace)
    if known is None:
        known = [measure_motion(frames, submap) for submap in submaps]
    found = [None if number is None else known[number] for number in numbers]
    workspace.finish(STAGE, submaps=[None if one is None else asdict(one) for one in found])
    for sentence in sentences(found):
        progress.log(sentence)


def sentences(found: list[WallMotion | None]) -> list[str]:
    """One for each submap whose points miss a still wall together."""
    return [one.sentence(number) for number, one in enumerate(found) if one is not None and one.told]
