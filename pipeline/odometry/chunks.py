"""A long film tracked in overlapping chunks, each in a process of its own or as a task of a Ray cluster.

A chunk's maps are kept on disk, so that a run that was stopped goes on with the chunks that are left. Chunks share
`OVERLAP` frames; what both sides posed there puts their maps together again.
"""

import json
import os
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

from pipeline import ray_cluster
from pipeline.camera import Camera
from pipeline.errors import HaustraError
from pipeline.isolation import Children, tied_command
from pipeline.odometry.local_map import LocalMap
from pipeline.odometry.map_file import load_maps
from pipeline.odometry.rays import RayTable
from pipeline.odometry.seam import first_from_second, sewn
from pipeline.progress import Progress
from pipeline.workspace import Workspace, write_json

OVERLAP = 60  # frames worth tracking: a start takes some twenty of them, and ten must be posed by both sides
POLL_S = 0.5
WORKER = "pipeline.odometry.chunk_worker"

Job = dict[str, Any]
Run = Callable[[list[Job]], Iterator[int]]  # runs the jobs; yields now and then how many of their frames are done


@dataclass(frozen=True)
class Seams:
    """chunks: how many there were; closed: of the seams between them, those where both sides agreed."""

    chunks: int
    closed: int


def cut(count: int, chunks: int) -> list[range]:
    """Rows of each chunk, evenly long; fewer chunks where they would be shorter than three overlaps."""
    chunks = max(1, min(chunks, count // (3 * OVERLAP)))
    ends = np.linspace(0, count - OVERLAP, chunks + 1).round().astype(int).tolist()
    return [range(begin, end + OVERLAP) for begin, end in pairwise(ends)] if chunks > 1 else [range(count)]


def jobs_of(
    index: NDArray[np.int64], camera: Camera, chunks: list[range], stride: int, seed: int, workspace: Workspace
) -> list[Job]:
    """What each chunk's process needs to know."""
    folder = scratch(workspace).resolve()
    about = {"run": str(workspace.root.resolve()), "camera": camera.to_dict(), "stride": stride, "seed": seed}
    return [
        about | {"number": number, "frames": index[rows].tolist(), "output": str(folder / f"{number}.npz")}
        for number, rows in enumerate(chunks)
    ]


def scratch(workspace: Workspace) -> Path:
    """Where chunks leave their maps until the structure is finished."""
    return workspace.log / "chunks"


def track_chunks(jobs: list[Job], rays: RayTable, run: Run, progress: Progress) -> tuple[list[LocalMap], Seams]:
    """Maps of all chunks in the order of their beginning, sewn where the frames that two have in common agree."""
    for job in jobs:
        Path(job["output"]).parent.mkdir(parents=True, exist_ok=True)
    waiting = [job for job in jobs if _done(job, rays) is None]
    frames = sum(len(job["frames"]) for job in jobs)
    done = frames - sum(len(job["frames"]) for job in waiting)
    with progress.bar(f"odometry, {len(jobs)} chunks", frames) as advance:
        advance(done)
        running = run(waiting)
        try:
            for count in running:
                advance(done + count)
        finally:
            running.close()  # type: ignore[attr-defined] # they are generators
    found = [_done(job, rays) for job in jobs]
    lost = [str(job["number"]) for job, maps in zip(jobs, found, strict=True) if maps is None]
    if lost:
        raise HaustraError(f"chunks {', '.join(lost)} left no maps; --resume goes on with them")
    return sew([maps for maps in found if maps is not None])


def sew(chunks: list[list[LocalMap]]) -> tuple[list[LocalMap], Seams]:
    """The last map of each chunk and the first of the next become one where they agree."""
    result: list[LocalMap] = []
    closed = 0
    for maps in chunks:
        ahead = list(maps)
        similarity = first_from_second(result[-1], ahead[0]) if result and ahead else None
        if similarity is not None:
            result[-1] = sewn(result[-1], ahead.pop(0), similarity)
            closed += 1
        result += ahead
    return result, Seams(len(chunks), closed)


def _done(job: Job, rays: RayTable) -> list[LocalMap] | None:
    """The maps of a chunk that was tracked before, with the same frames and settings; None if there are none."""
    output = Path(job["output"])
    try:
        if json.loads(output.with_suffix(".json").read_text()) != job:
            return None
        return load_maps(output, rays)
    except (OSError, EOFError, KeyError, ValueError, zipfile.BadZipFile, zlib.error):
        return None


def local_run(workers: int) -> Run:
    """So many chunks at a time on this machine."""

    def run(jobs: list[Job]) -> Iterator[int]:
        children = Children()
        threads = ThreadPoolExecutor(max(1, workers))
        waiting = {threads.submit(_track_apart, job, children) for job in jobs}
        try:
            while waiting:
                done, waiting = wait(waiting, POLL_S)
                for future in done:
                    future.result()
                yield sum(_reached(job) for job in jobs)
        finally:
            children.stop()
            threads.shutdown(cancel_futures=True)

    return run


def _track_apart(job: Job, children: Children) -> None:
    """In a process of its own; raises `HaustraError` naming the log if it fails."""
    output = Path(job["output"])
    task, log = output.with_suffix(".job.json"), output.with_suffix(".log")
    write_json(task, job)
    with log.open("w") as file:
        code = children.run(tied_command(WORKER, "track", str(task)), file.fileno())
    if code != 0 and not children.stopping:
        raise HaustraError(f"chunk {job['number']} failed (exit code {code}); its log is {log}")


def _reached(job: Job) -> int:
    """How many frames its process said were done."""
    log = Path(job["output"]).with_suffix(".log")
    words = log.read_text(errors="replace").split() if log.exists() else []
    return int(words[-2]) if len(words) > 1 and words[-2].isdigit() else 0


def ray_run(address: str) -> Run:
    """One task a chunk on the Ray cluster at `address`, whose nodes see the run folder."""
    ray_cluster.import_ray()

    def run(jobs: list[Job]) -> Iterator[int]:
        from pipeline.odometry.chunk_worker import track

        with ray_cluster.connected(address, processors()) as ray:
            task = ray.remote(num_cpus=1, max_retries=0)(track)
            waiting, done = [task.remote(job) for job in jobs], 0
            try:
                while waiting:
                    ready, waiting = ray.wait(waiting)
                    try:
                        done += sum(ray.get(ready))
                    except ray.exceptions.RayError as error:
                        raise HaustraError(f"a chunk's Ray task failed: {str(error).splitlines()[0]}") from error
                    yield done
            finally:
                ray_cluster.stop(ray, waiting)

    return run


def processors() -> int:
    """Those that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
