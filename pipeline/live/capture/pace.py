"""Frames when they are due: each as long after the first one as it is in the film."""

import threading
import time


class Pace:
    """It begins with the first frame that is asked for."""

    def __init__(self) -> None:
        self._shift: float | None = None

    def is_stopped_before(self, seconds: float, stopped: threading.Event) -> bool:
        """Wait until the frame at `seconds` of the film is due; True as soon as `stopped` is set."""
        now = time.monotonic()
        if self._shift is None:
            self._shift = now - seconds
        return stopped.wait(max(0.0, seconds + self._shift - now))
