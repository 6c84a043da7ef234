"""The one table of networks: every network that can be trained, saved, loaded and evaluated is a row of `REGISTRY`
(docs/extending.md).

A metric network, as the paper compares them, is called `network(rgb, sparse_depth, intrinsics)`: rgb (B,3,H,W) in
[0,1], sparse_depth (B,1,H,W) with 0 = none, intrinsics (B,4) = fx, fy, cx, cy px or None, any H and W -> depth
(B,1,H,W) in the unit of sparse_depth. One that offers `completion.networks.protocol.DepthNetwork` takes points without
a unit instead, and `reconstruct` can use it.
"""

from dataclasses import dataclass, field, fields
from typing import Any, Literal, get_args

from torch import nn

from completion.networks.classical import CLASSICAL as CLASSICAL
from completion.networks.mscsa import MSCSAConfig, MSCSANet
from completion.networks.mscsa_early_fusion import EarlyFusionConfig, EarlyFusionMSCSANet
from completion.networks.mscsa_sfm import ScaleInvariantConfig, ScaleInvariantMSCSANet
from completion.networks.rivals.gaenet import GAENet, GAENetConfig
from completion.networks.rivals.nlspn import NLSPN, NLSPNConfig
from completion.networks.rivals.sparse_to_dense import SparseToDense, SparseToDenseConfig
from haustra.core.errors import CompletionError

Size = Literal["paper", "small", "same-parameters"]


@dataclass(frozen=True)
class Entry:
    """A row: `network(config(**options))`. `config` is a dataclass, saved with the class's name in weight files."""

    network: type[nn.Module]
    config: type[Any]
    fixed: dict[str, Any] = field(default_factory=dict)  # options that the name stands for
    small: dict[str, Any] = field(default_factory=dict)  # options of the size "small"
    same_parameters: dict[str, Any] | None = None  # of the size "same-parameters"; None: those of "small"
    needs_intrinsics: bool = False
    old_headers: tuple[str, ...] = ()  # names of the class in older weight files
    old_options: dict[str, str] = field(default_factory=dict)  # older weight files' names of options: today's

    def is_of(self, header: str) -> bool:
        """Whether a weight file with this class name holds such a network."""
        return header == self.network.__name__ or header in self.old_headers

    @property
    def is_metric(self) -> bool:
        """Whether it is called as the paper's networks are; else it is a `DepthNetwork`."""
        return not hasattr(self.network, "iterate")

    def of_size(self, size: Size) -> dict[str, Any]:
        """Options of a size; CompletionError if there is none of this name."""
        if size not in get_args(Size):
            raise CompletionError(f"no size '{size}': give {' or '.join(get_args(Size))}")
        if size == "same-parameters" and self.same_parameters is not None:
            return self.same_parameters
        return {} if size == "paper" else self.small

    def options(self) -> set[str]:
        """Names of its configuration's fields."""
        return {option.name for option in fields(self.config)}


def _mscsa(use_msc: bool, use_sa: bool, residual: bool = False, similar: bool = False, norm: str = "batch") -> Entry:
    switches = {"use_msc": use_msc, "use_sa": use_sa, "residual": residual, "similar": similar, "norm": norm}
    return Entry(MSCSANet, MSCSAConfig, switches, {"width": 8}, old_headers=("MSCSAModel",))


def _early_fusion(use_msc: bool, use_sa: bool, **readings: float) -> Entry:
    return Entry(EarlyFusionMSCSANet, EarlyFusionConfig, {"use_msc": use_msc, "use_sa": use_sa, **readings})


