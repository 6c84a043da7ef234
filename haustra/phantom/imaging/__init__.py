"""From surface to image: lens, lights at the tip with interreflection, what hides the wall, and the sensor with its
video processor.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from haustra.phantom.imaging.camera import Camera as Camera
    from haustra.phantom.imaging.camera import make_camera as make_camera
    from haustra.phantom.imaging.render import Frame as Frame
    from haustra.phantom.imaging.render import Phantom as Phantom
    from haustra.phantom.imaging.sensor import Sensor as Sensor
    from haustra.phantom.imaging.shading import shade as shade

_MODULE_OF = {
    "Camera": "camera",
    "Frame": "render",
    "Phantom": "render",
    "Sensor": "sensor",
    "make_camera": "camera",
    "shade": "shading",
}
__all__ = ["Camera", "Frame", "Phantom", "Sensor", "make_camera", "shade"]


def __getattr__(name: str) -> Any:
    if name not in _MODULE_OF:
        raise AttributeError(f"module 'haustra.phantom.imaging' has no attribute '{name}'")
    return getattr(import_module(f"{__name__}.{_MODULE_OF[name]}"), name)
