"""Front end `sfm`: SIFT, matching and mapping by COLMAP, in a process of its own.

The global mapper goes first, as it has no two-view start that could be false; where its result is doubtful, the
incremental one follows.
"""

import json
import shutil
import time
from pathlib import Path

from haustra.core.errors import HaustraError
from haustra.core.progress import Progress
from pipeline.config import FrontEndSettings, OdometrySettings
from pipeline.frontend.base import COLMAP_WORKER, FoundSubmap, FrontEndResult
from pipeline.frontend.colmap.sensor_adjustment import adjusted_to_sensor
from pipeline.frontend.scoring import candidates_of, needs_second_opinion
from pipeline.input.frames import Frames
from pipeline.input.sensor.sensor_depth import open_sensor
from pipeline.mapping.submap import read_submap
from pipeline.matching.sift_cache import SiftCache
from pipeline.run_folder.subprocesses import run_isolated
from pipeline.run_folder.workspace import Workspace

PEAK_THRESHOLD = 0.002  # a third of COLMAP's: mucosa has weak contrast
MAX_FEATURES = 2048  # per frame; more only lengthens matching
OVERLAP = 8  # frames; each is matched with as many before it
LOOP_NEIGHBOURS = 2  # look-alike frames beyond the overlap tried for each frame that looks for loops
LOOP_STRIDE = 10  # frames between two that look for loops
MATCHING_SHARE = 0.45  # of the time that COLMAP is given, for features and matches; mapping has the rest
THREADS = 2  # of feature extraction; matching and mapping take one, to be repeatable


class ColmapFrontEnd:
    """Structure from motion by COLMAP."""

    closes_loops = True

    def check(self, settings: FrontEndSettings) -> None:
        if settings.odometry != OdometrySettings():
            raise HaustraError("the front end sfm has no keyframe_motion (--fast) and no chunks; take odometry or auto")

    def run(
        self, frames: Frames, features: SiftCache, settings: FrontEndSettings, workspace: Workspace, progress: Progress
    ) -> FrontEndResult:
        job = colmap_job(frames, settings.seed, workspace)
        end, log = settings.deadline, workspace.log / "match.log"
        if end is not None:
            job["matching_until_s"] = MATCHING_SHARE * (end - time.monotonic())
        run_isolated(COLMAP_WORKER, "match", job, log, "features and matches", progress, end)
        if end is not None:
            _say_what_was_matched(workspace.log / "matched.json", progress)
        found = {"global": map_by_colmap("global", job, workspace, progress, end)}
        judged = candidates_of("global", found["global"], workspace)
        if needs_second_opinion(judged, len(frames.index)) and (end is None or time.monotonic() < end):
            found["incremental"] = map_by_colmap("incremental", job, workspace, progress, end)
        if not any(found.values()) and all((workspace.log / f"{mapper}.failed").exists() for mapper in found):
            raise HaustraError(f"COLMAP failed to map the frames; its logs are in {workspace.log}")
        sensor = open_sensor(workspace, frames.camera.width)
        if sensor is not None and sensor.settings.adjust:
            found = {m: adjusted_to_sensor(of, frames.camera, sensor, progress) for m, of in found.items()}
        return FrontEndResult(found)


def _say_what_was_matched(path: Path, progress: Progress) -> None:
    """Where the time ended matching before the last pair; path: of what the worker counted."""
    if not path.exists():
        return
    counts = json.loads(path.read_text())
    if counts["matched"] < counts["pairs"]:
        progress.log(
            f"of {counts['pairs']} pairs of frames {counts['matched']} were matched in the time, neighbours first"
            + ("; these are mapped" if counts["matched"] else "")
        )


def colmap_job(frames: Frames, seed: int, workspace: Workspace) -> dict[str, object]:
    """What COLMAP's worker must know of the run. HaustraError for a lens that COLMAP lacks."""
    if not frames.camera.lens.in_colmap:
        raise HaustraError(f"COLMAP has no lens model {frames.camera.model}; take --front-end odometry")
    return {
        "database": str(workspace.features),
        "image_folder": str(workspace.images),
        "images": [workspace.image_path(int(index)).name for index in frames.index],
        "masks": str(workspace.masks),
        "scratch": str(workspace.log),
        "camera": frames.camera.to_dict(),
        "refine_camera": not frames.camera.trusted,
        "seed": seed,
        "peak_threshold": PEAK_THRESHOLD,
        "max_features": MAX_FEATURES,
        "overlap": OVERLAP,
        "loop_neighbours": LOOP_NEIGHBOURS,
        "loop_stride": LOOP_STRIDE,
        "threads": THREADS,
    }


def map_by_colmap(
    mapper: str, job: dict[str, object], workspace: Workspace, progress: Progress, deadline: float | None = None
) -> list[FoundSubmap]:
    """All models of one mapper, most frames first.

    A mapper that fails or is late is logged, and what it wrote before is used; the other one may still succeed.
    """
    output = workspace.log / mapper
    shutil.rmtree(output, ignore_errors=True)
    failed = workspace.log / f"{mapper}.failed"
    failed.unlink(missing_ok=True)
    job = job | {"method": mapper, "output": str(output)}
    try:
        log, label = workspace.log / f"{mapper}.log", f"structure ({mapper})"
        run_isolated(COLMAP_WORKER, "map", job, log, label, progress, deadline)
    except HaustraError as error:
        progress.log(str(error))
        failed.write_text(str(error))
    found = [FoundSubmap(read_submap(p.parent), p.parent) for p in sorted(output.glob("*/model.npz"))]
    return sorted(found, key=lambda one: -len(one.submap.frames))
