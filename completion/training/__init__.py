"""Training of registered networks on shards of rendered frames, repeatable, resumable and on several processes:
`haustra train` is `train.train`."""

from typing import TYPE_CHECKING

from haustra.core.lazy_names import lazy_names

if TYPE_CHECKING:
    from completion.training.config import TrainConfig as TrainConfig
    from completion.training.config import make_config as make_config

_MODULE_OF = {
    "TrainConfig": "completion.training.config",
    "make_config": "completion.training.config",
}
__all__ = ["TrainConfig", "make_config"]
__getattr__ = lazy_names(__name__, _MODULE_OF)
