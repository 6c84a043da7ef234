"""Stage 3: dense depth and confidence of every keyframe, from its picture and its sparse depth."""

from __future__ import annotations

import shutil
from collections.abc import Callable, Iterable
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import cv2
import numpy as np
from numpy.typing import NDArray

from haustra.core.camera import read_camera
from haustra.core.errors import HaustraError
from haustra.core.frame_spacing import least_of_each
from haustra.core.progress import Progress
from haustra.core.text import counted
from haustra.core.threads import prefetched
from pipeline.config import DepthSettings
from pipeline.depth.completed_submap import CompletedSubmap
from pipeline.depth.keyframe_selection import choose_keyframes
from pipeline.depth.keyframe_store import DiskKeyframes, depth_on_disk
from pipeline.depth.multiview_stage import has_second_pass
from pipeline.depth.preparation import LoadCompleter
from pipeline.depth.rectification import make_rectifier
from pipeline.depth.sensor.joined_points import points_of
from pipeline.depth.sparse_depth import SparseDepth
from pipeline.input.frames import Frames
from pipeline.input.sensor.sensor_depth import open_sensor
from pipeline.mapping.submap import Submap, refined_camera
from pipeline.run_folder.malloc import freed_memory_kept
from pipeline.run_folder.stage import load_or_make
from pipeline.run_folder.workspace import Workspace, write_json

if TYPE_CHECKING:
    from completion.inference.completer import DepthCompleter

STAGE = "depth"
MIN_POINTS = 12  # fewer sparse points do not fix a frame's depth


def complete_depth(
    frames: Frames,
    submaps: list[Submap],
    load_completer: LoadCompleter,
    settings: DepthSettings,
    workspace: Workspace,
    progress: Progress,
) -> list[CompletedSubmap]:
    """Complete the keyframes of every submap by the network that is loaded; those already on disk are kept."""

    def make() -> None:
        _complete_all(frames, submaps, load_completer(), settings, workspace, progress)

    return load_or_make(workspace, STAGE, lambda: load_completed(frames, submaps, workspace), make)


def load_completed(frames: Frames, submaps: list[Submap], workspace: Workspace) -> list[CompletedSubmap]:
    """The submaps of a finished stage, with the rows of their completed keyframes."""
    rows = workspace.result(STAGE)["keyframe_rows"]
    finished = [
        _planned(frames, submap, np.array(mine, dtype=np.int64), workspace)
        for submap, mine in zip(submaps, rows, strict=True)
    ]
    for number, one in enumerate(finished):
        _check_pinhole(one, camera_path(workspace, number))
    return finished


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


def _planned(frames: Frames, submap: Submap, rows: NDArray[np.int64], workspace: Workspace) -> CompletedSubmap:
    """The submap with `rows` as the keyframes that are completed."""
    rectifier = make_rectifier(refined_camera(frames.camera, submap))
    return CompletedSubmap(submap, rectifier, rows, depth_on_disk(workspace))


def _complete_all(
    frames: Frames,
    submaps: list[Submap],
    completer: DepthCompleter,
    settings: DepthSettings,
    workspace: Workspace,
    progress: Progress,
) -> None:
    sensor = open_sensor(workspace, frames.camera.width)
    again = has_second_pass(settings, sensor)
    # Of a stopped run of a version that had another rule for a second pass: nothing is refined yet, or need be.
    for folder in (workspace.depth, workspace.confidence) if again else (workspace.first_depth,):
        shutil.rmtree(folder, ignore_errors=True)
    width, motion, planned = frames.camera.width, settings.keyframe_motion, []
    for submap, least in zip(submaps, least_of_each([len(one.frames) for one in submaps]), strict=True):
        planned.append(_planned(frames, submap, choose_keyframes(submap, width, motion, least), workspace))
    store = DiskKeyframes(workspace, again)
    for number, one in enumerate(planned):
        write_json(camera_path(workspace, number), one.camera.to_dict())
    total, done, size = sum(len(one) for one in planned), 0, completer.batch_size
    kept: list[list[int]] = []
    with progress.bar("depth completion", total) as advance, freed_memory_kept(), completer.working_side_by_side():
        for one in planned:
            kept.append([])
            points, content = points_of(one, frames, sensor, progress), one.rectifier.mask(frames.content)
            complete = partial(_complete, one, points=points, content=content, completer=completer, store=store)
            batches = [one.rows[start : start + size].tolist() for start in range(0, len(one), size)]
            for rows in prefetched(complete, batches, completer.at_once, completer.at_once):
                kept[-1] += [row for row, is_whole in rows if is_whole]
                done += len(rows)
                advance(done)
    workspace.finish(STAGE, keyframe_rows=kept, kept_share=[round(one.rectifier.kept_share, 4) for one in planned])
    skipped = total - sum(len(rows) for rows in kept)
    progress.log(
        f"{counted(total - skipped, 'keyframe')} completed" + (f", {skipped} had too few points" if skipped else "")
    )


def _complete(
    submap: CompletedSubmap,
    rows: list[int],
    points: Callable[[int], SparseDepth],
    content: NDArray[np.uint8],
    completer: DepthCompleter,
    store: DiskKeyframes,
) -> list[tuple[int, bool]]:
    """Complete the keyframes of a batch and write them; each row, and whether it has enough points."""
    sparse = {row: points(row) for row in rows}
    enough = [row for row in rows if len(sparse[row].depth) >= MIN_POINTS]
    index = {row: int(submap.submap.frames[row]) for row in enough}
    # The whole batch anew where any of it is missing: a GPU's values may depend on the batch, and a stop must not.
    missing = enough if any(not store.has_depth(index[row]) for row in enough) else []
    inside = inside_of(content)
    maps = [sparse[row].maps(*content.shape) for row in missing]
    rgb, corrected = [submap.rgb(row) for row in missing], not store.first  # first depths are corrected when refined
    for row, depth, confidence in zip(missing, *_predicted(rgb, maps, completer, corrected)):
        kept = (np.where(inside, values, np.float32(0)) for values in (depth, confidence))
        store.write_depth(index[row], *kept)
    return [(row, row in index) for row in rows]


def inside_of(content: NDArray[np.uint8]) -> NDArray[np.bool_]:
    """(H,W) pixels whose depth is kept: the content's, without its rim where it does not fill the picture."""
    return cv2.erode(content, np.ones((3, 3), np.uint8)) > 0 if not content.all() else content > 0


def _predicted(
    rgb: list[NDArray[np.uint8]],
    maps: list[tuple[NDArray[np.float32], NDArray[np.float32]]],
    completer: DepthCompleter,
    corrected: bool,
) -> tuple[Iterable[NDArray[np.float32]], Iterable[NDArray[np.float32]]]:
    """Depth and confidence of frames of one size, each (H,W)."""
    if not rgb:
        return (), ()
    depth, error = zip(*maps, strict=True)
    return completer.batch(np.stack(rgb), np.stack(depth), np.stack(error), corrected)
