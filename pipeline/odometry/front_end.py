"""Working frames to submaps by streaming odometry: the door of this package."""

import time
from dataclasses import dataclass, replace
from itertools import count

import cv2
import numpy as np
from numpy.typing import NDArray
from threadpoolctl import threadpool_limits

from pipeline.camera import Camera
from pipeline.errors import HaustraError
from pipeline.frames import Frames, read_image
from pipeline.odometry.local_map import LocalMap
from pipeline.odometry.merging import merge_maps
from pipeline.odometry.odometry import Odometry
from pipeline.odometry.outcome import polish, to_submap
from pipeline.odometry.places import ReadFrame
from pipeline.odometry.rays import RayTable
from pipeline.odometry.refit import refit
from pipeline.odometry.self_calibration import FRAME_STEP, KEYFRAME_STEP, refine_lens
from pipeline.progress import Progress
from pipeline.submap import Submap
from pipeline.workspace import Workspace

MIN_FRAMES = 3  # of a submap
LENS_ROUNDS = 3
FAR, SETTLED = 0.01, 0.001  # of the width, by which a better lens shifts pixels: first to corners; no need to ask again


@dataclass(frozen=True)
class Tracked:
    """submaps: most frames first. frames_per_second: wall time of tracking and local mapping, images read from disk.
    maps: how many were begun and kept; joins: how many of them were merged into another."""

    submaps: list[Submap]
    frames_per_second: float
    maps: int
    joins: int


def track_frames(frames: Frames, stride: int, seed: int, workspace: Workspace, progress: Progress) -> Tracked:
    """Pose the stored working frames one after the other, then polish each map; a guessed lens is refined with them."""

    def read(index: int) -> tuple[NDArray[np.uint8], NDArray[np.uint8]]:
        return read_image(workspace.image_path(index)), _read_mask(workspace, index)

    # Most matrices are small: with a second thread of BLAS a film took twice the processor time, and longer.
    with threadpool_limits(1, "blas"):
        return _track(frames, stride, seed, read, workspace, progress)


def _track(
    frames: Frames, stride: int, seed: int, read: ReadFrame, workspace: Workspace, progress: Progress
) -> Tracked:
    odometry = Odometry(RayTable(frames.camera), seed, stride)
    started = time.perf_counter()
    with progress.bar("odometry", len(frames.index)) as advance:
        for done, index in enumerate(frames.index.tolist(), start=1):
            state = odometry.feed(index, *read(index))
            pace = done / max(time.perf_counter() - started, 1e-9)
            advance(done, note=f"{state}, submap {odometry.submaps}, {pace:.0f} frames/s")
    rate = len(frames.index) / max(time.perf_counter() - started, 1e-9)
    maps = odometry.finish()
    for local_map in maps:
        polish(local_map)
    _refit(maps, read, progress)
    merged, joins = _joined(maps, read, seed, progress)
    found = _submaps(merged, frames.camera.params)
    if found and not frames.camera.trusted:
        found = _with_better_lens(found, merged, frames, seed, read, workspace, progress)
    return Tracked(found, rate, len(maps), joins)


def _joined(maps: list[LocalMap], read: ReadFrame, seed: int, progress: Progress) -> tuple[list[LocalMap], int]:
    """Maps that saw the same places made one, and how many joins there were.

    After each map has been straightened by its features: a bent map's scale at the seam is not that of the rest.
    """
    with progress.bar("joining submaps", None):
        merged = merge_maps(maps, read, seed)
    grown = [local_map for local_map, joins in merged if joins]
    for local_map in _refit(grown, read, progress):
        polish(local_map, changed=True)
    return [local_map for local_map, _ in merged], sum(joins for _, joins in merged)


def _refit(maps: list[LocalMap], read: ReadFrame, progress: Progress) -> list[LocalMap]:
    """Every map moved to where its own features have it. Returns those that they do not hold, which stay; a sentence
    says so."""
    if not maps:
        return []
    done = count(1)  # safe from several threads

    def counted(frame: int) -> tuple[NDArray[np.uint8], NDArray[np.uint8]]:
        advance(next(done))
        return read(frame)

    with progress.bar("features of keyframes", sum(len(m.keyframes) for m in maps)) as advance:
        held = [refit(local_map, counted) for local_map in maps]
    left = [local_map for local_map, yes in zip(maps, held, strict=True) if not yes]
    for local_map in left:
        first, last = local_map.keyframes[0].frame, local_map.keyframes[-1].frame
        progress.say(
            f"frames {first} to {last}: too few features to adjust the map by; its scale may bend along the path"
        )
    return left


def _submaps(maps: list[LocalMap], params: tuple[float, ...], sigma: tuple[float, ...] = ()) -> list[Submap]:
    """Of the maps that are long enough, most frames first."""
    found = [to_submap(local_map, params, sigma) for local_map in maps]
    kept = [submap for submap in found if submap is not None and len(submap.frames) >= MIN_FRAMES]
    return sorted(kept, key=lambda submap: -len(submap.frames))


def _with_better_lens(
    found: list[Submap],
    maps: list[LocalMap],
    frames: Frames,
    seed: int,
    read: ReadFrame,
    workspace: Workspace,
    progress: Progress,
) -> list[Submap]:
    """All maps adjusted with the lens that the largest submap determines, or with the guess if it does not.

    Features of keyframes are asked before followed corners: these slide, and the lens is bent to fit. What the map lost
    for not fitting the guess would have spoken against it, so a lens that moved far is asked once more of the map that
    was adjusted with it.
    """
    largest = max(maps, key=lambda m: len(m.posed) + len(m.keyframes))
    camera = frames.camera
    for _ in range(LENS_ROUNDS):
        by_features = _submaps([largest.of_features()], camera.params)
        step = KEYFRAME_STEP if by_features else FRAME_STEP
        lens = refine_lens((by_features or found)[0], camera, seed, workspace.log, progress, step)
        shift = _shift(camera, lens.camera)
        if not lens.determined or shift < SETTLED:
            return [replace(submap, camera_sigma=lens.sigma) for submap in found]
        camera = lens.camera
        _with_lens(maps, camera, shift > FAR, read, progress)
        found = _submaps(maps, camera.params, lens.sigma)
        if not found:
            break
    return found


def _shift(old: Camera, new: Camera) -> float:
    """By how much one lens puts what another sees elsewhere: RMS over the picture, as a share of its width."""
    x, y = np.meshgrid(*(np.linspace(0.5, size - 0.5, 9) for size in (old.width, old.height)))
    pixels = np.stack([x.ravel(), y.ravel()], axis=1)
    seen, _ = RayTable(old).look_up(pixels)
    off = new.project(np.concatenate([seen, np.ones((len(seen), 1))], axis=1)) - pixels
    return float(np.sqrt((off**2).sum(axis=1).mean()) / old.width)


def _with_lens(maps: list[LocalMap], camera: Camera, far: bool, read: ReadFrame, progress: Progress) -> None:
    """Adjust all maps with another lens; one that is far from the last is first fitted to the followed corners."""
    rays = RayTable(camera)
    for local_map in maps:
        local_map.recalibrate(rays)
        if far:
            polish(local_map, changed=True)
    for local_map in _refit(maps, read, progress):
        polish(local_map, changed=True)


def _read_mask(workspace: Workspace, index: int) -> NDArray[np.uint8]:
    path = workspace.mask_path(index)
    mask = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)
    if mask is None:
        raise HaustraError(f"{path} is missing or damaged; start the run anew with --overwrite")
    return mask
