"""Frames with true depth, and sparse depth drawn from it: readers of the field's data sets and training shards, two
independent samplers (`sampling_benchmark` in NumPy, the reference; `sampling_training` in torch, in batches), and
dequantization of coarsely stored depth."""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from completion.data.evaluation_frame import EvaluationFrame as EvaluationFrame
    from completion.data.quantized_depth import dequantize as dequantize
    from completion.data.readers import read_evaluation_frames as read_evaluation_frames
    from completion.data.sampling_benchmark import get_sampler as get_sampler
    from completion.data.shards import Shard as Shard

_MODULE_OF = {
    "EvaluationFrame": "completion.data.evaluation_frame",
    "Shard": "completion.data.shards",
    "dequantize": "completion.data.quantized_depth",
    "get_sampler": "completion.data.sampling_benchmark",
    "read_evaluation_frames": "completion.data.readers",
}
__all__ = ["EvaluationFrame", "Shard", "dequantize", "get_sampler", "read_evaluation_frames"]


def __getattr__(name: str) -> Any:
    """A public name on its first use, so that importing the package does not import torch."""
    if name not in _MODULE_OF:
        raise AttributeError(f"module '{__name__}' has no attribute '{name}'")
    return getattr(import_module(_MODULE_OF[name]), name)
