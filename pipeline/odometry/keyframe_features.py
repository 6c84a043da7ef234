"""SIFT features of keyframes, found once for all that asks for them: the last adjustment, joining, another lens.

Finding them takes as long as tracking a frame, and needs nothing of the map, so that a second processor does it while
tracking goes on. 150 bytes a feature are kept, half of what a keyframe's tracks take.
"""

from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from types import TracebackType
from typing import Self

import numpy as np
from numpy.typing import NDArray

from pipeline.odometry.places import CONTRAST, Features, sift

ReadFrame = Callable[[int], tuple[NDArray[np.uint8], NDArray[np.uint8]]]  # frame -> rgb (H,W,3), mask (H,W)
THREADS = 2  # OpenCV lets go of the interpreter


class KeyframeFeatures:
    """Call it with the number of a frame. What `read` raises is raised by the call."""

    def __init__(self, read: ReadFrame) -> None:
        self._read = read
        self._found: dict[int, Future[Features]] = {}
        self._threads = ThreadPoolExecutor(THREADS, "features")

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        self._threads.shutdown(cancel_futures=True)

    def __call__(self, frame: int) -> Features:
        self.begin(frame)
        return self._found[frame].result()

    def begin(self, frame: int) -> None:
        """Find them in the background."""
        if frame not in self._found:
            self._found[frame] = self._threads.submit(self._find, frame)

    def _find(self, frame: int) -> Features:
        return sift(*self._read(frame), CONTRAST)
