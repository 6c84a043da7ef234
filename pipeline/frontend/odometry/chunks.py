"""A long film tracked in overlapping chunks, each in a process of its own or as a task of a Ray cluster.

A chunk's maps are kept on disk, so that a run that was stopped goes on with the chunks that are left. Chunks share
`OVERLAP` frames; what both sides posed there puts their maps together again.
"""

import json
import zipfile
import zlib
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor, wait
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from haustra.core.camera import Camera
from haustra.core.errors import HaustraError
from haustra.core.progress import Progress
from haustra.core.ray_table import RayTable
from haustra.core.threads import processors
from pipeline.config import FrontEndSettings
from pipeline.frontend.odometry.chunk_stitching import first_from_second, stitch, without_stubs
from pipeline.mapping.local_map import LocalMap
from pipeline.mapping.map_io import load_maps
from pipeline.run_folder import ray_cluster
from pipeline.run_folder.subprocesses import ChildProcesses, parent_bound_command
from pipeline.run_folder.workspace import Workspace, write_json

OVERLAP = 60  # frames worth tracking: a start takes some twenty of them, and ten must be posed by both sides
POLL_S = 0.5
WORKER = "pipeline.frontend.odometry.chunk_worker"

Job = dict[str, Any]
JobRunner = Callable[[list[Job]], Iterator[int]]  # runs the jobs; yields now and then how many of their frames are done


@dataclass(frozen=True)
class Stitching:
    """chunks: how many there were; closed: of the seams between them, those where both sides agreed."""

    chunks: int
    closed: int


