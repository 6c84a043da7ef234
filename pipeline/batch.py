"""Many videos, each in a process of its own: one that fails never stops the rest, and a second call goes on.

The process isolation is the point: a crash in a decoder or a mapper, or the kernel's out-of-memory killer, ends one
video's reconstruction and is one row of the table.
"""

import hashlib
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor, as_completed
from dataclasses import dataclass
from pathlib import Path

import yaml

from pipeline.batch_table import Outcome, finished_outcome, write_table
from pipeline.config import Config
from pipeline.errors import HaustraError
from pipeline.progress import Progress
from pipeline.workspace import Workspace, open_workspace

PATIENCE_S = 20.0  # for a stopped reconstruction to end by itself
DIGITS = 6  # of a path's digest in the name of a folder


@dataclass(frozen=True)
class Job:
    """One video and its run folder."""

    video: Path
    folder: Path

    @property
    def log(self) -> Path:
        return self.folder.with_name(f"{self.folder.name}.log")


Pool = Callable[[list[Job], list[str]], Iterator[Outcome]]  # outcomes in the order in which they come


def run_batch(
    videos: list[Path], output: Path, words: list[str], config: Config, pool: Pool, progress: Progress
) -> list[Outcome]:
    """Reconstruct every video into `output`; `words` are the options of `reconstruct`, which give `config`.

    `batch.csv` and `batch.json` are whole after each video. Finished runs with the same settings are kept as they
    are. Ctrl-C stops the reconstructions under way, keeps what they did, and goes on as an interrupt.
    """
    if output.exists() and not output.is_dir():
        raise HaustraError(f"the output {output} is a file; give a folder")
    output.mkdir(parents=True, exist_ok=True)
    jobs = plan_jobs(videos, output)
    outcomes = {job: finished_outcome(job.video, job.folder) for job in jobs if is_finished(job.folder, config)}
    waiting = [job for job in jobs if job not in outcomes]
    job_of = {job.folder: job for job in jobs}

    def rows() -> list[Outcome]:
        return [outcomes.get(job) or unfinished_outcome(job) for job in jobs]

    write_table(rows(), output)
    running = pool(waiting, words)
    try:
        with progress.bar("videos", len(jobs)) as advance:
            advance(len(outcomes))
            for outcome in running:
                outcomes[job_of[Path(outcome.folder)]] = outcome
                write_table(rows(), output)
                progress.say(outcome.sentence)
                advance(len(outcomes))
    except KeyboardInterrupt:
        running.close()  # type: ignore[attr-defined] # pools are generators
        write_table(rows(), output)
        raise
    return rows()


def plan_jobs(videos: list[Path], output: Path) -> list[Job]:
    """A folder for each video: its stem, or its stem and a digest of its path where another video has that already."""
    jobs: dict[Path, Job] = {}
    taken: set[Path] = set()
    for video in (path.resolve() for path in videos):
        if video in jobs:
            continue
        digest = hashlib.sha256(str(video).encode()).hexdigest()[:DIGITS]
        plain, distinct = output.resolve() / video.stem, output.resolve() / f"{video.stem}-{digest}"
        folder = distinct if plain in taken or _source_of(distinct) == video else plain
        if _source_of(folder) not in (None, video):
            folder = distinct
        taken.add(folder)
        jobs[video] = Job(video, folder)
    return list(jobs.values())


def _source_of(folder: Path) -> Path | None:
    """The video of a run folder; None where there is no run, or one too damaged to say."""
    try:
        return Path(yaml.safe_load(Workspace(folder).record_path.read_text())["source"]["path"])
    except (OSError, yaml.YAMLError, UnicodeDecodeError, KeyError, TypeError):
        return None


def unfinished_outcome(job: Job) -> Outcome:
    """Of a video that waits, or that an interrupt stopped."""
    begun = Workspace(job.folder).record_path.exists()
    return Outcome(str(job.video), str(job.folder), "stopped" if begun else "not started")


def is_finished(folder: Path, config: Config) -> bool:
    """Whether a run is whole and was made with these settings; one with others is run again, and says so itself."""
    try:
        workspace = open_workspace(folder)
        return workspace.is_done("report") and workspace.config == config and workspace.metrics.exists()
    except HaustraError:
        return False


def run_job(job: Job, words: list[str], children: "Children | None" = None) -> Outcome:
    """Reconstruct one video in a process of its own; goes on where an earlier one stopped."""
    children = children or Children()
    resume = ["--resume"] if Workspace(job.folder).record_path.exists() else []
    # -P: the working directory must not shadow installed packages.
    command = [sys.executable, "-P", "-m", "pipeline", str(job.video), "-o", str(job.folder), "-q", *resume, *words]
    begin = time.monotonic()
    with job.log.open("w") as log:
        code = children.run(command, log.fileno())
    minutes = (time.monotonic() - begin) / 60
    if code == 0:
        return finished_outcome(job.video, job.folder, "done", minutes)
    status = "stopped" if children.stopping else "failed"
    return Outcome(str(job.video), str(job.folder), status, minutes, message=_last_words(code, job.log))


def _last_words(code: int, log: Path) -> str:
    """One sentence on a failure: the reconstruction's own, or how its process ended."""
    lines = [line.strip() for line in log.read_text(errors="replace").splitlines() if line.strip()]
    told = [line.removeprefix("error: ") for line in lines if line.startswith("error: ")]
    if told:
        return told[-1]
    if code < 0:
        hint = "; out of memory?" if -code == signal.SIGKILL else ""
        return f"its process was ended by {signal.Signals(-code).name}{hint}"
    return lines[-1] if lines else f"exit code {code}, and not a word in {log.name}"


class Children:
    """The processes that run now, so that all of them can be stopped."""

    def __init__(self) -> None:
        self.stopping = False
        self._lock, self._alive = threading.Lock(), set[subprocess.Popen[bytes]]()

    def run(self, command: list[str], log: int) -> int:
        """Start, wait, exit code. In a session of its own, so that Ctrl-C reaches it through `stop` alone."""
        with self._lock:
            if self.stopping:
                return -signal.SIGINT
            child = subprocess.Popen(command, stdin=subprocess.DEVNULL, stdout=log, stderr=log, start_new_session=True)
            self._alive.add(child)
        try:
            return child.wait()
        except BaseException:  # Ctrl-C where the wait is in the main thread
            self.stop()
            raise
        finally:
            with self._lock:
                self._alive.discard(child)

    def stop(self) -> None:
        """As Ctrl-C would: a reconstruction then ends its own workers and keeps what is done."""
        with self._lock:
            self.stopping, alive = True, list(self._alive)
        for child in alive:
            child.send_signal(signal.SIGINT)
        end = time.monotonic() + PATIENCE_S
        for child in alive:
            try:
                child.wait(max(0.1, end - time.monotonic()))
            except subprocess.TimeoutExpired:
                child.kill()


def process_pool(workers: int) -> Pool:
    """So many reconstructions at a time on this machine."""

    def pool(jobs: list[Job], words: list[str]) -> Iterator[Outcome]:
        children = Children()
        with ThreadPoolExecutor(workers) as threads:
            futures = [threads.submit(run_job, job, words, children) for job in jobs]
            try:
                for future in as_completed(futures):
                    yield future.result()
            finally:
                for future in futures:
                    future.cancel()
                children.stop()

    return pool
