"""The U-Net for inference in integers of eight bits, which a processor with VNNI multiplies at twice its bfloat16 rate.

After a ReLU every channel c is held as round(x / s_c), cut off at 255, and s_c goes into the next convolution's
weights, so that channels of different reach do not share one step: with one step for all of a layer depth erred by up
to a quarter more. How far a channel reaches is read from its batch normalisation, which gave it the mean beta and the
standard deviation gamma: s_c = (beta + 8 |gamma|) / 255. So no pictures are needed to choose it (Nagel et al.,
"Data-free quantization", ICCV 2019). Weights have 8 bits as well and a step for each output; sums are exact, in 32
bits. The input, the attention and what comes from it, and the last features and the head stay in floating point.
"""

from __future__ import annotations

import copy
from functools import cache
from typing import Any

import numpy as np
import torch
import torch.nn.functional as F
from torch import Tensor, nn

from compiled import compiled
from completion.fused_conv import FusedConvReLU, Layouts, can_fuse
from completion.network import DoubleConv, UNet

# The best of 4, 6, 8, 12 and 16 on 40 rendered frames kept for choosing: fewer cut off too much, more are coarser.
DEVIATIONS = 8.0
LARGEST = 255  # of an unsigned 8-bit integer


@cache
def can_use_eight_bits() -> bool:
    """Whether this processor multiplies 8-bit integers fast, and this PyTorch does so rightly: without VNNI, or with
    oneDNN kept from using it, sums of large values are cut off at 16 bits."""
    supported = getattr(torch.cpu, "_is_vnni_supported", None)
    if not (supported and supported() and can_fuse(torch.float32)):
        return False
    conv = nn.Conv2d(64, 16, 3, device="meta").to_empty(device="cpu").requires_grad_(False)
    conv.weight.fill_(1)
    conv.bias.zero_()  # type: ignore[union-attr]
    try:
        made = EightBitConvReLU(conv, torch.ones(64), torch.ones(16), torch.float32)
        sums = made(torch.full((1, 64, 3, 3), LARGEST, dtype=torch.uint8))
    except (AttributeError, RuntimeError, TypeError):  # a PyTorch without these operators, or with others of the name
        return False
    return bool(torch.allclose(sums, torch.full_like(sums, 9 * 64 * LARGEST)))


class EightBitUNet(nn.Module):
    """(B,in,H,W) -> (B,out,H,W), both in `input_dtype`, nearly as the `UNet` it is made of; H, W as there."""

    def __init__(self, folded: UNet, reaches: list[tuple[Tensor, Tensor]], input_dtype: torch.dtype) -> None:
        """`folded`: with its normalisations folded. `reaches`: of the outputs of both convolutions of each encoder
        block, then of each decoder block (`channel_reaches`)."""
        super().__init__()
        self.input_dtype = input_dtype
        self.attention = folded.attention
        levels = len(folded.encoder)
        steps = [(a / LARGEST, b / LARGEST) for a, b in reaches]
        outputs = [torch.uint8] * (2 * levels - 1)  # of each block, the encoder's first
        for index, dtype in ((levels - 1, torch.float32), (-1, input_dtype)):
            # The deepest features and the last stay in floating point, in their own unit.
            steps[index] = steps[index][0], torch.ones_like(steps[index][1])
            outputs[index] = dtype
        inputs = [None, *(b for _, b in steps[: levels - 1]), None]  # of each block; None: in floating point
        inputs += [torch.cat([steps[levels - 2 - i][1], steps[levels - 1 + i][1]]) for i in range(1, levels - 1)]
        blocks = zip([*folded.encoder, *folded.decoder], inputs, steps, outputs, strict=True)
        made = [_eight_bit_block(block, given, step, out, input_dtype) for block, given, step, out in blocks]
        self.encoder, self.decoder = nn.ModuleList(made[:levels]), nn.ModuleList(made[levels:])
        self.register_buffer("deepest_skip_step", steps[levels - 2][1].view(1, -1, 1, 1).to(input_dtype))
        self.head = folded.head.to(input_dtype)

    def forward(self, x: Tensor) -> Tensor:
        skips = []
        for level, block in enumerate(self.encoder):
            x = block(_halved(x) if level else x)
            skips.append(x)
        x = F.interpolate(self.attention(skips.pop()), scale_factor=2, mode="bilinear", align_corners=False)
        skip = skips.pop().to(self.input_dtype) * self.deepest_skip_step
        x = self.decoder[0](torch.cat([skip, x.to(self.input_dtype)], dim=1))
        for block in list(self.decoder)[1:]:
            x = block(beside_doubled(skips.pop(), x))
        return self.head(x)


