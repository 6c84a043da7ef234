"""Working frames to submaps by streaming odometry: the door of this package."""

import copy
import time
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from haustra.core.camera import Camera
from haustra.core.progress import Progress
from haustra.core.ray_table import RayTable
from pipeline.config import Config
from pipeline.frontend.odometry.chunks import Seams, cut, jobs_of, local_run, processors, ray_run, track_chunks
from pipeline.frontend.odometry.frame_io import frame_reader, single_threaded
from pipeline.frontend.odometry.klt import View
from pipeline.frontend.odometry.prefetch import made_ahead
from pipeline.frontend.odometry.self_calibration import FRAME_STEP, KEYFRAME_STEP, refine_lens
from pipeline.frontend.odometry.state_machine import Odometry
from pipeline.input.frames import Frames
from pipeline.mapping.feature_adjustment import adjust_to_features
from pipeline.mapping.local_map import LocalMap, TrackKind
from pipeline.mapping.map_adjustment import adjust_all
from pipeline.mapping.submap import Submap
from pipeline.mapping.submap_merging import merge_maps
from pipeline.mapping.submap_of_map import to_submap
from pipeline.matching.sift import FindFeatures
from pipeline.matching.sift_cache import SiftCache
from pipeline.run_folder.workspace import Workspace

MIN_FRAMES = 3  # of a submap
LENS_ROUNDS = 3
FAR, SETTLED = 0.01, 0.001  # of the width, by which a better lens shifts pixels: first to corners; no need to ask again


@dataclass(frozen=True)
class Tracked:
    """submaps: most frames first. frames_per_second: wall time of tracking and local mapping, images read from disk.
    maps: how many were begun and kept; joins: how many of them were merged into another. seams: of a film that was
    tracked in chunks."""

    submaps: list[Submap]
    frames_per_second: float
    maps: int
    joins: int
    seams: Seams | None = None


def track_frames(frames: Frames, config: Config, workspace: Workspace, progress: Progress) -> Tracked:
    """Pose the stored working frames, then adjust each map; a guessed lens is refined with them."""
    with single_threaded(), SiftCache(frame_reader(workspace)) as features:
        started = time.perf_counter()
        maps, seams = _tracked(frames, config, features, workspace, progress)
        rate = len(frames.index) / max(time.perf_counter() - started, 1e-9)
        held = adjust_maps(maps, features, progress, changed=seams is not None)
        camera = frames.camera
        sigma: tuple[float, ...] = ()
        if maps and not camera.trusted:
            camera, sigma, held = _better_lens(maps, held, camera, config.seed, features, workspace, progress)
        merged, joins = join_maps(maps, held, features, config.seed, progress)
        return Tracked(_submaps(merged, camera.params, sigma), rate, len(maps), joins, seams)


def _tracked(
    frames: Frames, config: Config, features: SiftCache, workspace: Workspace, progress: Progress
) -> tuple[list[LocalMap], Seams | None]:
    """Maps as tracking leaves them; and, where the film was tracked in chunks, how these were put together."""
    rays, settings = RayTable(frames.camera), config.odometry
    pieces = cut(len(frames.index), settings.chunks)
    if settings.chunks > 1 and len(pieces) == 1:
        progress.say(f"{len(frames.index)} frames are too few for chunks; they are tracked in one go")
    if len(pieces) > 1:
        run = local_run(processors()) if settings.ray is None else ray_run(settings.ray)
        jobs = jobs_of(frames.index, frames.camera, pieces, config, workspace)
        return track_chunks(jobs, rays, run, progress)
    odometry = Odometry(rays, config.seed, config.frames.stride, settings.keyframe_motion)
    read = frame_reader(workspace)

    def look(index: int) -> tuple[int, NDArray[np.uint8], View]:
        rgb, mask = read(index)
        return index, rgb, odometry.view(rgb, mask)

    started = time.perf_counter()
    with progress.bar("odometry", len(frames.index)) as advance:
        for done, (index, rgb, view) in enumerate(made_ahead(look, frames.index.tolist()), start=1):
            state = odometry.feed(index, rgb, view)
            if odometry.keyframe == index:
                features.begin(index)
            pace = done / max(time.perf_counter() - started, 1e-9)
            advance(done, note=f"{state}, submap {odometry.submaps}, {pace:.0f} frames/s")
    return odometry.finish(), None


def join_maps(
    maps: list[LocalMap], held: list[float | None], find: FindFeatures, seed: int, progress: Progress
) -> tuple[list[LocalMap], int]:
    """Maps that saw the same places made one, and how many joins there were.

    After each map has been straightened by its features: a bent map's scale at the seam is not that of the rest. Where
    the features that held the parts do not hold the whole, the parts are given back: a seam must not cost them that.
    """
    if len(maps) < 2:
        return maps, 0
    apart = copy.deepcopy(maps)
    with progress.bar("joining submaps", None):
        merged = merge_maps(maps, find, seed)
    result: list[LocalMap] = []
    for whole in merged:
        if len(whole.members) == 1:
            result.append(whole.map)
            continue
        (by,) = refit_maps([whole.map], find, progress)
        before = [width for width in (held[number] for number in whole.members) if width is not None]
        if len(before) < len(whole.members):  # one of them never was
            if by is None:
                adjust_all(whole.map, changed=True)
        elif by is None or by > max(before):
            progress.say(f"{len(before)} submaps look alike, but their features do not hold together; they stay apart")
            result += [apart[number] for number in whole.members]
            continue
        result.append(whole.map)
    return result, len(maps) - len(result)


