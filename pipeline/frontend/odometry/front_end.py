"""Front end `odometry`: working frames to submaps by streaming odometry."""

import shutil
import time
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from haustra.core.progress import Progress
from haustra.core.ray_table import RayTable
from haustra.core.threads import prefetched, processors, single_threaded
from pipeline.config import FrontEndSettings
from pipeline.frontend.base import FoundSubmap, FrontEndResult
from pipeline.frontend.odometry.backward_tracking import extend_backwards
from pipeline.frontend.odometry.bridging.gap import bridge_maps, clouds_of
from pipeline.frontend.odometry.chunks import (
    Stitching,
    jobs_of,
    local_run,
    ray_run,
    split,
    temp_dir,
    track_chunks,
)
from pipeline.frontend.odometry.finish_maps import adjust_maps, join_maps, make_all_metric, submaps_of
from pipeline.frontend.odometry.frame_io import frame_reader
from pipeline.frontend.odometry.klt import TrackerImage
from pipeline.frontend.odometry.self_calibration import refine_intrinsics
from pipeline.frontend.odometry.state_machine import Odometry
from pipeline.input.frames import Frames
from pipeline.input.sensor.sensor_depth import open_sensor
from pipeline.mapping.local_map import LocalMap
from pipeline.mapping.submap import Submap
from pipeline.matching.sift_cache import SiftCache
from pipeline.run_folder.workspace import Workspace

NAME = "odometry"


class OdometryFrontEnd:
    """Streaming odometry that ends in a bundle adjustment of each map."""

    closes_loops = False

    def check(self, settings: FrontEndSettings) -> None:
        """Its settings are checked where they are defined."""

    def run(
        self, frames: Frames, settings: FrontEndSettings, workspace: Workspace, progress: Progress
    ) -> FrontEndResult:
        tracked = track_frames(frames, settings, workspace, progress)
        progress.log(tracked.sentence)
        shutil.rmtree(workspace.log / NAME, ignore_errors=True)
        shutil.rmtree(temp_dir(workspace), ignore_errors=True)
        return FrontEndResult({NAME: [FoundSubmap(submap) for submap in tracked.submaps]}, tracked.stats)


@dataclass(frozen=True)
class Tracked:
    """submaps: most frames first. frames_per_second: wall time of tracking and local mapping, images read from disk.
    maps: how many were begun and kept; joins: how many of them were merged into another. stitching: of a video
    that was tracked in chunks."""

    submaps: list[Submap]
    frames_per_second: float
    maps: int
    joins: int
    stitching: Stitching | None = None

    @property
    def stats(self) -> dict[str, float]:
        """For `run.yaml`."""
        chunks = (
            {} if self.stitching is None else {"chunks": self.stitching.chunks, "closed_seams": self.stitching.closed}
        )
        return {"frames_per_second": self.frames_per_second, "maps": self.maps, "joins": self.joins, **chunks}

    @property
    def sentence(self) -> str:
        merged = f"; {self.joins} of {self.maps} submaps merged into another" if self.maps > 1 else ""
        if self.stitching is None:
            return f"odometry at {self.frames_per_second:.1f} frames a second{merged}"
        chunks, closed = self.stitching.chunks, self.stitching.closed
        return f"odometry in {chunks} chunks, {closed} of {chunks - 1} joined by the frames that they share{merged}"


def track_frames(frames: Frames, settings: FrontEndSettings, workspace: Workspace, progress: Progress) -> Tracked:
    """Pose the stored working frames, then adjust each map; a guessed lens is refined with them."""
    with single_threaded(), SiftCache(frame_reader(workspace)) as features:
        started = time.perf_counter()
        maps, stitching = _tracked(frames, settings, features, workspace, progress)
        rate = len(frames.index) / max(time.perf_counter() - started, 1e-9)
        sensor = open_sensor(workspace, frames.camera.width)
        if sensor is not None and sensor.settings.adjust:
            make_all_metric(maps, sensor.for_adjustment, progress)
        held = adjust_maps(maps, features, progress, changed=stitching is not None)
        camera = frames.camera
        sigma: tuple[float, ...] = ()
        if maps and not camera.trusted:
            camera, sigma, held = refine_intrinsics(maps, held, camera, settings.seed, features, workspace, progress)
        merged, joins = join_maps(maps, held, features, settings.seed, progress)
        if sensor is not None and len(merged) > 1:
            merged, bridged = bridge_maps(merged, clouds_of(sensor, merged[0].rays), features, progress)
            joins += bridged
        return Tracked(submaps_of(merged, camera.params, sigma), rate, len(maps), joins, stitching)


def _tracked(
    frames: Frames, settings: FrontEndSettings, features: SiftCache, workspace: Workspace, progress: Progress
) -> tuple[list[LocalMap], Stitching | None]:
    """Maps as tracking leaves them; and, where the film was tracked in chunks, how these were put together."""
    rays = RayTable(frames.camera)
    pieces = split(len(frames.index), settings.odometry.chunks)
    if settings.odometry.chunks > 1 and len(pieces) == 1:
        progress.log(f"{len(frames.index)} frames are too few for chunks; they are tracked in one go")
    if len(pieces) > 1:
        run = local_run(processors()) if settings.odometry.ray is None else ray_run(settings.odometry.ray)
        jobs = jobs_of(frames.index, frames.camera, pieces, settings, workspace)
        return track_chunks(jobs, rays, run, progress)
    odometry = Odometry(rays, settings.seed, settings.stride, settings.odometry.keyframe_motion)
    read = frame_reader(workspace)

    def look(index: int) -> tuple[int, NDArray[np.uint8], TrackerImage]:
        rgb, mask = read(index)
        return index, rgb, odometry.view(rgb, mask)

    started = time.perf_counter()
    with progress.bar("odometry", len(frames.index)) as advance:
        for done, (index, rgb, view) in enumerate(prefetched(look, frames.index.tolist()), start=1):
            state = odometry.process(index, rgb, view)
            if odometry.keyframe == index:
                features.begin(index)
            pace = done / max(time.perf_counter() - started, 1e-9)
            advance(done, note=f"{state}, submap {odometry.submaps}, {pace:.0f} frames/s")
    with progress.bar("tracking backwards", None) as advance:
        maps, _ = extend_backwards(
            odometry.finish(),
            frames.index,
            lambda frame: look(frame)[1:],
            settings.stride,
            settings.odometry.keyframe_motion,
            settings.seed,
            advance,
        )
    return maps, None
