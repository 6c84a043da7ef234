"""Stage 3: dense depth and confidence of every keyframe, from its picture and its sparse depth."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from completion.inference.completer import DepthCompleter
from haustra.core.camera import read_camera
from haustra.core.errors import HaustraError
from haustra.core.progress import Progress
from pipeline.config import DepthSettings
from pipeline.depth.completed_submap import CompletedSubmap
from pipeline.depth.keyframe_selection import choose_keyframes
from pipeline.depth.keyframe_store import DiskKeyframes, depth_on_disk
from pipeline.depth.rectification import make_rectifier
from pipeline.depth.sensor.joined_points import points_of
from pipeline.depth.sparse_depth import SparseDepth
from pipeline.input.frames import Frames
from pipeline.input.sensor.sensor_depth import open_sensor
from pipeline.mapping.submap import Submap, refined_camera
from pipeline.run_folder.stage import load_or_make
from pipeline.run_folder.workspace import Workspace, write_json

STAGE = "depth"
MIN_POINTS = 12  # fewer sparse points do not fix a frame's depth


def complete_depth(
    frames: Frames,
    submaps: list[Submap],
    model: str,
    device: str,
    settings: DepthSettings,
    workspace: Workspace,
    progress: Progress,
) -> list[CompletedSubmap]:
    """Complete the keyframes of every submap by the network `model`; those already on disk are kept."""

    def make() -> None:
        completer = DepthCompleter.load(model, device, iterations=settings.iterations)
        _complete_all(frames, submaps, completer, settings, workspace, progress)

    return load_or_make(workspace, STAGE, lambda: load_completed(frames, submaps, workspace), make)


def load_completed(frames: Frames, submaps: list[Submap], workspace: Workspace) -> list[CompletedSubmap]:
    """The submaps of a finished stage, with the rows of their completed keyframes."""
    rows = workspace.result(STAGE)["keyframe_rows"]
    planned = [_plan(frames, submap, workspace.config.depth, workspace) for submap in submaps]
    for number, one in enumerate(planned):
        _check_pinhole(one, camera_path(workspace, number))
    return [replace(one, rows=np.array(mine, dtype=np.int64)) for one, mine in zip(planned, rows, strict=True)]


def _check_pinhole(completed: CompletedSubmap, recorded: Path) -> None:
    """Refuse depth maps of another pinhole than is derived today, as runs of earlier versions could ask for."""
    if not recorded.exists():  # absent in runs of early versions
        return
    made = read_camera(recorded)
    if not np.allclose(made.params, completed.camera.params, rtol=1e-6):
        raise HaustraError(
            f"the depth maps were made for a pinhole of focal length {made.focal[0]:.1f} px ({recorded}), and this "
            f"version takes {completed.camera.focal[0]:.1f} px; make the run anew with --overwrite"
        )


def camera_path(workspace: Workspace, number: int) -> Path:
    """`camera.json`, and `camera_1.json` and on for further submaps, whose lens may have been refined otherwise."""
    return workspace.camera if number == 0 else workspace.root / f"camera_{number}.json"


def _plan(frames: Frames, submap: Submap, settings: DepthSettings, workspace: Workspace) -> CompletedSubmap:
    """The submap with the rows of the keyframes that are to be completed."""
    camera = refined_camera(frames.camera, submap)
    rows = choose_keyframes(submap, camera.width, settings.keyframe_motion)
    return CompletedSubmap(submap, make_rectifier(camera), rows, depth_on_disk(workspace))


def _complete_all(
    frames: Frames,
    submaps: list[Submap],
    completer: DepthCompleter,
    settings: DepthSettings,
    workspace: Workspace,
    progress: Progress,
) -> None:
    planned = [_plan(frames, submap, settings, workspace) for submap in submaps]
    store, sensor = DiskKeyframes(workspace, settings.multiview), open_sensor(workspace, frames.camera.width)
    for number, submap in enumerate(planned):
        write_json(camera_path(workspace, number), submap.camera.to_dict())
    total, done = sum(len(submap) for submap in planned), 0
    kept: list[list[int]] = []
    with progress.bar("depth completion", total) as advance:
        for submap in planned:
            kept.append([])
            points, content = points_of(submap, frames, sensor, progress), submap.rectifier.mask(frames.content)
            for row in map(int, submap.rows):
                if _complete(submap, row, points, content, completer, store):
                    kept[-1].append(row)
                done += 1
                advance(done)
    workspace.finish(STAGE, keyframe_rows=kept, kept_share=[round(s.rectifier.kept_share, 4) for s in planned])
    skipped = total - sum(len(rows) for rows in kept)
    progress.log(f"{total - skipped} keyframes completed" + (f", {skipped} had too few points" if skipped else ""))


def _complete(
    submap: CompletedSubmap,
    row: int,
    points: Callable[[int], SparseDepth],
    content: NDArray[np.uint8],
    completer: DepthCompleter,
    store: DiskKeyframes,
) -> bool:
    """Complete one keyframe and write it; False if it has too few points."""
    index = int(submap.submap.frames[row])
    sparse = points(row)
    if len(sparse.depth) < MIN_POINTS:
        return False
    if store.has_depth(index):
        return True
    depth, confidence = completer(submap.rgb(row), *sparse.maps(*content.shape))
    inside = cv2.erode(content, np.ones((3, 3), np.uint8)) > 0 if not content.all() else content > 0
    store.write_depth(index, np.where(inside, depth, np.float32(0)), np.where(inside, confidence, np.float32(0)))
    return True
