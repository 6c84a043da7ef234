"""Run a module in a process of its own, with progress, a log file, and a clean stop."""

import ctypes
import json
import os
import runpy
import signal
import subprocess
import sys
import threading
import time
from contextlib import suppress
from pathlib import Path
from typing import Any

from haustra.core.errors import HaustraError
from haustra.core.progress import Progress

PATIENCE_S = 20.0  # for a stopped process to end by itself
SIGNAL_AT_PARENTS_DEATH = 1  # Linux, prctl(2): PR_SET_PDEATHSIG


def run_isolated(
    module: str,
    action: str,
    job: dict[str, Any],
    log: Path,
    label: str,
    progress: Progress,
    deadline: float | None = None,
) -> None:
    """`python -m module action job.json`; raises `HaustraError` naming the log if it fails.

    deadline: time by `time.monotonic()` at which it is killed, which is a `HaustraError` of its own.

    The child writes "done total" lines to standard output. On Ctrl-C it is killed before the interrupt goes on; on
    Linux it also dies with a parent that is killed, so that nobody else writes where a resumed run goes on.
    """
    job_file = log.with_suffix(".job.json")
    job_file.write_text(json.dumps(job, indent=1))
    with log.open("w") as errors, progress.bar(label, None) as advance:
        child = subprocess.Popen(
            parent_bound_command(module, action, str(job_file)),
            stdout=subprocess.PIPE,
            stderr=errors,
            text=True,
            env=parent_bound_environment(),
            start_new_session=True,
        )
        late = threading.Event()
        alarm = _alarm(child, late, deadline)
        try:
            assert child.stdout is not None
            for line in child.stdout:
                words = line.split()
                if len(words) == 2 and all(word.isdigit() for word in words):
                    advance(int(words[0]), int(words[1]))
            code = child.wait()
        except BaseException:
            child.kill()
            child.wait()
            raise
        finally:
            alarm.cancel()
    if late.is_set():
        raise HaustraError(f"{label} was stopped: the time that it was given is over")
    if code != 0:
        raise HaustraError(f"{label} failed (exit code {code}); its log is {log}")


def _alarm(child: subprocess.Popen[str], late: threading.Event, deadline: float | None) -> threading.Timer:
    """A timer that kills the child at the deadline and says so; without a deadline one that never runs."""

    def ring() -> None:
        late.set()
        child.kill()

    timer = threading.Timer(0.0 if deadline is None else max(0.0, deadline - time.monotonic()), ring)
    timer.daemon = True
    if deadline is not None:
        timer.start()
    return timer


def parent_bound_command(module: str, *words: str) -> list[str]:
    """`python -m module words`; started with `parent_bound_environment`, it dies on Linux with the thread that starts
    it."""
    # -P: the working directory must not shadow installed packages.
    return [sys.executable, "-P", "-m", __name__, module, *words]


def parent_bound_environment() -> dict[str, str]:
    """Environment of a child of this process."""
    return os.environ | {"HAUSTRA_PARENT": str(os.getpid())}


class ChildProcesses:
    """The processes that run now, so that all of them can be stopped."""

    def __init__(self) -> None:
        self.stopping = False
        self._lock, self._alive = threading.Lock(), set[subprocess.Popen[bytes]]()

    def run(self, command: list[str], log: int) -> int:
        """Start, wait, exit code. In a session of its own, so that Ctrl-C reaches it through `stop` alone; a
        `parent_bound_command` also dies with this process."""
        with self._lock:
            if self.stopping:
                return -signal.SIGINT
            child = subprocess.Popen(
                command,
                stdin=subprocess.DEVNULL,
                stdout=log,
                stderr=log,
                env=parent_bound_environment(),
                start_new_session=True,
            )
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
        """As Ctrl-C would: they then end their own workers and keep what is done."""
        with self._lock:
            self.stopping, alive = True, list(self._alive)
        for child in alive:
            child.send_signal(signal.SIGINT)
        end = time.monotonic() + PATIENCE_S
        try:
            for child in alive:
                with suppress(subprocess.TimeoutExpired):
                    child.wait(max(0.1, end - time.monotonic()))
        finally:  # at once if the user loses patience
            for child in alive:
                child.kill()


def _main() -> None:
    """The child's side: tie its life to the parent's, then be the module that it was started for."""
    # A shell that starts a batch in the background has it ignore Ctrl-C; here it comes from the parent alone.
    signal.signal(signal.SIGINT, signal.default_int_handler)
    parent = int(os.environ.get("HAUSTRA_PARENT", os.getppid()))
    if sys.platform == "linux":
        ctypes.CDLL(None).prctl(SIGNAL_AT_PARENTS_DEATH, signal.SIGKILL)
        if os.getppid() != parent:  # it died before it could be tied to
            sys.exit(1)
    module = sys.argv[1]
    sys.argv = sys.argv[1:]
    runpy.run_module(module, run_name="__main__", alter_sys=True)


if __name__ == "__main__":
    _main()
