"""Import of Open3D where system libraries may be missing, and its ray casting scene."""

import ctypes
from contextlib import suppress
from importlib import import_module
from types import ModuleType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from haustra.core.errors import ReconstructionError

DEBIAN_PACKAGES = "libegl1 libgl1 libx11-6 libgomp1"
TRIES = 20


def import_open3d() -> ModuleType:
    """The `open3d` module; `ReconstructionError` names the Debian packages if a system library is missing."""
    if not _loads("libusb-1.0.so.0"):
        _preload_packaged_libusb()
    try:
        open3d = _imported()
    except (ImportError, OSError) as error:
        reason = f"Open3D cannot be loaded ({error})"
        raise ReconstructionError(
            f"{reason}; on Debian or Ubuntu, `apt-get install {DEBIAN_PACKAGES}` provides what it needs."
        ) from error
    return open3d


def _imported() -> ModuleType:
    """Open3D goes through the list of loaded modules as it loads, and gives up (`RuntimeError`) where another thread
    loads one just then. What it had loaded by then stays, so that the next try is over in no time."""
    for _ in range(TRIES - 1):
        with suppress(RuntimeError):
            return import_module("open3d")
    return import_module("open3d")


def ray_scene(vertices: NDArray[np.floating], faces: NDArray[np.integer]) -> Any:
    """A `RaycastingScene` of triangles (F,3) between vertices (V,3); in single precision, as Open3D has it."""
    o3d = import_open3d()
    scene = o3d.t.geometry.RaycastingScene()
    scene.add_triangles(o3d.core.Tensor(vertices.astype(np.float32)), o3d.core.Tensor(faces.astype(np.uint32)))
    return scene


def _loads(library: str) -> bool:
    """Whether the dynamic linker finds a shared library of that name."""
    try:
        ctypes.CDLL(library)
    except OSError:
        return False
    return True


def _preload_packaged_libusb() -> None:
    """Load the libusb of PyPI's `libusb-package`, which Open3D links for its depth sensors and finds by its soname."""
    try:
        import libusb_package

        ctypes.CDLL(str(libusb_package.get_library_path()), mode=ctypes.RTLD_GLOBAL)
    except (ImportError, OSError):
        return  # the import of Open3D then fails, and its message names the library that is missing
