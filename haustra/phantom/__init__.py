"""A synthetic gut with known truth: anatomy, appearance, motion and imaging make RGB-D videos and training frames.

It imports nothing of this project but its errors: camera, noise and raycasting are its own, so that a fault of the
reconstruction cannot be repeated in the truth it is measured against.

- `PhantomConfig`: every number of a phantom; `scene_config`: that of a named scene; `film_of`: that, longer or larger.
- `Phantom`: mesh, texture, lens and light, ready to be filmed.
- `generate`: films a config into an RGB-D folder; `write_shards`: training frames of many phantoms.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from haustra.phantom.config import PhantomConfig as PhantomConfig
    from haustra.phantom.dataset.generate import generate as generate
    from haustra.phantom.dataset.scenes import film_of as film_of
    from haustra.phantom.dataset.scenes import scene_config as scene_config
    from haustra.phantom.dataset.shards import ShardPlan as ShardPlan
    from haustra.phantom.dataset.shards import write_shards as write_shards
    from haustra.phantom.imaging.render import Phantom as Phantom

_MODULE_OF = {
    "Phantom": "imaging.render",
    "PhantomConfig": "config",
    "ShardPlan": "dataset.shards",
    "film_of": "dataset.scenes",
    "generate": "dataset.generate",
    "scene_config": "dataset.scenes",
    "write_shards": "dataset.shards",
}
__all__ = ["Phantom", "PhantomConfig", "ShardPlan", "film_of", "generate", "scene_config", "write_shards"]


def __getattr__(name: str) -> Any:
    if name not in _MODULE_OF:
        raise AttributeError(f"module 'haustra.phantom' has no attribute '{name}'")
    return getattr(import_module(f"{__name__}.{_MODULE_OF[name]}"), name)
