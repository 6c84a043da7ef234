"""A file that another program is still writing, read as if it were whole: at its end, wait for more."""

import threading
import time
from pathlib import Path

POLL_S = 0.05
PATIENCE_S = 10.0  # without a new byte after which the file is taken to be complete


class GrowingFile:
    """What PyAV reads; it cannot be sought in, so formats whose index comes last cannot be read while they grow."""

    def __init__(self, path: Path, stopped: threading.Event, patience_s: float = PATIENCE_S) -> None:
        self._file = path.open("rb")
        self._stopped, self._patience_s, self._ended = stopped, patience_s, False

    def read(self, size: int) -> bytes:
        """Up to `size` bytes; none once the file has not grown for `patience_s`, or reading was stopped."""
        since = time.monotonic()
        while not (self._stopped.is_set() or self._ended):
            found = self._file.read(size)
            if found:
                return found
            self._ended = time.monotonic() - since > self._patience_s  # it is not waited for again
            time.sleep(POLL_S)
        return b""

    def close(self) -> None:
        self._file.close()