def split(count: int, chunks: int) -> list[range]:
    """Rows of each chunk, evenly long; fewer chunks where they would be shorter than three overlaps."""
    chunks = max(1, min(chunks, count // (3 * OVERLAP)))
    ends = np.linspace(0, count - OVERLAP, chunks + 1).round().astype(int).tolist()
    return [range(begin, end + OVERLAP) for begin, end in pairwise(ends)] if chunks > 1 else [range(count)]


def jobs_of(
    index: NDArray[np.int64], camera: Camera, chunks: list[range], settings: FrontEndSettings, workspace: Workspace
) -> list[Job]:
    """What each chunk's process needs to know."""
    folder = temp_dir(workspace).resolve()
    about: Job = {"run": str(workspace.root.resolve()), "camera": camera.to_dict(), "stride": settings.stride}
    about |= {"seed": settings.seed, "keyframe_motion": settings.odometry.keyframe_motion}
    return [
        about | {"number": number, "frames": index[rows].tolist(), "output": str(folder / f"{number}.npz")}
        for number, rows in enumerate(chunks)
    ]


def temp_dir(workspace: Workspace) -> Path:
    """Where chunks leave their maps until the structure is finished."""
    return workspace.log / "chunks"


def track_chunks(
    jobs: list[Job], rays: RayTable, run: JobRunner, progress: Progress
) -> tuple[list[LocalMap], Stitching]:
    """Maps of all chunks in the order of their beginning, stitched where the frames that two have in common agree."""
    for job in jobs:
        Path(job["output"]).parent.mkdir(parents=True, exist_ok=True)
    found = [_done(job, rays) for job in jobs]
    waiting = [job for job, maps in zip(jobs, found, strict=True) if maps is None]
    frames = sum(len(job["frames"]) for job in jobs)
    done = frames - sum(len(job["frames"]) for job in waiting)
    with progress.bar(f"odometry, {len(jobs)} chunks", frames) as advance:
        advance(done)
        if waiting:
            running = run(waiting)
            try:
                for count in running:
                    advance(done + count)
            finally:
                running.close()  # type: ignore[attr-defined] # they are generators
    found = [_done(job, rays) if maps is None else maps for job, maps in zip(jobs, found, strict=True)]
    lost = [str(job["number"]) for job, maps in zip(jobs, found, strict=True) if maps is None]
    if lost:
        raise HaustraError(f"chunks {', '.join(lost)} left no maps; --resume goes on with them")
    return stitch_chunks([maps for maps in found if maps is not None])


def stitch_chunks(chunks: list[list[LocalMap]]) -> tuple[list[LocalMap], Stitching]:
    """At each seam the two maps that share most frames become one, if they agree. Maps that pose nothing that others do
    not are left out."""
    result: list[LocalMap] = []
    before: list[LocalMap] = []  # maps of the last chunk, as they are by now
    closed = 0
    for maps in chunks:
        here = list(maps)
        for one, other in _sharing(before, here):
            similarity = first_from_second(one, other)
            if similarity is not None:
                whole = stitch(one, other, similarity)
                result[_place(result, one)] = here[_place(here, other)] = whole
                closed += 1
                break
        result += [local_map for local_map in here if not any(local_map is kept for kept in result)]
        before = here
    return without_stubs(result), Stitching(len(chunks), closed)


def _sharing(first: list[LocalMap], second: list[LocalMap]) -> list[tuple[LocalMap, LocalMap]]:
    """Pairs of maps that posed the same frames, most of them first."""
    posed = [[local_map.frames for local_map in maps] for maps in (first, second)]
    common = [(-len(a & b), i, j) for i, a in enumerate(posed[0]) for j, b in enumerate(posed[1]) if a & b]
    return [(first[i], second[j]) for _, i, j in sorted(common)]


def _place(maps: list[LocalMap], wanted: LocalMap) -> int:
    return next(number for number, local_map in enumerate(maps) if local_map is wanted)


def _done(job: Job, rays: RayTable) -> list[LocalMap] | None:
    """The maps of a chunk that was tracked before, with the same frames and settings; None if there are none."""
    output = Path(job["output"])
    try:
        if json.loads(output.with_suffix(".json").read_text()) != job:
            return None
        return load_maps(output, rays)
    except (OSError, EOFError, KeyError, ValueError, zipfile.BadZipFile, zlib.error):
        return None


def local_run(workers: int) -> JobRunner:
    """So many chunks at a time on this machine."""

    def run(jobs: list[Job]) -> Iterator[int]:
        processes, failures = ChildProcesses(), list[str]()
        threads = ThreadPoolExecutor(max(1, workers))
        for job in jobs:
            _log_of(job).unlink(missing_ok=True)
        waiting = {threads.submit(_track_apart, job, processes) for job in jobs}
        try:
            while waiting:
                done, waiting = wait(waiting, POLL_S)
                failures += [failure for future in done if (failure := future.result()) is not None]
                yield sum(_reached(job) for job in jobs)
        finally:  # nothing runs any more, but after an interrupt
            processes.stop()
            threads.shutdown(cancel_futures=True)
        _raise(failures)

    return run


def _raise(failures: list[str]) -> None:
    """After all chunks have ended: what the others did is kept."""
    if failures:
        raise HaustraError("; ".join(sorted(failures)))


def _track_apart(job: Job, processes: ChildProcesses) -> str | None:
    """In a process of its own; what went wrong, if anything did."""
    task, log = Path(job["output"]).with_suffix(".job.json"), _log_of(job)
    write_json(task, job)
    with log.open("w") as file:
        code = processes.run(parent_bound_command(WORKER, "track", str(task)), file.fileno())
    return f"chunk {job['number']} failed (exit code {code}); its log is {log}" if code != 0 else None


def _log_of(job: Job) -> Path:
    return Path(job["output"]).with_suffix(".log")


def _reached(job: Job) -> int:
    """How many frames its process said were done."""
    log = _log_of(job)
    words = log.read_text(errors="replace").split() if log.exists() else []
    return int(words[-2]) if len(words) > 1 and words[-2].isdigit() else 0


def ray_run(address: str) -> JobRunner:
    """One task a chunk on the Ray cluster at `address`, whose nodes see the run folder."""
    ray_cluster.import_ray()

    def run(jobs: list[Job]) -> Iterator[int]:
        from pipeline.frontend.odometry.chunk_worker import track

        with ray_cluster.connected(address, processors()) as ray:
            task = ray.remote(num_cpus=1, max_retries=0)(track)
            job_of = {task.remote(job): job for job in jobs}
            waiting, done, failures = list(job_of), 0, list[str]()
            try:
                while waiting:
                    ready, waiting = ray.wait(waiting)
                    for reference in ready:
                        try:
                            done += ray.get(reference)
                        except ray.exceptions.RayError as error:
                            reason = str(error).strip().splitlines()[-1]  # before it stands where in the cluster
                            failures.append(f"chunk {job_of[reference]['number']} failed: {reason}")
                    yield done
            finally:
                ray_cluster.stop(ray, waiting)
        _raise(failures)

    return run
