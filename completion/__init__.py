"""Dense depth and confidence from an image and sparse depth (torch). Imports only `haustra.core` besides itself.

`DepthCompleter` completes frames with a trained network; `build_model` makes any network of the comparison;
`evaluate_frames` measures errors on frames with true depth, under a `Protocol`. Each is loaded on its first use."""

from typing import TYPE_CHECKING

from haustra.core.lazy_names import lazy_names

if TYPE_CHECKING:
    from completion.evaluation.evaluate import Protocol as Protocol
    from completion.evaluation.evaluate import evaluate_frames as evaluate_frames
    from completion.inference.completer import DepthCompleter as DepthCompleter
    from completion.networks.registry import build_model as build_model

_MODULE_OF = {
    "DepthCompleter": "completion.inference.completer",
    "Protocol": "completion.evaluation.evaluate",
    "build_model": "completion.networks.registry",
    "evaluate_frames": "completion.evaluation.evaluate",
}
__all__ = ["DepthCompleter", "Protocol", "build_model", "evaluate_frames"]
__getattr__ = lazy_names(__name__, _MODULE_OF)
