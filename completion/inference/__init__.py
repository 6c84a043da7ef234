"""From a trained network to calls on arrays: `DepthCompleter` (exposure, normalisation by the points' median,
resolution, iterations, confidence), and the export of the network alone as an ONNX graph."""

from typing import TYPE_CHECKING

from haustra.core.lazy_names import lazy_names

if TYPE_CHECKING:
    from completion.inference.completer import DepthCompleter as DepthCompleter
    from completion.inference.completer import load_depth_network as load_depth_network
    from completion.inference.onnx_export import export_onnx as export_onnx

_MODULE_OF = {
    "DepthCompleter": "completion.inference.completer",
    "export_onnx": "completion.inference.onnx_export",
    "load_depth_network": "completion.inference.completer",
}
__all__ = ["DepthCompleter", "export_onnx", "load_depth_network"]
__getattr__ = lazy_names(__name__, _MODULE_OF)
