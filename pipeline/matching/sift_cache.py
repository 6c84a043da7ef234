"""Cache of SIFT features of frames: adjustment, merging, self-calibration and the triangulation of points read them.

Finding them takes as long as tracking a frame, and needs nothing of the map, so that a second processor does it while
tracking goes on. A frame's take 150 KB: of a long film they would be gigabytes, and most wait in files.
"""

import shutil
import threading
import zipfile
from collections import OrderedDict
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import suppress
from pathlib import Path
from types import TracebackType
from typing import Self

import numpy as np
from numpy.typing import NDArray

from pipeline.matching.sift import SiftFeatures, detect_sift

HELD = 256  # frames whose features stay in memory

ReadFrame = Callable[[int], tuple[NDArray[np.uint8], NDArray[np.uint8]]]  # frame -> rgb (H,W,3), mask (H,W)


class SiftCache:
    """Call it with the number of a frame. What `read` raises is raised by the call. Leaving it by `with` forgets all.

    One thread finds what was begun, so that tracking keeps a processor for itself; who asks for what that thread has
    not come to yet finds it himself, as many at once as ask.

    folder: where the features of all but the `held` frames that were named last are written; it belongs to the
    cache, and is removed with it. None: all stay in memory.
    """

    def __init__(self, read: ReadFrame, folder: Path | None = None, held: int = HELD) -> None:
        self._read = read
        self._folder, self._held = folder, held
        self._found: dict[int, Future[SiftFeatures]] = {}
        self._used: OrderedDict[int, None] = OrderedDict()  # frames whose features are in memory, the latest last
        self._written: set[int] = set()
        self._guard = threading.Lock()
        self._thread = ThreadPoolExecutor(1, "features")  # OpenCV lets go of the interpreter

    def __enter__(self) -> Self:
        self._remove_folder()  # of a run that was killed
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        self._thread.shutdown(cancel_futures=True)
        with self._guard:
            for forgotten in (self._found, self._used, self._written):
                forgotten.clear()
            self._remove_folder()

    def _remove_folder(self) -> None:
        if self._folder is not None:
            shutil.rmtree(self._folder, ignore_errors=True)

    def __call__(self, frame: int) -> SiftFeatures:
        with self._guard:
            future = self._found.get(frame)
            unclaimed = future is None or future.cancel()  # what has begun cannot be cancelled
            if frame in self._used:
                self._used.move_to_end(frame)
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
            if frame in self._used:
                self._used.move_to_end(frame)
            if frame not in self._found and frame not in self._written:
                self._found[frame] = self._thread.submit(self._find, frame)

    def _find(self, frame: int) -> SiftFeatures:
        found = self._load(frame)
        if found is None:
            found = detect_sift(*self._read(frame))
        if self._folder is not None:
            with self._guard:
                self._used[frame] = None
                self._write_older(self._folder)
        return found

    def _load(self, frame: int) -> SiftFeatures | None:
        if self._folder is None or frame not in self._written:
            return None
        try:
            with np.load(self._folder / f"{frame}.npz", allow_pickle=False) as arrays:
                return SiftFeatures(arrays["pixels"], arrays["descriptors"], arrays["sizes"])
        except (OSError, ValueError, KeyError, zipfile.BadZipFile):  # somebody tidied up: they are found again
            self._written.discard(frame)
            return None

    def _write_older(self, folder: Path) -> None:
        """Write what is asked for least lately, and forget it; where the disk is full, it stays in memory."""
        for frame in list(self._used)[: max(0, len(self._used) - self._held)]:
            future = self._found.get(frame)
            if future is None or not future.done():
                continue
            if frame not in self._written and not _write(future.result(), folder / f"{frame}.npz"):
                return
            self._written.add(frame)
            del self._found[frame], self._used[frame]

    def _settle(self, future: Future[SiftFeatures], frame: int) -> None:
        """Find them now; what is raised goes to everybody who waits for them."""
        try:
            future.set_result(self._find(frame))
        except BaseException as error:
            future.set_exception(error)
            raise


def _write(features: SiftFeatures, path: Path) -> bool:
    try:
        path.parent.mkdir(exist_ok=True)
        np.savez(path, pixels=features.pixels, descriptors=features.descriptors, sizes=features.sizes)
    except OSError:
        with suppress(OSError):
            path.unlink(missing_ok=True)
        return False
    return True
