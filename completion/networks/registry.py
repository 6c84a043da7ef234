"""Every network of the paper's comparison behind one name and one call.

`build_model(name)(rgb, sparse_depth, intrinsics)`: rgb (B,3,H,W) in [0,1], sparse_depth (B,1,H,W) with 0 = none, any H
and W -> depth (B,1,H,W) in the same unit. Only `gaenet` reads the intrinsics (B,4) = fx, fy, cx, cy in pixels.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Literal

from torch import Tensor

from completion.networks.classical import CLASSICAL as CLASSICAL
from completion.networks.mscsa import MSCSAConfig, MSCSANet
from completion.networks.rivals.gaenet import GAENet, GAENetConfig
from completion.networks.rivals.nlspn import NLSPN, NLSPNConfig
from completion.networks.rivals.sparse_to_dense import StDConfig, StDNet
from haustra.core.errors import CompletionError

Size = Literal["paper", "small"]


class MSCSAModel(MSCSANet):
    """`MSCSANet`, its weights included, with the call of the others."""

    def forward(self, rgb: Tensor, sparse_depth: Tensor, intrinsics: Tensor | None = None) -> Tensor:
        return super().forward(rgb, sparse_depth)


Model = MSCSAModel | StDNet | NLSPN | GAENet


@dataclass(frozen=True)
class _Entry:
    """A network, its configuration, what the name fixes, and what the small size cuts."""

    network: Callable[[Any], Model]
    config: Callable[..., Any]
    fixed: dict[str, Any]
    small: dict[str, Any]


def _mscsa(use_msc: bool, use_sa: bool, residual: bool = False, similar: bool = False) -> _Entry:
    switches = {"use_msc": use_msc, "use_sa": use_sa, "residual": residual, "similar": similar}
    return _Entry(MSCSAModel, MSCSAConfig, switches, {"width": 8})


# "small": networks that one CPU thread can train at 160 to 192 px, of about the cost of MSCSA-Net at half its width
# (50 to 130 ms forward and backward at 160 px). Cut: channels everywhere; of NLSPN also 34 layers to 18; of GAENet
# half of a point's features, since its point map must stay narrower than the first level.
REGISTRY: dict[str, _Entry] = {
    "unet": _mscsa(False, False),
    "unet+sa": _mscsa(False, True),
    "unet+msc": _mscsa(True, False),
    "mscsa": _mscsa(True, True),
    "unet+msc+residual": _mscsa(True, False, residual=True),
    "mscsa+residual": _mscsa(True, True, residual=True),
    "mscsa+residual+similar": _mscsa(True, True, residual=True, similar=True),
    "std18": _Entry(StDNet, StDConfig, {"layers": 18}, {"base": 48}),
    "std50": _Entry(StDNet, StDConfig, {"layers": 50}, {"base": 24}),
    "nlspn": _Entry(NLSPN, NLSPNConfig, {}, {"layers": 18, "base": 8}),
    "gaenet": _Entry(GAENet, GAENetConfig, {}, {"base": 16, "features": 8}),
}
ALIASES = {"full": "mscsa"}
NAMES = (*REGISTRY, *ALIASES)


def build_model(name: str, size: Size = "paper", **options: Any) -> Model:
    """A fresh network from torch's current seed; `options` are fields of its configuration and go before `size`."""
    entry = REGISTRY.get(ALIASES.get(name, name))
    if entry is None:
        raise CompletionError(f"no model '{name}': give one of {', '.join(NAMES)}")
    if size not in ("paper", "small"):
        raise CompletionError(f"no size '{size}': give paper or small")
    chosen = (entry.small if size == "small" else {}) | options | entry.fixed
    if clash := [key for key in options if key in entry.fixed]:
        raise CompletionError(f"'{name}' fixes {', '.join(clash)}")
    try:
        config = entry.config(**chosen)
    except TypeError as error:
        raise CompletionError(f"'{name}' does not take these options: {error}") from error
    return entry.network(config)
