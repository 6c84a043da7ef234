"""ResNet stages (He et al., CVPR 2016), from scratch: the encoders of Sparse-to-Dense and of NLSPN.

The layer tables are torchvision's, whose parameter counts the tests compare: 3x3 strides inside bottlenecks ("v1.5"),
no bias before batch normalisation, fan-out initialisation. `base` is the width of the first stage, 64 in the paper.
"""

import torch.nn.functional as F
from torch import Tensor, nn

BLOCKS = {18: (2, 2, 2, 2), 34: (3, 4, 6, 3), 50: (3, 4, 6, 3)}  # of each stage
BOTTLENECK_EXPANSION = 4


def conv_bn(in_channels: int, out_channels: int, kernel_size: int, stride: int = 1) -> nn.Sequential:
    """Convolution of "same" padding without bias, then batch normalisation."""
    return nn.Sequential(
        nn.Conv2d(in_channels, out_channels, kernel_size, stride, kernel_size // 2, bias=False),
        nn.BatchNorm2d(out_channels),
    )


class ResidualBlock(nn.Module):
    """relu(branch(x) + shortcut(x)), (B,in,H,W) -> (B,out,H/stride,W/stride)."""

    def __init__(self, branch: nn.Module, in_channels: int, out_channels: int, stride: int) -> None:
        super().__init__()
        self.branch, self.stride = branch, stride
        same = stride == 1 and in_channels == out_channels
        self.shortcut = nn.Identity() if same else conv_bn(in_channels, out_channels, 1)

    def forward(self, x: Tensor) -> Tensor:
        # Every second pixel, then a 1x1 convolution: the same as one of stride two, whose backward pass in oneDNN
        # writes out of bounds for eight channels in channels-last order (torch 2.13).
        return F.relu(self.branch(x) + self.shortcut(x[..., :: self.stride, :: self.stride]))


def basic_block(in_channels: int, width: int, stride: int) -> ResidualBlock:
    """Two 3x3 convolutions (ResNet-18 and -34)."""
    branch = nn.Sequential(conv_bn(in_channels, width, 3, stride), nn.ReLU(), conv_bn(width, width, 3))
    return ResidualBlock(branch, in_channels, width, stride)


def bottleneck_block(in_channels: int, width: int, stride: int) -> ResidualBlock:
    """1x1, 3x3, 1x1 convolutions; four times `width` channels out (ResNet-50)."""
    out_channels = BOTTLENECK_EXPANSION * width
    branch = nn.Sequential(
        conv_bn(in_channels, width, 1),
        nn.ReLU(),
        conv_bn(width, width, 3, stride),
        nn.ReLU(),
        conv_bn(width, out_channels, 1),
    )
    return ResidualBlock(branch, in_channels, out_channels, stride)


def out_widths(layers: int, base: int) -> tuple[int, ...]:
    """Channels that each of the four stages puts out."""
    expansion = BOTTLENECK_EXPANSION if layers >= 50 else 1
    return tuple(expansion * base * 2**i for i in range(4))


def resnet_stages(layers: int, base: int) -> nn.ModuleList:
    """The four stages "layer1" to "layer4": (B,base,H,W) -> widths of `out_widths` at 1, 1/2, 1/4, 1/8 of H and W."""
    make_block = bottleneck_block if layers >= 50 else basic_block
    stages, channels = nn.ModuleList(), base
    for index, (blocks, out_channels) in enumerate(zip(BLOCKS[layers], out_widths(layers, base), strict=True)):
        stride = 1 if index == 0 else 2
        chain = [make_block(channels, base * 2**index, stride)]
        chain += [make_block(out_channels, base * 2**index, 1) for _ in range(blocks - 1)]
        stages.append(nn.Sequential(*chain))
        channels = out_channels
    stages.apply(init_fan_out)
    return stages


def init_fan_out(module: nn.Module) -> None:
    """N(0, 2 / (k k c)) with c the channels out (in, for a transposed convolution), as both papers initialise."""
    if isinstance(module, (nn.Conv2d, nn.ConvTranspose2d)):
        nn.init.kaiming_normal_(module.weight, mode="fan_out", nonlinearity="relu")
        if module.bias is not None:
            nn.init.zeros_(module.bias)
