"""The U-Net for inference in integers of eight bits, which a processor with VNNI multiplies at twice its bfloat16 rate.

After a ReLU every channel c is held as round(x / s_c), cut off at 255, and s_c goes into the next convolution's
weights, so that channels of different reach do not share one step: with one step for all of a layer depth erred by up
to a quarter more. How far a channel reaches is read from its batch normalisation, which gave it the mean beta and the
standard deviation gamma: s_c = (beta + 8 |gamma|) / 255. So no pictures are needed to choose it (Nagel et al.,
"Data-free quantization", ICCV 2019). What has a sign, the input and what comes from the attention, is held as 128 and
steps from there. Weights have 8 bits as well and a step for each output; sums are exact, in 32 bits. The attention, the
last features and the head stay in floating point.
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
from completion.fused_conv import Layouts, can_fuse
from completion.network import UNet

# The best of 4, 6, 8, 12 and 16 on 40 rendered frames kept for choosing: fewer cut off too much, more are coarser.
DEVIATIONS = 8.0
LARGEST = 255  # of an unsigned 8-bit integer
MIDDLE, REACH = 128, 127  # zero of what has a sign, and the most steps from there
# Of a step, in which the rest of a fine channel is given. More parts leave their weights too few of their own;
# as good as 8 on those frames, better than 16.
PARTS = 4
HALF_UP, NONE, MOST = np.float32(MIDDLE + 0.5), np.float32(0), np.float32(LARGEST)


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
        for zero in (0, MIDDLE):
            made = EightBitConvReLU(conv, torch.ones(64), torch.ones(16), torch.float32, zero)
            sums = made(torch.full((1, 64, 3, 3), LARGEST, dtype=torch.uint8))
            if not torch.allclose(sums, torch.full_like(sums, 9 * 64 * (LARGEST - zero))):
                return False
    except (AttributeError, RuntimeError, TypeError):  # a PyTorch without these operators, or with others of the name
        return False
    return True


class EightBitUNet(nn.Module):
    """(B,in,H,W) float32 -> (B,out,H,W), nearly as the `UNet` it is made of; H, W as there."""

    input_dtype = torch.float32
    input_reaches: Tensor
    deepest: Tensor

    def __init__(
        self,
        folded: UNet,
        reaches: list[tuple[Tensor, Tensor]],
        input_reaches: Tensor,
        fine: tuple[int, ...],
        dtype: torch.dtype,
    ) -> None:
        """`folded`: with its normalisations folded. `reaches`: of the outputs of both convolutions of each encoder
        block, then of each decoder block (`channel_reaches`). `input_reaches` (in,): where the input is cut off on both
        sides of zero; `fine`: channels of it whose rest is given too. `dtype`: of the last features and the head.
        """
        super().__init__()
        self.attention = folded.attention
        self.fine = np.array(fine, dtype=np.int64)
        self.register_buffer("input_reaches", input_reaches)
        levels = len(folded.encoder)
        steps = [(a / LARGEST, b / LARGEST) for a, b in reaches]
        outputs = [torch.uint8] * (2 * levels - 1)  # of each block, the encoder's first
        for index, output in ((levels - 1, torch.float32), (-1, dtype)):
            # The deepest features and the last stay in floating point, in their own unit.
            steps[index] = steps[index][0], torch.ones_like(steps[index][1])
            outputs[index] = output
        deepest = torch.cat([reaches[levels - 2][1], reaches[levels - 1][1]]) / REACH
        inputs = [with_rests(input_reaches / REACH, fine), *(b for _, b in steps[: levels - 1]), deepest]
        inputs += [torch.cat([steps[levels - 2 - i][1], steps[levels - 1 + i][1]]) for i in range(1, levels - 1)]
        blocks = [*folded.encoder, *folded.decoder]
        convolutions = [(block[0], block[3]) for block in blocks]  # type: ignore[index]
        convolutions[0] = taking_rests(convolutions[0][0], fine), convolutions[0][1]
        made = [
            nn.Sequential(
                EightBitConvReLU(first, given, step[0], torch.uint8, MIDDLE if index in (0, levels) else 0),
                EightBitConvReLU(second, *step, output),
            )
            for index, ((first, second), given, step, output) in enumerate(
                zip(convolutions, inputs, steps, outputs, strict=True)
            )
        ]
        self.encoder, self.decoder = nn.ModuleList(made[:levels]), nn.ModuleList(made[levels:])
        # Of the features beside the deepest, in the steps of what comes from there; and of those.
        skips = steps[levels - 2][1]
        self.register_buffer("deepest", torch.cat([skips, torch.ones(len(deepest) - len(skips))]) / deepest)
        self.head = folded.head.to(dtype)

    def forward(self, x: Tensor) -> Tensor:
        x, skips = self._rounded(x), []
        for level, block in enumerate(self.encoder):
            x = block(_halved(x) if level else x)
            skips.append(x)
        x = F.interpolate(self.attention(skips.pop()), scale_factor=2, mode="bilinear", align_corners=False)
        both = torch.cat([skips.pop().float(), x], dim=1) * self.deepest.view(1, -1, 1, 1)
        x = both.add_(MIDDLE + 0.5).clamp_(0, LARGEST).to(torch.uint8, memory_format=torch.channels_last)
        x = self.decoder[0](x)
        for block in list(self.decoder)[1:]:
            x = block(beside_doubled(skips.pop(), x))
        return self.head(x)

    def _rounded(self, x: Tensor) -> Tensor:
        """The input in 8 bits, and after it the rest of its fine channels."""
        batch, channels, height, width = x.shape
        out = torch.empty((batch, height, width, channels + len(self.fine)), dtype=torch.uint8)
        fill_rounded(x.contiguous().numpy(), (REACH / self.input_reaches).numpy(), self.fine, out.numpy())
        return out.permute(0, 3, 1, 2)


def with_rests(steps: Tensor, fine: tuple[int, ...]) -> Tensor:
    """Steps (in,) of the input and of the rests."""
    return torch.cat([steps, steps[list(fine)] / PARTS])


def taking_rests(conv: nn.Conv2d, fine: tuple[int, ...]) -> nn.Conv2d:
    """A convolution that takes the rests too, with the weights of that of which they are."""
    made = copy.deepcopy(conv)
    made.weight = nn.Parameter(torch.cat([conv.weight, conv.weight[:, list(fine)]], dim=1), requires_grad=False)
    made.in_channels += len(fine)
    return made


class EightBitConvReLU(nn.Module):
    """ReLU of a convolution of 8-bit integers (B,in,H,W), in steps of `outputs` (out,) and of the type asked for."""

    scale: Tensor
    zero: Tensor
    weight: Tensor
    bias: Tensor

    def __init__(
        self, conv: nn.Conv2d, inputs: Tensor, outputs: Tensor, dtype: torch.dtype, zero_point: int = 0
    ) -> None:
        """`inputs` (in,), `outputs` (out,): the step of each channel of what goes in and comes out. `zero_point`: the
        integer that stands for zero in what goes in."""
        super().__init__()
        weight = conv.weight.detach().float() * inputs.view(1, -1, 1, 1) / outputs.view(-1, 1, 1, 1)
        scale = (weight.abs().amax(dim=(1, 2, 3)) / 127).clamp_min(1e-12)
        integers = (weight / scale.view(-1, 1, 1, 1)).round().to(torch.int8)
        self.register_buffer("scale", scale)
        self.register_buffer("zero", torch.zeros(len(scale), dtype=torch.int32))
        self.register_buffer("weight", integers.contiguous(memory_format=torch.channels_last))
        assert conv.bias is not None, "a folded convolution has a bias"
        self.register_buffer("bias", conv.bias.detach().float() / outputs)
        self.dtype, self.zero_point = dtype, zero_point
        self._shape: Any = [list(conv.stride), list(conv.padding), list(conv.dilation), conv.groups]
        self._layouts = Layouts()

    def forward(self, x: Tensor) -> Tensor:
        weight = self._layouts.of(x, self._laid_out)
        given = x, 1.0, self.zero_point, weight, self.scale, self.zero, self.bias, *self._shape
        return torch.ops.onednn.qconv_pointwise(*given, 1.0, 0, self.dtype, "relu", [], "")

    def _laid_out(self, shape: list[int]) -> Tensor:
        return torch.ops.onednn.qconv_prepack(self.weight, self.scale, 1.0, self.zero_point, *self._shape, shape)


def channel_reaches(unet: UNet) -> list[tuple[Tensor, Tensor]]:
    """How far each channel goes after the first and second ReLU of each encoder block, then of each decoder block.

    `unet`: with its normalisations as they were trained, not folded.
    """
    blocks = [*unet.encoder, *unet.decoder]
    return [(_reach(block[1]), _reach(block[4])) for block in blocks]  # type: ignore[index,arg-type]


def _reach(norm: nn.BatchNorm2d) -> Tensor:
    mean, deviation = norm.bias.detach().float(), norm.weight.detach().float().abs()
    return (mean + DEVIATIONS * deviation).clamp_min(1e-3)  # a channel that is never above zero has a step all the same


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


@compiled
def fill_rounded(x, per_unit, fine, out):  # type: ignore[no-untyped-def]
    """x (B,C,h,w), in `per_unit` (C,) steps from the middle, and the rest of the channels `fine` -> out (B,h,w,C+F)."""
    frames, channels, height, width = x.shape
    rows = np.empty((out.shape[3], width), np.uint8)
    for frame in range(frames):
        for row in range(height):
            for channel in range(channels):
                round_row(x[frame, channel, row], per_unit[channel], rows[channel])
            for i in range(len(fine)):
                rest_of_row(x[frame, fine[i], row], per_unit[fine[i]], rows[fine[i]], rows[channels + i])
            for column in range(width):
                for channel in range(len(rows)):
                    out[frame, row, column, channel] = rows[channel, column]


@compiled
def round_row(x, per_unit, out):  # type: ignore[no-untyped-def]
    """A row (w,) in steps from the middle."""
    for i in range(len(x)):
        out[i] = np.uint8(min(max(x[i] * per_unit + HALF_UP, NONE), MOST))


@compiled
def rest_of_row(x, per_unit, rounded, out):  # type: ignore[no-untyped-def]
    """What `rounded` leaves of it, in parts of a step."""
    for i in range(len(x)):
        rest = x[i] * per_unit + np.float32(MIDDLE) - np.float32(rounded[i])
        out[i] = np.uint8(min(max(rest * np.float32(PARTS) + HALF_UP, NONE), MOST))
