"""Convolutions for inference on a CPU: with their ReLU in one pass, and with weights laid out once, not each time.

Both are oneDNN's, by the operators that PyTorch's own compiler puts in their place. Those have no public name, so where
a version of PyTorch or a processor lacks them the network stays as it is: the same function, a sixth slower.
"""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor, nn

from completion.network import DoubleConv

SHAPES = 4  # of the input, whose layouts of the weights are kept


class FusedConvReLU(nn.Module):
    """ReLU of a convolution (B,in,H,W) -> (B,out,H,W), on a CPU and without gradients."""

    def __init__(self, conv: nn.Conv2d) -> None:
        super().__init__()
        self.conv = conv
        self._shape: Any = [list(conv.padding), list(conv.stride), list(conv.dilation), conv.groups]
        self._laid_out: dict[tuple[int, ...], Tensor] = {}

    def forward(self, x: Tensor) -> Tensor:
        weight = self._laid_out_for(tuple(x.shape))
        return torch.ops.mkldnn._convolution_pointwise(x, weight, self.conv.bias, *self._shape, "relu", [], "")

    def _laid_out_for(self, shape: tuple[int, ...]) -> Tensor:
        """Which layout oneDNN wants depends on the picture: given another, it makes it anew in every call, which took
        up to 200 times as long as the convolution of a small one."""
        if shape not in self._laid_out:
            if len(self._laid_out) == SHAPES:
                self._laid_out.pop(next(iter(self._laid_out)))
            plain = self.conv.weight.detach().to_mkldnn()
            self._laid_out[shape] = torch._C._nn.mkldnn_reorder_conv2d_weight(plain, *self._shape, list(shape))
        return self._laid_out[shape]

    def __getstate__(self) -> dict[str, Any]:
        return self.__dict__ | {"_laid_out": {}}  # layouts can't be copied


def can_fuse(dtype: torch.dtype) -> bool:
    """Whether this PyTorch and this processor have what `FusedConvReLU` needs."""
    reorder = hasattr(torch._C._nn, "mkldnn_reorder_conv2d_weight")
    if not (torch.backends.mkldnn.is_available() and reorder and hasattr(torch.ops.mkldnn, "_convolution_pointwise")):
        return False
    return dtype != torch.bfloat16 or torch.ops.mkldnn._is_mkldnn_bf16_supported()


def fuse_convolutions(network: nn.Module) -> None:
    """Replace, in place, the convolutions and ReLUs of every `DoubleConv` whose normalisation is folded already."""
    for block in network.modules():
        if isinstance(block, DoubleConv):
            for index in (0, 3):
                block[index] = FusedConvReLU(block[index])  # type: ignore[arg-type]
                block[index + 2] = nn.Identity()
