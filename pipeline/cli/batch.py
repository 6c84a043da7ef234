"""Many videos, each in a process of its own: one that fails never stops the rest, and a second call goes on.

The process isolation is the point: a crash in a decoder or a mapper, or the kernel's out-of-memory killer, ends one
video's reconstruction and is one row of the table.
"""

import hashlib
import os
import signal
import threading
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor, as_completed
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from types import FrameType
from typing import Any

import yaml

from haustra.core.errors import HaustraError
from haustra.core.progress import Progress
from pipeline.cli.batch_table import KEPT, Outcome, finished_outcome, write_table
from pipeline.config import Config
from pipeline.run_folder.resuming import is_same_run
from pipeline.run_folder.subprocesses import ChildProcesses, parent_bound_command
from pipeline.run_folder.workspace import Workspace, open_workspace

MODULE = "pipeline"  # that reconstructs one video
DIGITS = 6  # of a path's digest in the name of a folder
LONGEST = 200  # bytes of a folder's name; file systems take 255, and its log and digest need some
LOG_SUFFIX = ".log"
TABLES = ("batch.csv", "batch.json")
STOP_SIGNALS = ("SIGTERM", "SIGHUP")  # as Ctrl-C; Windows knows only the first


@dataclass(frozen=True)
class Job:
    """One video and its run folder; `overwrite`: the run in it, if any, is not one to go on with."""

    video: Path
    folder: Path
    overwrite: bool = False

    @property
    def log(self) -> Path:
        return self.folder.with_name(self.folder.name + LOG_SUFFIX)


Pool = Callable[[list[Job], list[str]], Iterator[Outcome]]  # outcomes in the order in which they come


def run_batch(
    videos: list[Path],
    output: Path,
    arguments: list[str],
    config: Config,
    pool: Pool,
    progress: Progress,
    overwrite: bool = False,
) -> list[Outcome]:
    """Reconstruct every video into `output`; `arguments` are the options of `reconstruct`, which give `config`.

    `batch.csv` and `batch.json` are whole after each video. Finished runs of the same video with the same settings are
    kept as they are, others of them are gone on with, and with `overwrite` what is neither is replaced. Ctrl-C, SIGTERM
    and SIGHUP stop the reconstructions under way, keep what they did, and go on as an interrupt.
    """
    if output.exists() and not output.is_dir():
        raise HaustraError(f"the output {output} is a file; give a folder")
    output.mkdir(parents=True, exist_ok=True)
    jobs = plan_jobs(videos, output)
    outcomes = {job.folder: outcome for job in jobs if (outcome := kept_outcome(job, config)) is not None}
    waiting = [job for job in jobs if job.folder not in outcomes]
    if overwrite:
        waiting = [replace(job, overwrite=holds_another(job, config)) for job in waiting]

    def rows() -> list[Outcome]:
        return [outcomes.get(job.folder) or unfinished_outcome(job) for job in jobs]

    write_table(rows(), output)
    with stop_signals_interrupt():
        running = pool(waiting, arguments)
        try:
            with progress.bar("videos", len(jobs)) as advance:
                advance(len(outcomes))
                for outcome in running:
                    outcomes[Path(outcome.folder)] = outcome
                    write_table(rows(), output)
                    progress.log(outcome.sentence)
                    advance(len(outcomes))
        finally:
            running.close()  # type: ignore[attr-defined] # pools are generators
            write_table(rows(), output)
    return rows()


@contextmanager
def stop_signals_interrupt() -> Iterator[None]:
    """What a system that shuts down or a terminal that closes sends is an interrupt as Ctrl-C is; `nohup` keeps its
    word."""
    before: dict[int, Any] = {}

    def interrupt(number: int, frame: FrameType | None) -> None:
        raise KeyboardInterrupt

    if threading.current_thread() is threading.main_thread():  # no other may set them
        for number in (getattr(signal, name) for name in STOP_SIGNALS if hasattr(signal, name)):
            if signal.getsignal(number) is signal.SIG_DFL:
                before[number] = signal.signal(number, interrupt)
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def plan_jobs(videos: list[Path], output: Path) -> list[Job]:
    """A folder for each video: its stem, or its stem and a digest of its path where the stem is another's already."""
    jobs: dict[Path, Job] = {}
    taken: set[str] = set()
    for video in (path.resolve() for path in videos):
        if video in jobs:
            continue
        digest = hashlib.sha256(os.fsencode(video)).hexdigest()[:DIGITS]
        stem = os.fsencode(video.stem)[:LONGEST].decode(errors="ignore")
        plain, distinct = output.resolve() / video.stem, output.resolve() / f"{stem}-{digest}"
        if stem != video.stem or _is_no_folder_name(stem) or stem.casefold() in taken or _source_of(distinct) == video:
            folder = distinct
        else:
            folder = plain if _source_of(plain) in (None, video) else distinct
        taken.add(folder.name.casefold())  # on some file systems A and a are one
        jobs[video] = Job(video, folder)
    return list(jobs.values())


