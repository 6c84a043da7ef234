"""Motion of the camera through the lumen, single viewpoints for training, and peristalsis of the wall."""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from haustra.phantom.motion.camera_path import clearance as clearance
    from haustra.phantom.motion.camera_path import plan_camera_path as plan_camera_path
    from haustra.phantom.motion.peristalsis import Peristalsis as Peristalsis
    from haustra.phantom.motion.viewpoints import random_viewpoint as random_viewpoint

_MODULE_OF = {
    "Peristalsis": "peristalsis",
    "plan_camera_path": "camera_path",
    "clearance": "camera_path",
    "random_viewpoint": "viewpoints",
}
__all__ = ["Peristalsis", "clearance", "plan_camera_path", "random_viewpoint"]


def __getattr__(name: str) -> Any:
    if name not in _MODULE_OF:
        raise AttributeError(f"module 'haustra.phantom.motion' has no attribute '{name}'")
    return getattr(import_module(f"{__name__}.{_MODULE_OF[name]}"), name)
