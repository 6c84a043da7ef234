"""`mscsa_sfm_kernels` as compiled loops, for inference on a CPU.

In PyTorch they are a hundred small operations, each a pass over the whole frame. Images are float32.
"""

from __future__ import annotations

import math

import cv2
import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from completion.networks.cpu.numba_normalized_conv import LinearConfidence, rows
from completion.networks.mscsa_sfm_kernels import (
    LEAST_TRUST,
    LOG_ERROR_RANGE,
    STRIDE,
    Anchor,
    Kernels,
    double,
    image_inputs,
)
from haustra.core.numba_cache import compiled

# Arguments of the loops, not globals: numba's cache would not notice a change in the other file.
GUARD = np.float32(LEAST_TRUST)
ERROR_BOUNDS = np.array(LOG_ERROR_RANGE, np.float32)
LEVELS = torch.arange(256) / 255  # intensity in [0,1] of an 8-bit value
TABLES = torch.stack([*3 * [LEVELS - 0.5], torch.log(LEVELS + 1 / 255)]).numpy()  # red, green, blue and brightness


class CompiledAnchor(nn.Module):
    """`Anchor` that evaluates the estimate only at the points' pixels."""

    def __init__(self, anchor: Anchor) -> None:
        super().__init__()
        self.msc = LinearConfidence(anchor.msc)
        self.log_tolerance = np.float32(anchor.log_tolerance.item())

    def forward(self, log_depth: Tensor, log_error: Tensor, log_sparse: Tensor, trust: Tensor, gate: Tensor) -> Tensor:
        """As `Anchor.forward`."""
        halves = _halves(log_depth)
        values, weights = (half.numpy()[:, 0] for half in halves)
        estimate, points = (rows(log_depth), rows(log_error)), (rows(log_sparse), rows(trust))
        fill_disagreement(*estimate, *points, self.log_tolerance, GUARD, values, weights)
        correction, _ = self.msc(*halves)
        return double(torch.sigmoid(gate) * correction)


def folded_image(rgb: Tensor) -> Tensor:
    """`image_inputs`, by tables for 8-bit images (B,3,H,W)."""
    return image_planes(rgb.permute(0, 2, 3, 1).numpy()) if rgb.dtype == torch.uint8 else image_inputs(rgb)