class EightBitConvReLU(nn.Module):
    """ReLU of a convolution of 8-bit integers (B,in,H,W), in steps of `outputs` (out,) and of the type asked for."""

    scale: Tensor
    zero: Tensor
    weight: Tensor
    bias: Tensor

    def __init__(self, conv: nn.Conv2d, inputs: Tensor, outputs: Tensor, dtype: torch.dtype) -> None:
        """`inputs` (in,), `outputs` (out,): the step of each channel of what goes in and comes out."""
        super().__init__()
        weight = conv.weight.detach().float() * inputs.view(1, -1, 1, 1) / outputs.view(-1, 1, 1, 1)
        scale = (weight.abs().amax(dim=(1, 2, 3)) / 127).clamp_min(1e-12)
        integers = (weight / scale.view(-1, 1, 1, 1)).round().to(torch.int8)
        self.register_buffer("scale", scale)
        self.register_buffer("zero", torch.zeros(len(scale), dtype=torch.int32))
        self.register_buffer("weight", integers.contiguous(memory_format=torch.channels_last))
        assert conv.bias is not None, "a folded convolution has a bias"
        self.register_buffer("bias", conv.bias.detach().float() / outputs)
        self.dtype = dtype
        self._shape: Any = [list(conv.stride), list(conv.padding), list(conv.dilation), conv.groups]
        self._layouts = Layouts()

    def forward(self, x: Tensor) -> Tensor:
        weight = self._layouts.of(x, self._laid_out)
        given = x, 1.0, 0, weight, self.scale, self.zero, self.bias, *self._shape
        return torch.ops.onednn.qconv_pointwise(*given, 1.0, 0, self.dtype, "relu", [], "")

    def _laid_out(self, shape: list[int]) -> Tensor:
        return torch.ops.onednn.qconv_prepack(self.weight, self.scale, 1.0, 0, *self._shape, shape)


class RoundedConvReLU(nn.Module):
    """ReLU of a convolution in floating point, rounded to 8-bit integers in steps of `outputs` (out,)."""

    def __init__(self, conv: nn.Conv2d, outputs: Tensor, dtype: torch.dtype) -> None:
        super().__init__()
        scaled = copy.deepcopy(conv)
        with torch.no_grad():
            scaled.weight /= outputs.view(-1, 1, 1, 1)
            scaled.bias /= outputs  # type: ignore[operator]
        self.conv = FusedConvReLU(scaled.to(dtype, memory_format=torch.channels_last))

    def forward(self, x: Tensor) -> Tensor:
        return self.conv(x).clamp_(max=LARGEST).round_().to(torch.uint8)


def channel_reaches(unet: UNet) -> list[tuple[Tensor, Tensor]]:
    """How far each channel goes after the first and second ReLU of each encoder block, then of each decoder block.

    `unet`: with its normalisations as they were trained, not folded.
    """
    blocks = [*unet.encoder, *unet.decoder]
    return [(_reach(block[1]), _reach(block[4])) for block in blocks]  # type: ignore[index,arg-type]


def _reach(norm: nn.BatchNorm2d) -> Tensor:
    mean, deviation = norm.bias.detach().float(), norm.weight.detach().float().abs()
    return (mean + DEVIATIONS * deviation).clamp_min(1e-3)  # a channel that is never above zero has a step all the same


