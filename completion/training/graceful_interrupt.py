"""Ctrl-C heard between two steps, so that what is saved is a whole one."""

from __future__ import annotations

import signal
import threading
from types import FrameType


class GracefulInterrupt:
    """While entered, the first Ctrl-C is only noted in `asked`; the second stops at once, as it always does.

    `heeded`: False where another process waits for this one in the middle of a step; Ctrl-C is then as it is elsewhere.
    """

    def __init__(self, heeded: bool = True) -> None:
        self.asked = False
        # Only the main thread may say what a signal does.
        self._heeded = heeded and threading.current_thread() is threading.main_thread()

    def __enter__(self) -> GracefulInterrupt:
        if self._heeded:
            self._before = signal.signal(signal.SIGINT, self._note)
        return self

    def __exit__(self, *_: object) -> None:
        if self._heeded:
            signal.signal(signal.SIGINT, self._before)

    def _note(self, number: int, frame: FrameType | None) -> None:
        if self.asked:
            raise KeyboardInterrupt
        self.asked = True
