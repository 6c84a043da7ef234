"""From a trained network to calls on arrays: `DepthCompleter` (exposure, normalisation by the points' median,
resolution, iterations, confidence), and the export of the network alone as an ONNX graph."""

from importlib import import_module
from typing import TYPE_CHECKING, Any

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


def __getattr__(name: str) -> Any:
    """A public name on its first use, so that importing the package does not import torch."""
    if name not in _MODULE_OF:
        raise AttributeError(f"module '{__name__}' has no attribute '{name}'")
    return getattr(import_module(_MODULE_OF[name]), name)