def image_planes(rgb: NDArray[np.uint8]) -> Tensor:
    """`image_inputs` of images (B,H,W,3)."""
    around = [(0, 0), *((0, -side % STRIDE) for side in rgb.shape[1:3])]
    planes = [[*cv2.split(frame), np.maximum.reduce(cv2.split(frame))] for frame in rgb]
    padded = np.pad(planes, [*around[:1], (0, 0), *around[1:]], mode="edge")
    out = np.empty((len(rgb), 16, padded.shape[2] // 2, padded.shape[3] // 2), np.float32)
    fill_image(padded, TABLES, out)
    return torch.from_numpy(out)


def halved_points(values: Tensor, trust: Tensor) -> tuple[Tensor, Tensor]:
    """As `halve_points`."""
    halves = _halves(values)
    fill_halves(rows(values), rows(trust), GUARD, *(half.numpy()[:, 0] for half in halves))
    return halves


def recurrent_inputs(log_depth: Tensor, log_error: Tensor, nconv_depth: Tensor) -> Tensor:
    """As `mscsa_sfm_kernels.recurrent_inputs`."""
    batch, _, height, width = log_depth.shape
    channels = torch.empty(batch, 5, height // 2, width // 2)
    share = np.float32(-1 / (4 * LOG_ERROR_RANGE[0]))
    fill_recurrent_inputs(rows(log_depth), rows(log_error), rows(nconv_depth), share, channels.numpy())
    return channels


def unfolded(out: Tensor, nconv_depth: Tensor) -> tuple[Tensor, Tensor]:
    """As `unfold`."""
    log_depth, log_error = torch.empty_like(nconv_depth), torch.empty_like(nconv_depth)
    given = np.ascontiguousarray(out.permute(0, 2, 3, 1).numpy())
    fill_unfolded(given, rows(nconv_depth), ERROR_BOUNDS, log_depth.numpy()[:, 0], log_error.numpy()[:, 0])
    return log_depth, log_error


COMPILED = Kernels(folded_image, halved_points, recurrent_inputs, unfolded)


def _halves(image: Tensor) -> tuple[Tensor, Tensor]:
    batch, _, height, width = image.shape
    values, trust = torch.empty(2, batch, 1, height // 2, width // 2)
    return values, trust


@compiled
def fill_image(planes, tables, out):  # type: ignore[no-untyped-def]
    """Look up 8-bit planes (B,C,H,W) in `tables` (C,256), each pixel of a 2x2 block a channel: out (B,4C,H/2,W/2)."""
    for frame in range(len(out)):
        for channel in range(out.shape[1]):
            source, pixel = planes[frame, channel // 4], channel % 4
            for row in range(out.shape[2]):
                look_up(out[frame, channel, row], tables[channel // 4], source[2 * row + pixel // 2], pixel % 2)


@compiled
def look_up(out, table, source, first):  # type: ignore[no-untyped-def]
    """out[i] = table[source[2 i + first]], of a row."""
    for i in range(len(out)):
        out[i] = table[source[2 * i + first]]


@compiled
def fill_halves(values, trust, guard, half_values, half_trust):  # type: ignore[no-untyped-def]
    """Mean of each 2x2 block of (B,H,W), weighted by trust, and the block's greatest trust."""
    for frame in range(len(values)):
        for row in range(half_values.shape[1]):
            above, below = trust[frame, 2 * row], trust[frame, 2 * row + 1]
            halve_rows(
                values[frame, 2 * row], values[frame, 2 * row + 1], above, below, guard,
                half_values[frame, row], half_trust[frame, row],
            )  # fmt: skip


@compiled
def halve_rows(a, b, trust_a, trust_b, guard, mean, most):  # type: ignore[no-untyped-def]
    """One row of blocks; a separate function so that LLVM vectorises the loop."""
    for i in range(len(mean)):
        w, x, y, z = trust_a[2 * i], trust_a[2 * i + 1], trust_b[2 * i], trust_b[2 * i + 1]
        weighted = a[2 * i] * w + a[2 * i + 1] * x + b[2 * i] * y + b[2 * i + 1] * z
        mean[i] = weighted / max(w + x + y + z, guard)
        most[i] = max(max(w, x), max(y, z))


@compiled
def fill_recurrent_inputs(log_depth, log_error, nconv_depth, share, channels):  # type: ignore[no-untyped-def]
    """Channels (B,5,H/2,W/2): log_depth - nconv_depth of each pixel of 2x2 blocks, `share` * sum of the log errors."""
    for frame in range(len(channels)):
        for row in range(channels.shape[2]):
            channels[frame, 4, row] = 0
            for pixel in range(4):
                whole = 2 * row + pixel // 2
                subtract_every_second(
                    channels[frame, pixel, row], log_depth[frame, whole], nconv_depth[frame, whole], pixel % 2
                )
                add_every_second(channels[frame, 4, row], log_error[frame, whole], share, pixel % 2)


@compiled
def subtract_every_second(out, a, b, first):  # type: ignore[no-untyped-def]
    """out[i] = a[2 i + first] - b[2 i + first], of a row."""
    for i in range(len(out)):
        out[i] = a[2 * i + first] - b[2 * i + first]


@compiled
def add_every_second(out, a, factor, first):  # type: ignore[no-untyped-def]
    """out[i] += factor * a[2 i + first], of a row."""
    for i in range(len(out)):
        out[i] += factor * a[2 * i + first]


@compiled
def fill_unfolded(out, nconv_depth, bounds, log_depth, log_error):  # type: ignore[no-untyped-def]
    """U-Net output (B,h,w,9): 4 residuals, 4 log errors, a gate of each 2x2 block -> depth and error (B,2h,2w)."""
    lowest, highest = bounds
    for frame in range(len(out)):
        for row in range(nconv_depth.shape[1]):
            given, pixel = out[frame, row // 2], 2 * (row % 2)
            base, depth, error = nconv_depth[frame, row], log_depth[frame, row], log_error[frame, row]
            for column in range(len(given)):
                for side in range(2):
                    depth[2 * column + side] = base[2 * column + side] + given[column, pixel + side]
                    error[2 * column + side] = min(max(given[column, 4 + pixel + side], lowest), highest)


@compiled
def fill_disagreement(log_depth, log_error, log_sparse, trust, log_tolerance, guard, values, weights):  # type: ignore[no-untyped-def]
    """`fill_halves` of log_sparse - log_depth at the points, trust multiplied by Cauchy's weight of that difference."""
    total = np.empty(values.shape[2], np.float32)
    for frame in range(len(values)):
        for row in range(values.shape[1]):
            weighted, most = values[frame, row], weights[frame, row]
            weighted[:], most[:], total[:] = 0, 0, 0
            for whole in range(2 * row, 2 * row + 2):
                here = trust[frame, whole]
                for column in range(len(here)):
                    if here[column] > 0:
                        off = log_sparse[frame, whole, column] - log_depth[frame, whole, column]
                        surprise = off * np.float32(math.exp(-log_error[frame, whole, column] - log_tolerance))
                        weight = here[column] / (np.float32(1) + surprise * surprise)
                        weighted[column // 2] += off * weight
                        total[column // 2] += weight
                        most[column // 2] = max(most[column // 2], weight)
            divide(weighted, total, guard)


@compiled
def divide(row, by, guard):  # type: ignore[no-untyped-def]
    """row /= max(by, guard), of a row, in place."""
    for i in range(len(row)):
        row[i] /= max(by[i], guard)
