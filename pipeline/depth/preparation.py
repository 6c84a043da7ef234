"""What later stages need, loaded in the background while the first ones work: the network and slow libraries.

Importing torch, Open3D, trimesh and matplotlib takes some seconds of one processor. Reading and tracking frames leave
another one idle for that long. A background import changes nothing that is computed.
"""

from __future__ import annotations

import gc
import sys
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from importlib import import_module
from types import TracebackType
from typing import TYPE_CHECKING

from reconstruction.mesh.open3d_import import import_open3d

if TYPE_CHECKING:
    from completion.inference.completer import DepthCompleter

# In the order in which stages need them.
LIBRARIES = (
    "trimesh",
    "matplotlib.figure",
    "matplotlib.backends.backend_agg",
)

# An import holds the interpreter for as long as this, and reading frames asks for it many times a frame.
SWITCH_S = 5e-4

# Libraries come with 400,000 objects, none of them garbage. Python goes through all of them for a quarter more. An
# array of numbers is no such object.
OBJECTS_BETWEEN_SEARCHES = 50_000

LoadCompleter = Callable[[], "DepthCompleter"]


class Preparation:
    """Loads the completion network `model` and then the libraries; leave it by `with`, which drops what is not begun.

    What fails is raised where it is asked for, or by the stage that imports the library itself.
    """

    def __init__(self, model: str, device: str, iterations: int | None) -> None:
        self._load = lambda: load_completer(model, device, iterations)
        self._threads = ThreadPoolExecutor(1, "preparation")
        self._switch_s, self._searches = sys.getswitchinterval(), gc.get_threshold()
        self._completer: Future[DepthCompleter] | None = None

    def begin(self, with_network: bool) -> None:
        """Start in the background; with_network: unless the depth is on disk already."""
        sys.setswitchinterval(SWITCH_S)
        gc.set_threshold(OBJECTS_BETWEEN_SEARCHES, *self._searches[1:])
        if with_network:
            self._completer = self._threads.submit(self._load)
        for library in LIBRARIES:
            self._threads.submit(import_module, library)
        self._threads.submit(import_open3d)
        self._threads.submit(self._as_before)

    def completer(self) -> DepthCompleter:
        """The network, waited for if need be. Raises `HaustraError` where it does not load."""
        if self._completer is None:
            self._completer = self._threads.submit(self._load)
        return self._completer.result()

    def forget(self) -> None:
        """Let the network go, whose memory later stages can use; it is loaded again where it is asked for."""
        self._completer = None

    def __enter__(self) -> Preparation:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        self._threads.shutdown(wait=False, cancel_futures=True)
        self._as_before()

    def _as_before(self) -> None:
        sys.setswitchinterval(self._switch_s)
        gc.set_threshold(*self._searches)


def load_completer(model: str, device: str, iterations: int | None) -> DepthCompleter:
    """A shipped model by name, or of a weight file; its compiled loops are loaded by one small frame."""
    import numpy as np

    from completion.inference.completer import DepthCompleter

    completer = DepthCompleter.load(model, device, iterations=iterations)
    points = np.zeros((64, 64), np.float32)
    points[8::16, 8::16] = 1
    completer(np.full((64, 64, 3), 128, np.uint8), points)
    return completer