def adjust_maps(
    maps: list[LocalMap], find: FindFeatures, progress: Progress, changed: bool = False
) -> list[float | None]:
    """As `refit_maps`; and those that features do not hold to their corners, `changed` or not (see `adjust_all`)."""
    held = refit_maps(maps, find, progress)
    for local_map in (m for m, by in zip(maps, held, strict=True) if by is None):
        with progress.bar("adjusting to corners", None) as advance:
            adjust_all(local_map, changed, advance)
    return held


def refit_maps(maps: list[LocalMap], find: FindFeatures, progress: Progress) -> list[float | None]:
    """Every map moved to where its own features have it. Those that they do not hold (None) stay, and a sentence says
    so; of the others, how wide the features were at most."""
    if not maps:
        return []
    held = []
    for local_map in maps:
        with progress.bar("adjusting to features", None) as advance:
            held.append(adjust_to_features(local_map, find, advance))
    for local_map in (m for m, by in zip(maps, held, strict=True) if by is None):
        first, last = local_map.keyframes[0].frame, local_map.keyframes[-1].frame
        progress.say(
            f"frames {first} to {last}: too few features to adjust the map by; its scale may bend along the path"
        )
    return held


def _submaps(
    maps: list[LocalMap], params: tuple[float, ...], sigma: tuple[float, ...] = (), kind: TrackKind | None = None
) -> list[Submap]:
    """Of the maps that are long enough, most frames first; kind: see `to_submap`."""
    found = [to_submap(local_map, params, sigma, kind) for local_map in maps]
    kept = [submap for submap in found if submap is not None and len(submap.frames) >= MIN_FRAMES]
    return sorted(kept, key=lambda submap: -len(submap.frames))


def _better_lens(
    maps: list[LocalMap],
    held: list[float | None],
    guess: Camera,
    seed: int,
    find: FindFeatures,
    workspace: Workspace,
    progress: Progress,
) -> tuple[Camera, tuple[float, ...], list[float | None]]:
    """All maps adjusted with the lens that the largest one determines, or left with the guess if it does not; the lens,
    its sigmas, and what holds the maps now.

    Features of keyframes are asked before followed corners: these slide, and the lens is bent to fit. What the map lost
    for not fitting the guess would have spoken against it, so the lens is asked again of the map that was adjusted with
    it, until it stays.
    """
    largest = max(maps, key=lambda m: len(m.posed) + len(m.keyframes))
    camera = guess
    sigma: tuple[float, ...] = ()
    for _ in range(LENS_ROUNDS):
        by_features = _submaps([largest], camera.params, kind=TrackKind.FEATURE)
        asked = by_features or _submaps([largest], camera.params)
        if not asked:
            break
        step = KEYFRAME_STEP if by_features else FRAME_STEP
        lens = refine_lens(asked[0], camera, seed, workspace.log, progress, step)
        if not lens.determined:
            return camera, sigma or lens.sigma, held  # an earlier round's answer stands
        shift = lens_shift(camera, lens.camera)
        sigma = lens.sigma
        if shift < SETTLED:
            break
        camera = lens.camera
        held = _with_lens(maps, camera, shift > FAR, find, progress)
    return camera, sigma, held


def lens_shift(old: Camera, new: Camera) -> float:
    """By how much one lens puts what another sees elsewhere: RMS over the picture, as a share of its width. Where
    either has no ray does not count; infinite if that is everywhere."""
    rays = RayTable(old)
    rows, columns = np.nonzero(rays.usable & RayTable(new).usable)
    if len(rows) == 0:
        return float("inf")
    pixels = np.stack([columns, rows], axis=1)[:: max(1, len(rows) // 5000)] + 0.5
    seen, _ = rays.look_up(pixels)
    off = new.project(np.concatenate([seen, np.ones((len(seen), 1))], axis=1)) - pixels
    return float(np.sqrt((off**2).sum(axis=1).mean()) / old.width)


def _with_lens(
    maps: list[LocalMap], camera: Camera, far: bool, find: FindFeatures, progress: Progress
) -> list[float | None]:
    """Adjust all maps with another lens; with one that is far from the last, first to the followed corners alone."""
    rays = RayTable(camera)
    for local_map in maps:
        local_map.recalibrate(rays)
        if far:
            local_map.forget_features()
            with progress.bar("adjusting to corners", None) as advance:
                adjust_all(local_map, True, advance)
    return adjust_maps(maps, find, progress, changed=True)
