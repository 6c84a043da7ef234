"""Frames with true depth, and sparse depth drawn from it: readers of the field's data sets and training shards, two
independent samplers (`sampling_benchmark` in NumPy, the reference; `sampling_training` in torch, in batches), and
dequantization of coarsely stored depth."""

from typing import TYPE_CHECKING

from haustra.core.lazy_names import lazy_names

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
__getattr__ = lazy_names(__name__, _MODULE_OF)
