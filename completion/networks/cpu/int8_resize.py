"""Quantization to uint8 and bilinear upsampling of uint8 as compiled loops, for `int8_unet`."""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor

from haustra.core.numba_cache import compiled

LARGEST, MIDDLE = 255, 128  # of uint8; the zero point of signed tensors
WORD = 4  # channels (bytes) that are written at once
HALF_UP, NONE, MOST = np.float32(MIDDLE + 0.5), np.float32(0), np.float32(LARGEST)


def words_of(images: list[Tensor], per_unit: list[float]) -> Tensor:
    """C images (B,H,W) float32, C a multiple of `WORD` -> (B,C,H,W) uint8: round(image * per_unit) + 128, clipped."""
    batch, height, width = images[0].shape
    out = np.empty((batch, height, width, len(images) // WORD), np.uint32)
    for word in range(out.shape[3]):
        four = slice(WORD * word, WORD * (word + 1))
        a, b, c, d = (np.ascontiguousarray(image.numpy()) for image in images[four])
        fill_words(a, b, c, d, np.array(per_unit[four], np.float32), out[..., word])
    return torch.from_numpy(out.view(np.uint8)).permute(0, 3, 1, 2)


def beside_doubled(skip: Tensor, coarse: Tensor) -> Tensor:
    """`skip` (B,S,2h,2w) and `coarse` (B,C,h,w) doubled bilinearly, rounded half up -> (B,S+C,2h,2w), uint8.

    PyTorch's own interpolation of uint8 is a quarter too large.
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
    """Fill `out` (2h,2w,s+c) with `skip` (2h,2w,s) and the doubled bytes of `coarse` (h,w*C), in words of one or eight
    bytes; `sides` (2,w*C) and `words` (2,w,c) are one buffer, for the pixels of even and of odd columns."""
    channels = coarse.shape[1] // words.shape[1]
    tall = np.empty(coarse.shape[1] + 2 * channels, np.uint16)  # 4 times the interpolated row, its ends repeated
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
    """out = 3 near + far, of uint8 rows, in uint16. One row; a separate function so that LLVM vectorises the loop."""
    for i in range(len(out)):
        out[i] = np.uint16(3) * np.uint16(near[i]) + np.uint16(far[i])


@compiled
def weigh_and_round(out, near, far):  # type: ignore[no-untyped-def]
    """out = (3 near + far + 8) / 16, of uint16 rows, to uint8: bilinear weights 1/4 and 3/4 on both axes, rounded."""
    for i in range(len(out)):
        out[i] = np.uint8((np.uint16(3) * near[i] + far[i] + np.uint16(8)) >> np.uint16(4))


@compiled
def fill_words(a, b, c, d, per_unit, out):  # type: ignore[no-untyped-def]
    """Quantize four images (B,h,w) by `per_unit` (4,) into the four bytes of `out` (B,h,w) uint32."""
    words = np.empty(a.shape[2], np.uint32)
    for frame in range(len(a)):
        for row in range(a.shape[1]):
            fill_row(a[frame, row], b[frame, row], c[frame, row], d[frame, row], per_unit, words)
            for column in range(len(words)):
                out[frame, row, column] = words[column]


@compiled
def fill_row(a, b, c, d, per_unit, words):  # type: ignore[no-untyped-def]
    """One row; a separate function so that LLVM vectorises the loop."""
    of_a, of_b, of_c, of_d = per_unit
    for i in range(len(words)):
        first, second = to_uint8(a[i] * of_a), to_uint8(b[i] * of_b)
        third, fourth = to_uint8(c[i] * of_c), to_uint8(d[i] * of_d)
        words[i] = first | second << np.uint32(8) | third << np.uint32(16) | fourth << np.uint32(24)


@compiled
def to_uint8(steps):  # type: ignore[no-untyped-def]
    """round(steps) + 128, clipped to 0..255; steps must be finite."""
    return np.uint32(min(max(steps + HALF_UP, NONE), MOST))
