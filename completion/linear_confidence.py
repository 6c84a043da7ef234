"""`MultiScaleConfidence` for inference: the same function, down to confidences of 1e-18, in half of the time.

A layer of normalised convolution gives c' = K c and z' = K(z c) / c' + b, and the next one asks for c' and z' c' alone.
That product is K(z c) + b K c: linear, without a division. So depth is carried as z c beside c, each layer is one
convolution of both, and only the last divides. Where nothing is known both are zero, as they are in the layers.

Four channels leave most of a processor's lanes idle. So all levels but the coarsest are folded: the four pixels of each
2x2 block lie in channels of their own (as `F.pixel_unshuffle` has them), at half the size.
"""

from __future__ import annotations

from itertools import product

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from completion.nconv import DIVISION_GUARD, MultiScaleConfidence, NormalizedConv2d


class LinearConfidence(nn.Module):
    """Sparse depth and its confidence (B,1,H,W) -> dense ones, as the module it is made of; without gradients to it."""

    lift: Tensor
    densify: Tensor
    refine: Tensor
    project: Tensor
    bias: Tensor

    def __init__(self, msc: MultiScaleConfidence) -> None:
        super().__init__()
        self.levels = msc.levels
        for name in ("lift", "densify", "refine"):
            self.register_buffer(name, folded(joint_kernel(getattr(msc, name))))
        self.coarsest = ("densify", "refine") if self.levels == 1 else ("densify",)
        for name in self.coarsest:
            self.register_buffer(f"coarsest_{name}", joint_kernel(getattr(msc, name)))
        for level, merge in enumerate(msc.merge):  # of a finer level's channels, then the coarser one's
            fine, coarse = joint_kernel(merge, groups=2).chunk(2, dim=1)
            kernel = torch.cat([folded(fine), of_repeated(folded(coarse))], dim=1)
            self.register_buffer(f"merge_{level}", kernel.contiguous(memory_format=torch.channels_last))
        self.register_buffer("project", folded(joint_kernel(msc.project, bias=torch.zeros_like(msc.project.bias))))
        self.register_buffer("bias", msc.project.bias.detach().view(1, -1, 1, 1))

    def forward(self, depth: Tensor, confidence: Tensor) -> tuple[Tensor, Tensor]:
        """As `MultiScaleConfidence.forward`."""
        both = F.pixel_unshuffle(torch.cat([confidence, depth * confidence], dim=1), 2)
        pyramid = [_convolved(both, self.lift, self.densify, self.refine)]
        for level in range(1, self.levels):
            both = F.pixel_unshuffle(_pooled(pyramid[-1]), 2)
            pyramid.append(_convolved(both, self.densify, *([self.refine] if level == 1 else [])))
        coarse = _pooled(pyramid[-1])
        coarse = _convolved(coarse, *(getattr(self, f"coarsest_{name}") for name in self.coarsest))
        for level in range(self.levels - 1, -1, -1):
            both = _convolved(torch.cat([pyramid[level], coarse], dim=1), getattr(self, f"merge_{level}"))
            coarse = F.pixel_shuffle(both, 2) if level else both
        known, weighted = _convolved(both, self.project).chunk(2, dim=1)
        dense = weighted / known.clamp_min(DIVISION_GUARD) + self.bias
        return F.pixel_shuffle(dense, 2), F.pixel_shuffle(known, 2)


def joint_kernel(layer: NormalizedConv2d, bias: Tensor | None = None, groups: int = 1) -> Tensor:
    """Kernel (2 out, 2 in, k, k) that takes c and z c to c' and z' c'.

    Its inputs are `groups` groups of channels, each c and then z c of its own. `bias`: instead of the layer's.
    """
    kernel = layer.unit_kernel().detach()
    outputs, inputs = kernel.shape[:2]
    b = (layer.bias if bias is None else bias).detach().view(-1, 1, 1, 1)
    size = inputs // groups
    of_confidence = (torch.arange(inputs).view(groups, size) + size * torch.arange(groups)[:, None]).flatten()
    joint = kernel.new_zeros(2 * outputs, 2 * inputs, *kernel.shape[2:])
    joint[:outputs, of_confidence] = kernel
    joint[outputs:, of_confidence] = b * kernel
    joint[outputs:, of_confidence + size] = kernel
    return joint.contiguous(memory_format=torch.channels_last)


def folded(kernel: Tensor) -> Tensor:
    """A kernel (out,in,k,k) of k = 1, 3 or 5 for folded images: (4 out, 4 in, 1, 1) or (4 out, 4 in, 3, 3)."""
    outputs, inputs, size = kernel.shape[:3]
    reach, blocks = size // 2, 0 if size == 1 else 1
    whole = kernel.new_zeros(outputs, 2, 2, inputs, 2, 2, 2 * blocks + 1, 2 * blocks + 1)
    # Rows from pixel y of one block to pixel t of a block b further on: 2 b + t - y.
    rows = [(b, t, y, 2 * b + t - y) for b, t, y in product(range(-blocks, blocks + 1), (0, 1), (0, 1))]
    for (b, t, y, row), (a, s, x, column) in product(rows, rows):
        if max(abs(row), abs(column)) <= reach:
            whole[:, y, x, :, t, s, b + blocks, a + blocks] = kernel[:, :, row + reach, column + reach]
    return whole.flatten(3, 5).flatten(0, 2).contiguous(memory_format=torch.channels_last)


def of_repeated(kernel: Tensor) -> Tensor:
    """A folded kernel's (out, 4 in, k, k) for blocks of four equal pixels, given as one: (out, in, k, k)."""
    return kernel.unflatten(1, (-1, 4)).sum(dim=2)


def _convolved(both: Tensor, *kernels: Tensor) -> Tensor:
    for kernel in kernels:
        both = F.conv2d(both, kernel, padding=kernel.shape[2] // 2)
    return both


def _pooled(both: Tensor) -> Tensor:
    """`confidence_pool` of folded c and z c, (B,16,h,w) -> (B,4,h,w) unfolded."""
    confidence, product = both.unflatten(1, (2, 2, 4)).unbind(1)
    most, chosen = confidence[:, :, 0], product[:, :, 0]
    for pixel in (1, 2, 3):
        chosen = torch.where(confidence[:, :, pixel] > most, product[:, :, pixel], chosen)
        most = torch.maximum(most, confidence[:, :, pixel])
    return torch.cat([most, chosen], dim=1) / 4
