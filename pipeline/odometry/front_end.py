"""Working frames to submaps by streaming odometry: the door of this package."""

import time
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from pipeline.errors import HaustraError
from pipeline.frames import Frames, read_image
from pipeline.odometry.merging import polish_and_merge
from pipeline.odometry.odometry import Odometry
from pipeline.odometry.outcome import to_submap
from pipeline.odometry.rays import RayTable
from pipeline.progress import Progress
from pipeline.submap import Submap
from pipeline.workspace import Workspace

MIN_FRAMES = 3  # of a submap


@dataclass(frozen=True)
class Tracked:
    """submaps: most frames first. frames_per_second: wall time of tracking and local mapping, images read from disk.
    maps: how many were begun and kept; joins: how many of them were merged into another."""

    submaps: list[Submap]
    frames_per_second: float
    maps: int
    joins: int


def track_frames(frames: Frames, stride: int, seed: int, workspace: Workspace, progress: Progress) -> Tracked:
    """Pose the stored working frames one after the other, then polish each map."""

    def read(index: int) -> tuple[NDArray[np.uint8], NDArray[np.uint8]]:
        return read_image(workspace.image_path(index)), _read_mask(workspace, index)

    odometry = Odometry(RayTable(frames.camera), seed, stride)
    started, submaps = time.perf_counter(), 0
    with progress.bar("odometry", len(frames.index)) as advance:
        for done, index in enumerate(frames.index.tolist(), start=1):
            odometry.feed(index, *read(index))
            advance(done)
            if odometry.submaps > submaps:
                submaps = odometry.submaps
                pace = done / max(time.perf_counter() - started, 1e-9)
                progress.say(f"frame {index}: tracking in submap {submaps}, {pace:.0f} frames a second")
    rate = len(frames.index) / max(time.perf_counter() - started, 1e-9)
    maps = odometry.finish()
    with progress.bar("joining submaps", None):
        merged, joins = polish_and_merge(maps, read, seed)
    found = [to_submap(local_map, frames.camera.params) for local_map in merged]
    kept = [submap for submap in found if submap is not None and len(submap.frames) >= MIN_FRAMES]
    kept.sort(key=lambda submap: -len(submap.frames))
    return Tracked(kept, rate, len(maps), joins)


def _read_mask(workspace: Workspace, index: int) -> NDArray[np.uint8]:
    path = workspace.mask_path(index)
    mask = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)
    if mask is None:
        raise HaustraError(f"{path} is missing or damaged; start the run anew with --overwrite")
    return mask
