"""Phantoms on disk: named scenes and their evaluation suite, random phantoms, RGB-D folders, training shards, gallery
and demo clip.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from haustra.phantom.dataset.gallery import write_gallery as write_gallery
    from haustra.phantom.dataset.randomise import randomised as randomised
    from haustra.phantom.dataset.scenes import film_of as film_of
    from haustra.phantom.dataset.scenes import scene_config as scene_config
    from haustra.phantom.dataset.shards import ShardPlan as ShardPlan
    from haustra.phantom.dataset.shards import write_shards as write_shards
    from haustra.phantom.dataset.suite import load_suite as load_suite

_MODULE_OF = {
    "ShardPlan": "shards",
    "film_of": "scenes",
    "load_suite": "suite",
    "randomised": "randomise",
    "scene_config": "scenes",
    "write_gallery": "gallery",
    "write_shards": "shards",
}
__all__ = ["ShardPlan", "film_of", "load_suite", "randomised", "scene_config", "write_gallery", "write_shards"]


def __getattr__(name: str) -> Any:
    if name not in _MODULE_OF:
        raise AttributeError(f"module 'haustra.phantom.dataset' has no attribute '{name}'")
    return getattr(import_module(f"{__name__}.{_MODULE_OF[name]}"), name)
