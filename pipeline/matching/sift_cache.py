"""Cache of SIFT features of frames: adjustment, merging, self-calibration and the triangulation of points read them.

Finding them takes as long as tracking a frame, and needs nothing of the map, so that a second processor does it while
tracking goes on. 150 bytes a feature are kept, half of what a keyframe's tracks take.
"""

import threading
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from types import TracebackType
from typing import Self

import numpy as np
from numpy.typing import NDArray

from pipeline.matching.sift import SiftFeatures, detect_sift

ReadFrame = Callable[[int], tuple[NDArray[np.uint8], NDArray[np.uint8]]]  # frame -> rgb (H,W,3), mask (H,W)


class SiftCache:
    """Call it with the number of a frame. What `read` raises is raised by the call. Leaving it by `with` forgets all.

    One thread finds what was begun, so that tracking keeps a processor for itself; who asks for what that thread has
    not come to yet finds it himself, as many at once as ask.
    """

    def __init__(self, read: ReadFrame) -> None:
        self._read = read
        self._found: dict[int, Future[SiftFeatures]] = {}
        self._guard = threading.Lock()
        self._thread = ThreadPoolExecutor(1, "features")  # OpenCV lets go of the interpreter

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        self._thread.shutdown(cancel_futures=True)
        with self._guard:
            self._found.clear()

    def __call__(self, frame: int) -> SiftFeatures:
        with self._guard:
            future = self._found.get(frame)
            unclaimed = future is None or future.cancel()  # what has begun cannot be cancelled
            if unclaimed:
                future = self._found[frame] = Future()
                future.set_running_or_notify_cancel()
        assert future is not None
        if unclaimed:
            self._settle(future, frame)
        return future.result()

    def begin(self, frame: int) -> None:
        """Find them in the background."""
        with self._guard:
            if frame not in self._found:
                self._found[frame] = self._thread.submit(self._find, frame)

    def _find(self, frame: int) -> SiftFeatures:
        return detect_sift(*self._read(frame))

    def _settle(self, future: Future[SiftFeatures], frame: int) -> None:
        """Find them now; what is raised goes to everybody who waits for them."""
        try:
            future.set_result(self._find(frame))
        except BaseException as error:
            future.set_exception(error)
            raise
