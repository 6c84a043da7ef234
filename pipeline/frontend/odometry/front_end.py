"""Front end `odometry`: working frames to submaps by streaming odometry."""

import shutil
import time
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from haustra.core.progress import Progress
from haustra.core.ray_table import RayTable, ray_table
from haustra.core.threads import prefetched, processors, single_threaded
from pipeline.config import FrontEndSettings
from pipeline.frontend.base import FoundSubmap, FrontEndResult
from pipeline.frontend.odometry.backward_tracking import Look, extend_backwards
from pipeline.frontend.odometry.bridging.depth_clouds import clouds_of
from pipeline.frontend.odometry.bridging.gap import bridge_maps
from pipeline.frontend.odometry.chunks import (
    Stitching,
    jobs_of,
    local_run,
    ray_run,
    split,
    temp_dir,
    track_chunks,
)
from pipeline.frontend.odometry.frame_io import frame_reader
from pipeline.frontend.odometry.klt import TrackerImage
from pipeline.frontend.odometry.scale_breaks import find_break
from pipeline.frontend.odometry.self_calibration import refine_intrinsics
from pipeline.frontend.odometry.tracking import Odometry
from pipeline.frontend.odometry.two_view import START_WITH_LITTLE_PARALLAX, USUAL_START
from pipeline.input.frames import Frames
from pipeline.input.sensor.sensor_depth import open_sensor
from pipeline.mapping.final_adjustment import adjust_maps
from pipeline.mapping.local_map import LocalMap
from pipeline.mapping.metric_map import doubt_of_axis_by, make_all_metric
from pipeline.mapping.submap import Submap
from pipeline.mapping.submap_merging import merge_and_adjust
from pipeline.mapping.submap_of_map import submaps_of
from pipeline.matching.sift_cache import SiftCache
from pipeline.run_folder.malloc import give_back_freed_memory
from pipeline.run_folder.workspace import Workspace

NAME = "odometry"
LITTLE_PARALLAX = (
    f"odometry began its map with less than {USUAL_START} between two frames: a wall that moves before a camera at "
    "rest can look the same, so trust path and surface only if the wall stood still"
)
KEPT = 3  # keyframes before a cut whose new tracks have their points in the later part alone


class OdometryFrontEnd:
    """Streaming odometry that ends in a bundle adjustment of each map."""

    closes_loops = False

    def check(self, settings: FrontEndSettings) -> None:
        """Its settings are checked where they are defined."""

    def run(
        self, frames: Frames, features: SiftCache, settings: FrontEndSettings, workspace: Workspace, progress: Progress
    ) -> FrontEndResult:
        tracked = track_frames(frames, features, settings, workspace, progress)
        progress.log(tracked.sentence)
        shutil.rmtree(workspace.log / NAME, ignore_errors=True)
        shutil.rmtree(temp_dir(workspace), ignore_errors=True)
        return FrontEndResult(
            {NAME: [FoundSubmap(submap) for submap in tracked.submaps]}, tracked.stats, tracked.warnings
        )


@dataclass(frozen=True)
class Tracked:
    """submaps: most frames first. frames_per_second: wall time of tracking and local mapping, images read from disk.
    maps: how many there were before merging; joins: how many of them were merged into another, bridged: of these, by a
    sensor's depth alone. stitching: of a video that was tracked in chunks. warnings: sentences for a person. cuts: how
    often a map was cut at a scale break."""

    submaps: list[Submap]
    frames_per_second: float
    maps: int
    joins: int
    stitching: Stitching | None = None
    bridged: int = 0
    warnings: tuple[str, ...] = ()
    cuts: int = 0

    @property
    def stats(self) -> dict[str, float]:
        """For `run.yaml`."""
        chunks = (
            {} if self.stitching is None else {"chunks": self.stitching.chunks, "closed_seams": self.stitching.closed}
        )
        rate = {"frames_per_second": self.frames_per_second}
        return {**rate, "maps": self.maps, "joins": self.joins, "bridged": self.bridged, "cuts": self.cuts, **chunks}

    @property
    def sentence(self) -> str:
        merged = f"; {self.joins} of {self.maps} submaps merged into another" if self.maps > 1 else ""
        if self.stitching is None:
            return f"odometry at {self.frames_per_second:.1f} frames a second{merged}"
        chunks, closed = self.stitching.chunks, self.stitching.closed
        return f"odometry in {chunks} chunks, {closed} of {chunks - 1} joined by the frames that they share{merged}"


def track_frames(
    frames: Frames, features: SiftCache, settings: FrontEndSettings, workspace: Workspace, progress: Progress
) -> Tracked:
    """Pose the stored working frames, then adjust each map; a guessed lens is refined with them."""
    with single_threaded():
        started = time.perf_counter()
        maps, stitching, warning = _tracked(frames, features, settings, workspace, progress)
        rate = len(frames.index) / max(time.perf_counter() - started, 1e-9)
        maps, begun = cut_at_breaks(maps, progress), len(maps)
        give_back_freed_memory()  # the adjustment asks for other arrays
        sensor, doubt = open_sensor(workspace, frames.camera.width), ""
        if sensor is not None and sensor.settings.adjust:
            if not sensor.stereo:
                doubt = doubt_of_axis_by(maps, sensor.for_adjustment)
            make_all_metric(maps, sensor.for_adjustment, progress)
        camera, changed = frames.camera, stitching is not None
        sigma: tuple[float, ...] = ()
        if maps and not camera.trusted:
            camera, sigma, widths = refine_intrinsics(
                maps, camera, settings.seed, features, workspace, progress, changed
            )
        else:
            widths = adjust_maps(maps, features, progress, changed)
        give_back_freed_memory()
        merged, joins = merge_and_adjust(maps, widths, features, settings.seed, progress)
        bridged = 0
        if sensor is not None and len(merged) > 1:
            merged, bridged = bridge_maps(merged, clouds_of(sensor, merged[0].rays), features, progress)
        submaps, warnings = submaps_of(merged, camera.params, sigma), tuple(one for one in (warning, doubt) if one)
        return Tracked(submaps, rate, len(maps), joins + bridged, stitching, bridged, warnings, len(maps) - begun)