def _is_no_folder_name(stem: str) -> bool:
    """What is, or may become, the name of another video's log or of a table."""
    return not stem or stem.casefold().endswith(LOG_SUFFIX) or stem.casefold() in TABLES


def _source_of(folder: Path) -> Path | None:
    """The video of a run folder; None where there is no run, or one too damaged to say."""
    try:
        return Path(yaml.safe_load(Workspace(folder).record_path.read_text())["source"]["path"])
    except Exception:  # noqa: BLE001 # whatever a file may hold
        return None


def unfinished_outcome(job: Job) -> Outcome:
    """Outcome of a video that waits, or that an interrupt stopped."""
    return Outcome(str(job.video), str(job.folder), "stopped" if has_run(job) else "not started")


def has_run(job: Job) -> bool:
    return os.path.exists(Workspace(job.folder).record_path)  # unlike Path.exists, this never raises


def is_same(job: Job, config: Config) -> bool:
    """Whether its folder holds a run, whole or not, of the same video as it is now, with the same settings."""
    try:
        return is_same_run(open_workspace(job.folder), job.video, config)
    except Exception:  # noqa: BLE001 # a damaged run; its reconstruction says how
        return False


def holds_another(job: Job, config: Config) -> bool:
    """Whether its folder holds a run, but none to go on with."""
    return has_run(job) and not is_same(job, config)


def resume_hint(videos: list[Path], output: Path, config: Config, failed: int) -> str:
    """What to do about so many failures: nothing tries a video again whose folder holds a run of something else."""
    others = sum(holds_another(job, config) for job in plan_jobs(videos, output))
    if not others:
        return "the same command tries them again"
    rest = "; the same command tries the others again" if failed > others else ""
    return (
        f"{others} because of a run of another video or with other settings in the folder, which --overwrite replaces"
        f"{rest}"
    )


def kept_outcome(job: Job, config: Config) -> Outcome | None:
    """Outcome of a run that is whole; None where this video has none with these settings, and so there is work."""
    if not is_same(job, config):
        return None
    workspace = open_workspace(job.folder)
    if not workspace.is_done("report") or not workspace.mesh.is_file():
        return None
    outcome = finished_outcome(job.video, job.folder)
    return outcome if outcome.status == KEPT else None


def run_job(job: Job, arguments: list[str], processes: ChildProcesses | None = None) -> Outcome:
    """Reconstruct one video in a process of its own; goes on where an earlier one stopped. Whatever fails is a row."""
    begin = time.monotonic()
    try:
        return _run_job(job, arguments, processes or ChildProcesses(), begin)
    except Exception as error:  # noqa: BLE001 # the other videos go on
        reason = f"{type(error).__name__}: {error}".splitlines()[0]
        return Outcome(str(job.video), str(job.folder), "failed", _minutes_since(begin), message=reason)


def _run_job(job: Job, arguments: list[str], processes: ChildProcesses, begin: float) -> Outcome:
    how = ["--overwrite"] if job.overwrite else ["--resume"] if has_run(job) else []
    with job.log.open("w") as log:
        code = processes.run(
            parent_bound_command(MODULE, str(job.video), "-o", str(job.folder), "-q", *how, *arguments), log.fileno()
        )
    minutes = _minutes_since(begin)
    if code == 0:
        return finished_outcome(job.video, job.folder, "done", minutes)
    status = "stopped" if processes.stopping else "failed"
    return Outcome(str(job.video), str(job.folder), status, minutes, message=_failure_reason(code, job.log))


def _minutes_since(begin: float) -> float:
    return round((time.monotonic() - begin) / 60, 2)


def _failure_reason(code: int, log: Path) -> str:
    """One sentence on a failure: the reconstruction's own, or how its process ended."""
    lines = [line.strip() for line in log.read_text(errors="replace").splitlines() if line.strip()]
    errors = [line.removeprefix("error: ") for line in lines if line.startswith("error: ")]
    if errors:
        return errors[-1]
    if code < 0:
        hint = "; out of memory?" if -code == signal.SIGKILL else ""
        return f"its process was ended by {signal.Signals(-code).name}{hint}"
    return lines[-1] if lines else f"exit code {code}, and not a word in {log.name}"


def process_pool(workers: int) -> Pool:
    """So many reconstructions at a time on this machine."""

    def pool(jobs: list[Job], arguments: list[str]) -> Iterator[Outcome]:
        processes = ChildProcesses()
        with ThreadPoolExecutor(workers) as threads:
            futures = [threads.submit(run_job, job, arguments, processes) for job in jobs]
            try:
                for future in as_completed(futures):
                    yield future.result()
            finally:
                for future in futures:
                    future.cancel()
                processes.stop()

    return pool