def _eight_bit_block(
    block: DoubleConv, inputs: Tensor | None, steps: tuple[Tensor, Tensor], output: torch.dtype, dtype: torch.dtype
) -> nn.Sequential:
    first, second = block[0], block[3]
    assert isinstance(first, nn.Conv2d)
    assert isinstance(second, nn.Conv2d)
    rounded: nn.Module
    if inputs is None:
        rounded = RoundedConvReLU(first, steps[0], dtype)
    else:
        rounded = EightBitConvReLU(first, inputs, steps[0], torch.uint8)
    return nn.Sequential(rounded, EightBitConvReLU(second, *steps, output))


def _halved(x: Tensor) -> Tensor:
    """Greatest of each 2x2 block, which PyTorch's own pooling does not find of 8-bit integers in channels_last."""
    rows = torch.maximum(x[..., ::2, :], x[..., 1::2, :])
    return torch.maximum(rows[..., ::2], rows[..., 1::2])


def beside_doubled(skip: Tensor, coarse: Tensor) -> Tensor:
    """Channels of `skip` (B,S,2h,2w) and, after them, those of `coarse` (B,C,h,w) enlarged as by `F.interpolate` with
    "bilinear", rounded half up: all 8-bit integers. PyTorch's own enlarging of such is a quarter too high in the mean.
    """
    batch, channels, height, width = coarse.shape
    both = skip.new_empty((batch, 2 * height, 2 * width, skip.shape[1] + channels))
    word = np.uint8 if skip.shape[1] % 8 or channels % 8 else np.uint64  # eight channels are copied at once
    sides = np.empty((2, width * channels), np.uint8)
    for frame in range(batch):
        into, fine, given = (
            x.permute(1, 2, 0).numpy() for x in (both[frame].permute(2, 0, 1), skip[frame], coarse[frame])
        )
        words = sides.view(word).reshape(2, width, -1)
        fill_beside_doubled(into.view(word), fine.view(word), given.reshape(height, -1), sides, words)
    return both.permute(0, 3, 1, 2)


@compiled
def fill_beside_doubled(out, skip, coarse, sides, words):  # type: ignore[no-untyped-def]
    """Fill `out` (2h,2w,s+c) with `skip` (2h,2w,s) and the bytes of `coarse` (h,w*C) enlarged, in words of one or of
    eight bytes; `sides` (2,w*C) and `words` (2,w,c) are the same memory, for the pixels of even and of odd columns."""
    channels = coarse.shape[1] // words.shape[1]
    tall = np.empty(coarse.shape[1] + 2 * channels, np.uint16)  # a row between two, 4 times its value, and its ends
    inner = tall[channels:-channels]
    for row in range(len(out)):
        near, far = row // 2, row // 2 + (1 if row % 2 else -1)
        weigh(inner, coarse[near], coarse[min(max(far, 0), len(coarse) - 1)])
        tall[:channels], tall[-channels:] = inner[:channels], inner[-channels:]
        weigh_and_round(sides[0], inner, tall[: -2 * channels])
        weigh_and_round(sides[1], inner, tall[2 * channels :])
        for column in range(out.shape[1]):
            for word in range(skip.shape[2]):
                out[row, column, word] = skip[row, column, word]
            for word in range(words.shape[2]):
                out[row, column, skip.shape[2] + word] = words[column % 2, column // 2, word]


@compiled
def weigh(out, near, far):  # type: ignore[no-untyped-def]
    """4 times what lies a quarter of the way from the bytes `near` to `far`. By itself, and in 16 bits, it is done in
    as many bytes at once as the processor has lanes."""
    for i in range(len(out)):
        out[i] = np.uint16(3) * np.uint16(near[i]) + np.uint16(far[i])


@compiled
def weigh_and_round(out, near, far):  # type: ignore[no-untyped-def]
    """What lies a quarter of the way from `near` to `far`, both 4 times their value."""
    for i in range(len(out)):
        out[i] = np.uint8((np.uint16(3) * near[i] + far[i] + np.uint16(8)) >> np.uint16(4))