def cut_at_breaks(maps: list[LocalMap], progress: Progress) -> list[LocalMap]:
    """The maps, each cut where its scale breaks, in the order of their frames; a sentence says where. Each part then
    has one scale, and merging may find the similarity between two that show the same wall.

    Each point goes to one part. The cut is where points of both scales are most mixed: some that began between the
    break and `KEPT` keyframes before the cut stay in the earlier part, though they have the later scale."""
    result: list[LocalMap] = []
    waiting = maps[::-1]
    while waiting:
        local_map = waiting.pop()
        number = find_break([local_map.sparse_view(keyframe) for keyframe in local_map.keyframes])
        if number is None:
            result.append(local_map)
            continue
        progress.log(
            f"frame {local_map.keyframes[number].frame}: points side by side in the picture lie at two depths, as "
            "where the scale of the map changes; it is cut into two submaps there"
        )
        earlier = _began_before(local_map, number - KEPT)
        parts = _part(local_map, 0, number, earlier), _part(local_map, number, len(local_map.keyframes), ~earlier)
        waiting += parts[::-1]
    return result


def _began_before(local_map: LocalMap, number: int) -> NDArray[np.bool_]:
    """(T,) whether each track was seen by a keyframe before `number`."""
    began = np.zeros(len(local_map.tracks), dtype=bool)
    for keyframe in local_map.keyframes[:number]:
        began[keyframe.ids] = True
    return began


def _part(local_map: LocalMap, first: int, end: int, among: NDArray[np.bool_]) -> LocalMap:
    """The map of keyframes `first` to before `end` and the frames after each, with the points of tracks `among` (T,)
    alone."""
    part = local_map.copied()
    part.tracks.has_point &= among
    part.keyframes = part.keyframes[first:end]
    part.tracked_frames = [
        replace(tracked, keyframe=tracked.keyframe - first)
        for tracked in part.tracked_frames
        if first <= tracked.keyframe < end
    ]
    return part


def _tracked(
    frames: Frames, features: SiftCache, settings: FrontEndSettings, workspace: Workspace, progress: Progress
) -> tuple[list[LocalMap], Stitching | None, str]:
    """Maps as tracking leaves them; where the film was tracked in chunks, how these were put together; and a warning
    where maps began with little parallax, else an empty one."""
    rays = ray_table(frames.camera)
    pieces = split(len(frames.index), settings.odometry.chunks)
    if settings.odometry.chunks > 1 and len(pieces) == 1:
        progress.log(f"{len(frames.index)} frames are too few for chunks; they are tracked in one go")
    if len(pieces) > 1:
        run = local_run(processors()) if settings.odometry.ray is None else ray_run(settings.odometry.ray)
        jobs = jobs_of(frames.index, frames.camera, pieces, settings, workspace)
        maps, stitching = track_chunks(jobs, rays, run, progress)
        if maps:
            return maps, stitching, ""
        progress.log("no chunk has a map that is kept; the film is tracked in one go")
    maps, warning = _tracked_in_one_go(frames, features, rays, settings, workspace, progress)
    return maps, None, warning


def _tracked_in_one_go(
    frames: Frames,
    features: SiftCache,
    rays: RayTable,
    settings: FrontEndSettings,
    workspace: Workspace,
    progress: Progress,
) -> tuple[list[LocalMap], str]:
    """Frame by frame, and again where no map began, with a warning then; for maps that began after the film did,
    backwards from their beginning, too."""
    motion, stride, read = settings.odometry.keyframe_motion, settings.stride, frame_reader(workspace)
    usual = Odometry(rays, settings.seed, stride, motion)

    def look(index: int) -> tuple[NDArray[np.uint8], TrackerImage]:
        rgb, mask = read(index)
        return rgb, usual.view(rgb, mask)

    maps, warning = _tracked_forwards(usual, frames.index.tolist(), look, features, progress), ""
    if usual.begun == 0:
        progress.log(
            f"no map begins with {USUAL_START} between two frames; the film is tracked once more, and "
            f"{START_WITH_LITTLE_PARALLAX} suffice, of points that fit twice as well"
        )
        again = Odometry(rays, settings.seed, stride, motion, START_WITH_LITTLE_PARALLAX)
        maps = _tracked_forwards(again, frames.index.tolist(), look, features, progress)
        warning = LITTLE_PARALLAX if maps else ""
    if all(local_map.keyframes[0].frame == frames.index[0] for local_map in maps):
        return maps, warning
    with progress.bar("tracking backwards", None) as advance:
        return extend_backwards(maps, frames.index, look, stride, motion, settings.seed, advance)[0], warning


def _tracked_forwards(
    odometry: Odometry, index: list[int], look: Look, features: SiftCache, progress: Progress
) -> list[LocalMap]:
    """The maps of frames `index`, in the order of their beginning."""
    started = time.perf_counter()
    with progress.bar("odometry", len(index)) as advance:
        for done, (frame, (rgb, view)) in enumerate(zip(index, prefetched(look, index), strict=True), start=1):
            state = odometry.process(frame, rgb, view)
            if odometry.keyframe == frame:
                features.begin(frame)
            pace = done / max(time.perf_counter() - started, 1e-9)
            advance(done, note=f"{state}, submap {odometry.submaps}, {pace:.0f} frames/s")
    return odometry.finish()
