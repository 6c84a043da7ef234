"""Pairs of 3x3 convolutions for a U-Net whose normalisation is a choice: none, or one of three to compare with none.

The networks of the paper's source for its normalised convolution (Eldesokey et al., TPAMI 2020, released code) have
no normalisation. `MSCSANet` takes one of these by name; `mscsa.DoubleConv` is the block of the shipped network.
"""

from collections.abc import Callable

import torch.nn.functional as F
from torch import Tensor, nn

SLOPE = 0.1  # of the LeakyReLU
FREEZE_AFTER = 200  # training batches, of `FrozenBatchNorm2d`


class FrozenBatchNorm2d(nn.BatchNorm2d):
    """Batch normalisation that stops using the batch: (B,C,H,W) -> (B,C,H,W).

    From the `FREEZE_AFTER`-th training batch on it normalises by its running mean and variance in training too, and
    no longer changes them. It is then a fixed affine map of each channel with a learnt gain and offset.
    """

    waits_for_gpu = True  # for the number of batches

    def forward(self, x: Tensor) -> Tensor:
        assert self.num_batches_tracked is not None
        if self.training and int(self.num_batches_tracked) < FREEZE_AFTER:
            return super().forward(x)
        return F.batch_norm(x, self.running_mean, self.running_var, self.weight, self.bias, False, 0.0, self.eps)


# Name of a normalisation: the layer for so many channels. "frame" normalises each frame by itself, over all channels
# and pixels (group normalisation with one group).
NORMALISATIONS: dict[str, Callable[[int], nn.Module]] = {
    "none": lambda channels: nn.Identity(),
    "batch-leaky": nn.BatchNorm2d,
    "frozen": FrozenBatchNorm2d,
    "frame": lambda channels: nn.GroupNorm(1, channels),
}


class LeakyDoubleConv(nn.Sequential):
    """Two 3x3 convolutions, each with a normalisation of `NORMALISATIONS` and LeakyReLU, (B,in,H,W) -> (B,out,H,W).

    Weights start by He et al. (ICCV 2015) for this slope, so that the variance of the features stays as it is from
    layer to layer without any normalisation; biases start at zero.
    """

    def __init__(self, in_channels: int, out_channels: int, norm: str) -> None:
        layers: list[nn.Module] = []
        for channels in (in_channels, out_channels):
            conv = nn.Conv2d(channels, out_channels, 3, padding=1)
            start_by_he(conv, SLOPE)
            layers += [conv, NORMALISATIONS[norm](out_channels), nn.LeakyReLU(SLOPE, inplace=True)]
        super().__init__(*layers)


def start_by_he(conv: nn.Conv2d, slope: float, bias: float = 0.0) -> None:
    """Normal weights whose variance keeps that of the features behind a LeakyReLU of this slope; a constant bias."""
    nn.init.kaiming_normal_(conv.weight, a=slope)
    assert conv.bias is not None
    nn.init.constant_(conv.bias, bias)
