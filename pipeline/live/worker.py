"""A process of our own that does one job after the other, with at most a few waiting."""

import contextlib
import multiprocessing
import os
import signal
import threading
from collections import deque
from collections.abc import Callable, Iterator
from multiprocessing.connection import Connection
from typing import Generic, TypeVar

from haustra.core.errors import HaustraError

Job = TypeVar("Job")
Result = TypeVar("Result")
Setup = TypeVar("Setup")
Work = Callable[[Job], Result]

END_S = 5.0  # for a process to end by itself


class Worker(Generic[Setup, Job, Result]):
    """Runs `make(setup)(job)` in another process for each job, in order; results come back in order.

    most_waiting: jobs that may wait; a further one takes the place of the oldest, and `dropped` counts that. niceness:
    of the process, so that what is shown at once comes first. Everything that is sent is ours and picklable.
    """

    def __init__(
        self,
        name: str,
        make: Callable[[Setup], Work[Job, Result]],
        setup: Setup,
        most_waiting: int = 1,
        niceness: int = 0,
    ) -> None:
        self.name, self.dropped, self.failure = name, 0, ""
        self._most, self._working = most_waiting, False
        self._first: deque[Job] = deque()
        self._waiting: deque[Job] = deque()
        self._results: deque[Result] = deque()
        self._lock = threading.Condition()
        context = multiprocessing.get_context("spawn")
        self._connection, theirs = context.Pipe()
        self._process = context.Process(target=_serve, args=(theirs, make, setup, niceness), name=name, daemon=True)
        self._process.start()
        theirs.close()
        self._closing, self._ready = False, False
        self._thread = threading.Thread(target=self._exchange, name=name, daemon=True)
        self._thread.start()

    @property
    def waiting(self) -> int:
        """Jobs that are not done, the one in work too."""
        with self._lock:
            return len(self._first) + len(self._waiting) + self._working

    @property
    def is_full(self) -> bool:
        """Whether a further job would take the place of one that waits."""
        with self._lock:
            return len(self._waiting) >= self._most

    @property
    def free(self) -> bool:
        """Whether a job would be begun at once."""
        return self.waiting == 0 and not self.failure

    def begin(self, job: Job) -> None:
        """The first job, which is never dropped."""
        with self._lock:
            self._first.append(job)
            self._lock.notify()

    def submit(self, job: Job) -> None:
        """Do this next; never waits."""
        with self._lock:
            if len(self._waiting) >= self._most:
                self._waiting.popleft()
                self.dropped += 1
            self._waiting.append(job)
            self._lock.notify()

    def results(self) -> Iterator[Result]:
        """Those that are there, oldest first."""
        while True:
            with self._lock:
                if not self._results:
                    return
                found = self._results.popleft()
            yield found

    def wait_until_ready(self, timeout: float) -> None:
        """Wait until the first job can begin, or the seconds are over. HaustraError where the process cannot work."""
        with self._lock:
            self._lock.wait_for(lambda: self._ready or self.failure, timeout)
            if self.failure:
                raise HaustraError(self.failure)

    def wait_until_idle(self, timeout: float) -> bool:
        """Wait until all jobs are done; False where that takes longer, or the process failed."""
        with self._lock:
            done = self._lock.wait_for(
                lambda: self.failure or not (self._first or self._waiting or self._working), timeout
            )
            return bool(done) and not self.failure

    def close(self) -> None:
        """End the process; what waits is forgotten."""
        with self._lock:
            self._closing = True
            self._waiting.clear()
            self._lock.notify()
        self._process.join(0.0 if self.failure else END_S)
        if self._process.is_alive():
            self._process.terminate()
            self._process.join(END_S)
        self._connection.close()

    def __enter__(self) -> "Worker[Setup, Job, Result]":
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _exchange(self) -> None:
        """Hand one job at a time to the process and take its result."""
        try:
            self._expect()  # that it is ready, or why not
            with self._lock:
                self._ready = True
                self._lock.notify_all()
            while True:
                with self._lock:
                    self._lock.wait_for(lambda: self._first or self._waiting or self._closing)
                    if self._closing:
                        self._connection.send(None)
                        return
                    job, self._working = (self._first or self._waiting).popleft(), True
                self._connection.send(job)
                result = self._expect()
                with self._lock:
                    self._results.append(result)
                    self._working = False
                    self._lock.notify_all()
        except (EOFError, OSError) as error:
            self._fail(f"the process of {self.name} ended unexpectedly ({type(error).__name__})")
        except HaustraError as error:
            self._fail(str(error))

    def _expect(self) -> Result:
        kind, value = self._connection.recv()
        if kind == "failed":
            raise HaustraError(value)
        return value

    def _fail(self, sentence: str) -> None:
        with self._lock:
            if not self._closing:
                self.failure = sentence
            self._working = False
            self._lock.notify_all()


def _serve(connection: Connection, make: Callable[[Setup], Work[Job, Result]], setup: Setup, niceness: int) -> None:
    """The other side. Ctrl-C is the parent's; a parent that dies closes the pipe, which ends this too."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    if niceness and hasattr(os, "nice"):
        os.nice(niceness)
    with contextlib.suppress(EOFError, OSError):
        try:
            work = make(setup)
            connection.send(("ready", None))
            while (job := connection.recv()) is not None:
                connection.send(("done", work(job)))
        except HaustraError as error:
            connection.send(("failed", str(error)))
        except (EOFError, OSError):
            raise
        except Exception as error:
            connection.send(("failed", f"{type(error).__name__}: {error}"))
            raise
