"""StD-ResNet18 and -50: Sparse-to-Dense, Ma and Karaman, ICRA 2018 (the paper's [33]).

RGB and sparse depth, stacked as four channels, go through a ResNet, a 1x1 convolution that halves the channels, four
upsampling stages that halve them again, and a 3x3 convolution; the last factor of two is bilinear. No skips and no
activation on the output. The first convolution and, here, everything else starts from scratch.
"""

from dataclasses import dataclass
from typing import Literal

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from completion.networks.padding import pad_to_multiple
from completion.networks.rivals.resnet import conv_bn, init_fan_out, out_widths, resnet_stages
from haustra.core.errors import CompletionError

Decoder = Literal["upproj", "upconv", "deconv2", "deconv3"]
STRIDE = 32


class UnpoolConv(nn.ConvTranspose2d):
    """Zero-insertion unpooling by two, then a 5x5 convolution: (B,in,H,W) -> (B,out,2H,2W).

    Unpooling puts x[i,j] at (2i,2j) and zeros elsewhere. Three quarters of the products of the convolution after it
    are with those zeros; a transposed convolution with the kernel flipped is the same map without them, and three
    times as fast. `weight` (in,out,5,5) is that flipped kernel.
    """

    def __init__(self, in_channels: int, out_channels: int) -> None:
        super().__init__(in_channels, out_channels, 5, stride=2, padding=2, output_padding=1, bias=False)


class UpProj(nn.Module):
    """Up-projection (Laina et al., 3DV 2016, as used by Sparse-to-Dense), (B,C,H,W) -> (B,C/2,2H,2W).

    unpool -> [5x5, BN, ReLU, 3x3, BN] + [5x5, BN] -> ReLU. The two 5x5 convolutions read the same input and are one
    module here, with the main branch in the first half of its channels.
    """

    def __init__(self, in_channels: int) -> None:
        super().__init__()
        half = in_channels // 2
        self.unpool_conv = UnpoolConv(in_channels, 2 * half)
        self.norm = nn.BatchNorm2d(2 * half)
        self.project = conv_bn(half, half, 3)

    def forward(self, x: Tensor) -> Tensor:
        main, side = self.norm(self.unpool_conv(x)).chunk(2, dim=1)
        return F.relu(self.project(F.relu(main)) + side)


def _up_stage(decoder: Decoder, in_channels: int) -> nn.Module:
    """One stage of a decoder, (B,C,H,W) -> (B,C/2,2H,2W)."""
    half = in_channels // 2
    if decoder == "upproj":
        return UpProj(in_channels)
    if decoder == "upconv":
        up: nn.Module = UnpoolConv(in_channels, half)
    else:
        size = int(decoder[-1])
        padding, extra = (size - 1) // 2, size % 2
        up = nn.ConvTranspose2d(in_channels, half, size, 2, padding, extra, bias=False)
    return nn.Sequential(up, nn.BatchNorm2d(half), nn.ReLU())


def _init_decoder(module: nn.Module) -> None:
    """As the release initialises: an unpooled 5x5 is an ordinary convolution there, so its channels *out* count."""
    init_fan_out(module)
    if isinstance(module, UpProj):
        nn.init.normal_(module.unpool_conv.weight, std=(2 / (25 * module.unpool_conv.out_channels / 2)) ** 0.5)
    elif isinstance(module, nn.Sequential) and isinstance(module[0], UnpoolConv):
        nn.init.normal_(module[0].weight, std=(2 / (25 * module[0].out_channels)) ** 0.5)


@dataclass(frozen=True)
class SparseToDenseConfig:
    """Published: base 64. The paper's decoder is upproj; the released code's default is deconv2."""

    layers: int = 18  # or 50
    base: int = 64  # channels of the ResNet's stem
    decoder: Decoder = "upproj"

    def __post_init__(self) -> None:
        if self.layers not in (18, 50):
            raise CompletionError(f"StD has 18 or 50 layers, not {self.layers}")
        if self.base < 4 or self.base % 4:
            raise CompletionError(f"StD's base width must be a multiple of 4, got {self.base}")
        if self.decoder not in ("upproj", "upconv", "deconv2", "deconv3"):
            raise CompletionError(f"StD has no decoder '{self.decoder}'")


class SparseToDense(nn.Module):
    """Sparse-to-Dense: unit of the sparse depth in, same unit out."""

    def __init__(self, config: SparseToDenseConfig | None = None) -> None:
        super().__init__()
        self.config = config or SparseToDenseConfig()
        base, deepest = self.config.base, out_widths(self.config.layers, self.config.base)[-1]
        self.stem = nn.Sequential(conv_bn(4, base, 7, stride=2), nn.ReLU(), nn.MaxPool2d(3, 2, padding=1))
        self.stages = resnet_stages(self.config.layers, base)
        self.squeeze = conv_bn(deepest, deepest // 2, 1)
        self.decoder = nn.Sequential(*(_up_stage(self.config.decoder, deepest // 2**i) for i in range(1, 5)))
        self.head = nn.Conv2d(deepest // 32, 1, 3, padding=1, bias=False)
        for part in (self.stem, self.squeeze, self.head):
            part.apply(init_fan_out)
        self.decoder.apply(_init_decoder)

    def forward(self, rgb: Tensor, sparse_depth: Tensor, intrinsics: Tensor | None = None) -> Tensor:
        """rgb (B,3,H,W) in [0,1], sparse_depth (B,1,H,W) with 0 = none -> depth (B,1,H,W); intrinsics unused."""
        height, width = rgb.shape[2:]
        x = self.stem(pad_to_multiple(torch.cat([rgb, sparse_depth], dim=1), STRIDE))
        for stage in self.stages:
            x = stage(x)
        x = self.head(self.decoder(self.squeeze(x)))
        x = F.interpolate(x, scale_factor=2, mode="bilinear", align_corners=True)
        return x[..., :height, :width]
