"""MSCSA-Net: multi-scale confidence, a U-Net, structure awareness (paper section II, Fig. 2).

`MSCSANet` is the paper's metric network with two switches for its ablation; the scale-invariant network for points from
structure from motion is `mscsa_sfm.ScaleInvariantMSCSANet`.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Literal, get_args

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from completion.networks.channel_attention import StructureAwareness
from completion.networks.conv_blocks import LeakyDoubleConv
from completion.networks.normalized_conv import MultiScaleConfidence
from completion.networks.padding import pad_to_multiple
from haustra.core.errors import CompletionError


class DoubleConv(nn.Sequential):
    """Two 3x3 convolutions with batch normalisation and ReLU, (B,in,H,W) -> (B,out,H,W)."""

    def __init__(self, in_channels: int, out_channels: int) -> None:
        super().__init__(
            nn.Conv2d(in_channels, out_channels, 3, padding=1, bias=False),
            nn.BatchNorm2d(out_channels),
            nn.ReLU(inplace=True),
            nn.Conv2d(out_channels, out_channels, 3, padding=1, bias=False),
            nn.BatchNorm2d(out_channels),
            nn.ReLU(inplace=True),
        )


class UNet(nn.Module):
    """U-Net with bilinear upsampling and an optional attention between encoder and decoder.

    (B,in,H,W) -> (B,out,H,W); H and W divisible by 2**(len(widths)-1). block: makes the pair of convolutions of a
    level from its numbers of input and output channels.
    """

    def __init__(
        self,
        in_channels: int,
        out_channels: int,
        widths: tuple[int, ...],
        attention: nn.Module | None,
        block: Callable[[int, int], nn.Module] = DoubleConv,
    ) -> None:
        super().__init__()
        self.encoder = nn.ModuleList(block(a, b) for a, b in zip((in_channels, *widths[:-1]), widths, strict=True))
        self.attention = attention if attention is not None else nn.Identity()
        self.decoder = nn.ModuleList(
            block(coarse + fine, fine) for coarse, fine in zip(widths[:0:-1], widths[-2::-1], strict=True)
        )
        self.head = nn.Conv2d(widths[0], out_channels, 1)

    def joined(self, parts: list[Tensor]) -> Tensor:
        """Concatenate channels (B,?,H,W) to the input (B,in,H,W), in the weights' precision."""
        return torch.cat(parts, dim=1).to(self.head.weight.dtype)

    def forward(self, x: Tensor) -> Tensor:
        skips = []
        for level, block in enumerate(self.encoder):
            x = block(F.max_pool2d(x, 2) if level else x)
            skips.append(x)
        x = self.attention(skips.pop())
        for block in self.decoder:
            skip = skips.pop()
            x = F.interpolate(x, size=skip.shape[2:], mode="bilinear", align_corners=False)
            x = block(torch.cat([skip, x], dim=1))
        return self.head(x)


def _widths(base: int) -> tuple[int, ...]:
    """Channels of the six levels."""
    return (base, 2 * base, 4 * base, 8 * base, 12 * base, 12 * base)


# A side must halve five times for the U-Net (the confidence pyramid needs three); inputs are padded up to that.
STRIDE = 32


Norm = Literal["batch", "none", "batch-leaky", "frozen", "frame"]


@dataclass(frozen=True)
class MSCSAConfig:
    """Size and switches of `MSCSANet`; the paper states neither width nor depth of its U-Net."""

    width: int = 16  # channels of the first level; 16 gives 3 M parameters
    use_msc: bool = True
    use_sa: bool = True
    residual: bool = False  # the U-Net corrects MSC's depth; not in the paper, see `MSCSANet`
    similar: bool = False  # SA weighs like channels most, as the paper's text says; its released relatives do not
    norm: Norm = "batch"  # of the U-Net: "batch" is `DoubleConv`, the others are `LeakyDoubleConv`

    def __post_init__(self) -> None:
        if self.norm not in get_args(Norm):
            raise CompletionError(f"norm is one of {', '.join(get_args(Norm))}, not {self.norm!r}")
        if self.residual and not self.use_msc:
            raise CompletionError("'residual' corrects MSC's depth, and there is no MSC in this network")


class MSCSANet(nn.Module):
    """The paper's network: metric sparse depth in, metric dense depth out.

    U-Net input: MSC's depth and confidence, RGB and the raw sparse depth (six channels, Fig. 2); without MSC the
    four of RGB-SD. As published the U-Net's output is the depth; with `residual` its output is added to MSC's depth.
    The paper does not say whether its U-Net normalises features: `MSCSAConfig.norm`.
    """

    def __init__(self, config: MSCSAConfig | None = None) -> None:
        super().__init__()
        self.config = config or MSCSAConfig()
        self.msc = MultiScaleConfidence(levels=3) if self.config.use_msc else None
        sign: Literal["distinct", "similar"] = "similar" if self.config.similar else "distinct"
        attention = StructureAwareness(sign=sign) if self.config.use_sa else None
        norm = self.config.norm
        block = DoubleConv if norm == "batch" else partial(LeakyDoubleConv, norm=norm)
        self.unet = UNet(6 if self.config.use_msc else 4, 1, _widths(self.config.width), attention, block)

    def forward(self, rgb: Tensor, sparse_depth: Tensor, intrinsics: Tensor | None = None) -> Tensor:
        """rgb (B,3,H,W) in [0,1], sparse_depth (B,1,H,W) with 0 = none -> depth (B,1,H,W), same unit; intrinsics
        unused."""
        height, width = rgb.shape[2:]
        rgb, sparse_depth = pad_to_multiple(rgb, STRIDE), pad_to_multiple(sparse_depth, STRIDE)
        if self.msc is None:
            return self.unet(torch.cat([rgb, sparse_depth], dim=1))[..., :height, :width]
        with torch.autocast(rgb.device.type, enabled=False):
            depth, confidence = self.msc(sparse_depth.float(), (sparse_depth > 0).float())
        out = self.unet(torch.cat([rgb, sparse_depth, depth, confidence], dim=1))
        if self.config.residual:
            out = out.float() + depth
        return out[..., :height, :width]
