"""Training of registered networks on shards of rendered frames, repeatable, resumable and on several processes:
`haustra train` is `train.train`."""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from completion.training.config import TrainConfig as TrainConfig
    from completion.training.config import make_config as make_config

_MODULE_OF = {
    "TrainConfig": "completion.training.config",
    "make_config": "completion.training.config",
}
__all__ = ["TrainConfig", "make_config"]


def __getattr__(name: str) -> Any:
    """A public name on its first use, so that importing the package does not import torch."""
    if name not in _MODULE_OF:
        raise AttributeError(f"module '{__name__}' has no attribute '{name}'")
    return getattr(import_module(_MODULE_OF[name]), name)