# "small": MSCSA-Net at half its width (0.81 M parameters, 0.38 G multiplications a frame of 160 px), and the networks
# that the paper compares it with cut to as many multiplications (0.37 to 0.45 G); "same-parameters": cut to as many
# parameters (0.70 to 1.01 M). Cut: channels everywhere; of NLSPN also 34 layers to 18; of GAENet half of a point's
# features, since its point map must stay narrower than the first level. The early-fusion networks (0.48 M, 0.49 G)
# are that small as published.
REGISTRY: dict[str, Entry] = {
    "mscsa-sfm": Entry(
        ScaleInvariantMSCSANet,
        ScaleInvariantConfig,
        old_options={"looks": "iterations"},
        old_headers=("ScaleFreeMSCSANet",),
    ),
    "unet": _mscsa(False, False),
    "unet+sa": _mscsa(False, True),
    "unet+msc": _mscsa(True, False),
    "mscsa": _mscsa(True, True),
    "unet+msc+residual": _mscsa(True, False, residual=True),
    "mscsa+residual": _mscsa(True, True, residual=True),
    "mscsa+residual+similar": _mscsa(True, True, residual=True, similar=True),
    "unet-plain": _mscsa(False, False, norm="none"),
    "unet-plain+sa": _mscsa(False, True, norm="none"),
    "unet-plain+msc": _mscsa(True, False, norm="none"),
    "mscsa-plain": _mscsa(True, True, norm="none"),
    "mscsa-plain+residual": _mscsa(True, True, residual=True, norm="none"),
    "mscsa-batch-leaky": _mscsa(True, True, norm="batch-leaky"),
    "mscsa-frozen": _mscsa(True, True, norm="frozen"),
    "mscsa-frame": _mscsa(True, True, norm="frame"),
    "early-fusion": _early_fusion(False, False),
    "early-fusion+sa": _early_fusion(False, True),
    "early-fusion+msc": _early_fusion(True, False),
    "mscsa-early-fusion": _early_fusion(True, True),
    "mscsa-early-fusion+confidence-last": _early_fusion(True, True, confidence_last=True),
    "mscsa-early-fusion+all-scales": _early_fusion(True, True, all_scales=True),
    "mscsa-early-fusion+sparse-first": _early_fusion(True, True, sparse_last=False),
    "mscsa-early-fusion+gamma-1": _early_fusion(True, True, gamma_beta=1.0),
    "mscsa-early-fusion+epsilon": _early_fusion(True, True, epsilon=1e-6),
    "mscsa-early-fusion+guard": _early_fusion(True, True, guard=1e-6),
    "mscsa-early-fusion+similar": _early_fusion(True, True, similar=True),
    "mscsa-early-fusion+replaces": _early_fusion(True, True, replaces=True),
    "mscsa-early-fusion+learned-gain": _early_fusion(True, True, learned_gain=True),
    "mscsa-early-fusion+four-levels": _early_fusion(True, True, levels=4),
    "mscsa-early-fusion+half-width": _early_fusion(True, True, widening=0.5),
    "mscsa-early-fusion+double-width": _early_fusion(True, True, widening=2.0),
    "std18": Entry(
        SparseToDense, SparseToDenseConfig, {"layers": 18}, {"base": 36}, {"base": 16}, old_headers=("StDNet",)
    ),
    "std50": Entry(
        SparseToDense, SparseToDenseConfig, {"layers": 50}, {"base": 16}, {"base": 8}, old_headers=("StDNet",)
    ),
    "nlspn": Entry(NLSPN, NLSPNConfig, {}, {"layers": 18, "base": 8}, {"layers": 18, "base": 16}),
    "gaenet": Entry(GAENet, GAENetConfig, {}, {"base": 12, "features": 8}, needs_intrinsics=True),
}
ALIASES = {"full": "mscsa", "scale-free": "mscsa-sfm"}


def canonical_name(name: str) -> str:
    """The name of a row of which `name` may be an alias."""
    return ALIASES.get(name, name)


def find_entry(name: str) -> Entry:
    """The row of a name or an alias; CompletionError if there is none."""
    entry = REGISTRY.get(canonical_name(name))
    if entry is None:
        raise CompletionError(f"no model '{name}': give one of {', '.join((*REGISTRY, *ALIASES))}")
    return entry


def described_network(header: str, options: dict[str, Any]) -> tuple[Entry, Any]:
    """Row and configuration of a weight file's header; CompletionError if no row is of that class, KeyError or
    TypeError if its options are not the row's."""
    entry = next((entry for entry in REGISTRY.values() if entry.is_of(header)), None)
    if entry is None:
        raise CompletionError(f"a {header}, which this version does not know")
    return entry, entry.config(**{entry.old_options.get(name, name): value for name, value in options.items()})


def build_model(name: str, size: Size = "paper", **options: Any) -> nn.Module:
    """A fresh network from torch's current seed; `options` are fields of its configuration and go before `size`."""
    entry = find_entry(name)
    chosen = entry.of_size(size) | options | entry.fixed
    if clash := [key for key in options if key in entry.fixed]:
        raise CompletionError(f"'{name}' fixes {', '.join(clash)}")
    try:
        config = entry.config(**chosen)
    except TypeError as error:
        raise CompletionError(f"'{name}' does not take these options: {error}") from error
    return entry.network(config)
