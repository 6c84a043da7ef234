"""Frames from a reading thread to the tracker, through a buffer that cannot grow: what is late is skipped, counted."""

import threading
import time
from collections import deque
from concurrent.futures import Future, ThreadPoolExecutor, wait
from dataclasses import dataclass

from haustra.core.errors import HaustraError
from pipeline.input.video import RawFrame
from pipeline.live.capture.live_film import LiveFilm

LET_GO_S = 15.0  # for a source to end that is asked to; longer than a stream is waited for
BUFFERED = 12  # frames: 0.4 s at 30 a second, as long as the adjustment of a new keyframe may take


@dataclass(frozen=True)
class FedFrame:
    """A frame and when it came, by `time.monotonic()`."""

    raw: RawFrame
    came: float


class FrameFeed:
    """Reads a film in a thread of its own. Use it by `with`; reading ends with it.

    came: frames that the source gave. skipped: of them those that nobody took in time. fault: the sentence with which
    the source was lost, or "".
    """

    def __init__(self, film: LiveFilm, buffered: int = BUFFERED) -> None:
        self.film, self.came, self.skipped, self.fault = film, 0, 0, ""
        self._buffer: deque[FedFrame] = deque()
        self._most = buffered
        self._stopped, self._ended = threading.Event(), False
        self._changed = threading.Condition()
        self._thread = ThreadPoolExecutor(1, "reading")
        self._reading: Future[None] | None = None

    def take(self, timeout: float) -> FedFrame | None:
        """The oldest frame in the buffer; None if none came in time or the film is over."""
        with self._changed:
            self._changed.wait_for(lambda: self._buffer or self._ended, timeout)
            if self._buffer:
                return self._buffer.popleft()
        if self._ended and self._reading is not None:
            self._reading.result()  # raises what the thread did not expect
        return None

    @property
    def ended(self) -> bool:
        """Whether the source gave its last frame and that was taken."""
        with self._changed:
            return self._ended and not self._buffer

    def stop(self) -> None:
        """Read no more; what is in the buffer can still be taken."""
        self._stopped.set()

    def __enter__(self) -> "FrameFeed":
        self._reading = self._thread.submit(self._read)
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        """HaustraError for a source that does not let go: its recording may still be written."""
        self._stopped.set()
        self._thread.shutdown(wait=False)
        assert self._reading is not None
        wait([self._reading], LET_GO_S)
        if not self._reading.done():
            raise HaustraError(
                f"the source {self.film.name} does not end; what was recorded is kept: finish by --resume"
            )
        self.skipped += len(self._buffer)
        self._buffer.clear()
        if kind is None:
            self._reading.result()  # raises what the thread did not expect

    def _read(self) -> None:
        try:
            for raw in self.film.frames(self._stopped):
                with self._changed:
                    self.came += 1
                    if len(self._buffer) >= self._most:
                        self._buffer.popleft()
                        self.skipped += 1
                    self._buffer.append(FedFrame(raw, time.monotonic()))
                    self._changed.notify()
                if self._stopped.is_set():
                    break
        except HaustraError as error:
            self.fault = str(error)
        finally:
            with self._changed:
                self._ended = True
                self._changed.notify()
