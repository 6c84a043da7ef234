"""Ctrl-C deferred to the end of a training step, so that the checkpoint is of a whole step."""

from __future__ import annotations

import signal
import threading
from types import FrameType


class GracefulInterrupt:
    """Context in which the first Ctrl-C sets `requested`; the second raises KeyboardInterrupt.

    enabled: False leaves Ctrl-C as it is, for distributed steps in the middle of which other processes wait.
    """

    def __init__(self, enabled: bool = True) -> None:
        self.requested = False
        # Only the main thread may say what a signal does.
        self._enabled = enabled and threading.current_thread() is threading.main_thread()

    def __enter__(self) -> GracefulInterrupt:
        if self._enabled:
            self._before = signal.signal(signal.SIGINT, self._note)
        return self

    def __exit__(self, *_: object) -> None:
        if self._enabled:
            signal.signal(signal.SIGINT, self._before)

    def _note(self, number: int, frame: FrameType | None) -> None:
        if self.requested:
            raise KeyboardInterrupt
        self.requested = True
