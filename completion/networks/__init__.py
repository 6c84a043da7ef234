"""Networks of depth completion, each a file and a row of `registry.REGISTRY`, and the layers that they consist of.

A metric network maps image, sparse depth and intrinsics to depth in the same unit, as the paper compares them; a
`DepthNetwork` maps image and log sparse depth without a unit to an `Estimate`, and `reconstruct` can use it. `rivals/`
has the networks that the paper compares with, `cpu/` faster equivalents of parts for inference on a CPU."""

from typing import TYPE_CHECKING

from haustra.core.lazy_names import lazy_names

if TYPE_CHECKING:
    from completion.networks.checkpoint import load_network as load_network
    from completion.networks.checkpoint import save_network as save_network
    from completion.networks.protocol import DepthNetwork as DepthNetwork
    from completion.networks.protocol import Estimate as Estimate
    from completion.networks.registry import REGISTRY as REGISTRY
    from completion.networks.registry import Entry as Entry
    from completion.networks.registry import build_model as build_model

_MODULE_OF = {
    "DepthNetwork": "completion.networks.protocol",
    "Entry": "completion.networks.registry",
    "Estimate": "completion.networks.protocol",
    "REGISTRY": "completion.networks.registry",
    "build_model": "completion.networks.registry",
    "load_network": "completion.networks.checkpoint",
    "save_network": "completion.networks.checkpoint",
}
__all__ = ["REGISTRY", "DepthNetwork", "Entry", "Estimate", "build_model", "load_network", "save_network"]
__getattr__ = lazy_names(__name__, _MODULE_OF)
