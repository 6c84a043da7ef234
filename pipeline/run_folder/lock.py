"""One process at a time works in a run folder; the system forgets the lock when that process dies, however it dies."""

import errno
import functools
import logging
from pathlib import Path
from typing import IO

from haustra.core.errors import HaustraError

logger = logging.getLogger(__name__)

WITHOUT_LOCKS = (errno.ENOLCK, errno.ENOTSUP, errno.EOPNOTSUPP, errno.ENOSYS)  # what a file system without them says
NAME = ".lock"  # stays in the folder: deleting it while another process waits for it would let both in


class RunLock:
    """Held from its making until `release`."""

    def __init__(self, root: Path) -> None:
        self._file: IO[bytes] | None = (root / NAME).open("ab")
        try:
            import fcntl
        except ImportError:  # Windows: two runs in one folder are then the user's to avoid
            return
        try:
            fcntl.flock(self._file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError as error:
            self.release()
            raise HaustraError(f"another process is working in {root}; wait for it, or give another folder") from error
        except OSError as error:
            if error.errno not in WITHOUT_LOCKS:
                self.release()
                raise HaustraError(f"cannot lock {root / NAME}: {error.strerror}") from error
            _say_unlocked(root)

    def release(self) -> None:
        if self._file is not None:
            self._file.close()
            self._file = None


@functools.cache
def _say_unlocked(root: Path) -> None:
    """Once a folder."""
    logger.warning("the file system of %s has no locks; do not start a second run in this folder", root)
