"""`MultiScaleConfidence` as compiled loops for inference on a CPU: equal up to rounding, for confidences over 1e-16.

A layer of normalised convolution gives c' = K c and z' = K(z c) / c' + b, and the next one needs only c' and z' c'
= K(z c) + b K c, which is linear. So the loops carry the pair (c, z c), and only the last layer divides. Without any
known pixel both are zero, as in the layers.

Libraries vectorise over channels, of which there are two here; these loops vectorise over columns. Arrays are of four
planes, two channels of c and two of z c, with a margin of zeros around each.
"""

from __future__ import annotations

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from completion.networks.normalized_conv import DIVISION_GUARD, MultiScaleConfidence, NormalizedConv2d
from haustra.core.numba_cache import compiled

Planes = NDArray[np.float32]  # (4, h + 2 MARGIN, w + 2 MARGIN)
Layer = tuple[NDArray[np.float32], NDArray[np.float32]]  # kernel (in, rows, out, columns) and bias (out,)
MARGIN = 2  # px of zeros around a plane: half of the largest kernel
QUARTER = np.float32(1 / 4)


class LinearConfidence(nn.Module):
    """`MultiScaleConfidence` without gradients: sparse depth and confidence (B,1,H,W) -> dense ones."""

    def __init__(self, msc: MultiScaleConfidence) -> None:
        super().__init__()
        self.levels = msc.levels
        self.lift, self.densify, self.refine = (_layer(part) for part in (msc.lift, msc.densify, msc.refine))
        self.merge = [_layer(part) for part in msc.merge]  # type: ignore[arg-type]
        kernel, bias = _layer(msc.project)
        self.project, self.bias, self.guard = kernel.reshape(2), bias[0], np.float32(DIVISION_GUARD)

    def forward(self, depth: Tensor, confidence: Tensor) -> tuple[Tensor, Tensor]:
        """As `MultiScaleConfidence.forward`."""
        assert not any(side % 2**self.levels for side in depth.shape[2:]), "the loops take two rows and columns at once"
        dense = np.empty((2, *depth.shape), np.float32)
        points = (rows(depth), rows(confidence))
        for index, (frame_depth, frame_confidence) in enumerate(zip(*points, strict=True)):
            planes = self._pyramid(started(frame_depth, frame_confidence))
            finish(planes, self.project, self.bias, self.guard, dense[0, index, 0], dense[1, index, 0])
        return torch.from_numpy(dense[0]), torch.from_numpy(dense[1])

    def _pyramid(self, points: Planes) -> Planes:
        finest = convolved(convolved(convolved(points, *self.lift), *self.densify), *self.refine)
        pyramid = [finest]
        for level in range(1, self.levels + 1):
            coarser = convolved(halved(pyramid[-1]), *self.densify)
            pyramid.append(convolved(coarser, *self.refine) if level == 1 else coarser)
        coarse = pyramid.pop()
        for kernel, bias in reversed(self.merge):
            coarse = merged(pyramid.pop(), coarse, kernel, bias)
        return coarse


def _layer(layer: NormalizedConv2d) -> Layer:
    kernel = layer.unit_kernel().detach().float().numpy().transpose(1, 2, 0, 3)
    return np.ascontiguousarray(kernel), layer.bias.detach().float().numpy().copy()


def rows(image: Tensor) -> NDArray[np.float32]:
    """(B,1,H,W) -> contiguous (B,H,W) float32."""
    return np.ascontiguousarray(image[:, 0].numpy(), np.float32)


@compiled
def started(depth, confidence):  # type: ignore[no-untyped-def]
    """Depth and confidence (h,w) -> planes of one channel each, c and z c."""
    height, width = depth.shape
    planes = np.zeros((2, height + 2 * MARGIN, width + 2 * MARGIN), np.float32)
    for y in range(height):
        for x in range(width):
            planes[0, y + MARGIN, x + MARGIN] = confidence[y, x]
            planes[1, y + MARGIN, x + MARGIN] = depth[y, x] * confidence[y, x]
    return planes


@compiled
def convolved(planes, kernel, bias):  # type: ignore[no-untyped-def]
    """One layer: c and z c of the kernel's input channels -> c' and z' c' of two channels, (4,h,w)."""
    out = np.zeros((4, *planes.shape[1:]), np.float32)
    add_convolved(out, planes, kernel)
    add_bias(out, bias)
    return out


@compiled
def merged(fine, coarse, kernel, bias):  # type: ignore[no-untyped-def]
    """A decoder layer: planes of a level beside those of the next coarser one, doubled by nearest neighbour."""
    out = np.zeros(fine.shape, np.float32)
    add_convolved(out, fine, kernel[:2])
    add_convolved(out, doubled(coarse, fine.shape), kernel[2:])
    add_bias(out, bias)
    return out


@compiled
def add_convolved(out, planes, kernel):  # type: ignore[no-untyped-def]
    """out (4,h,w) += planes * kernel (in,k,2,k), k = 3 or 5, alike for c and z c; the margin stays zero."""
    inputs, size = kernel.shape[:2]
    for part in range(2):
        for y in range(MARGIN, out.shape[1] - MARGIN):
            first = out[2 * part, y, MARGIN:-MARGIN]
            second = out[2 * part + 1, y, MARGIN:-MARGIN]
            for channel in range(inputs):
                for row in range(size):
                    source = planes[part * inputs + channel, y + row - size // 2]
                    if size == 5:
                        add_five(first, second, source, kernel[channel, row])
                    else:
                        add_three(first, second, source, kernel[channel, row])


@compiled
def add_five(first, second, source, kernel):  # type: ignore[no-untyped-def]
    """Row (w,) of each output += row (w+4,) of an input * kernel (2,5). Unrolled so that LLVM vectorises the loop."""
    a0, a1, a2, a3, a4 = kernel[0, 0], kernel[0, 1], kernel[0, 2], kernel[0, 3], kernel[0, 4]
    b0, b1, b2, b3, b4 = kernel[1, 0], kernel[1, 1], kernel[1, 2], kernel[1, 3], kernel[1, 4]
    for x in range(len(first)):
        s0, s1, s2, s3, s4 = source[x], source[x + 1], source[x + 2], source[x + 3], source[x + 4]
        first[x] += a0 * s0 + a1 * s1 + a2 * s2 + a3 * s3 + a4 * s4
        second[x] += b0 * s0 + b1 * s1 + b2 * s2 + b3 * s3 + b4 * s4


@compiled
def add_three(first, second, source, kernel):  # type: ignore[no-untyped-def]
    """As `add_five`, kernel (2,3)."""
    a0, a1, a2 = kernel[0, 0], kernel[0, 1], kernel[0, 2]
    b0, b1, b2 = kernel[1, 0], kernel[1, 1], kernel[1, 2]
    for x in range(len(first)):
        s0, s1, s2 = source[x + 1], source[x + 2], source[x + 3]
        first[x] += a0 * s0 + a1 * s1 + a2 * s2
        second[x] += b0 * s0 + b1 * s1 + b2 * s2


@compiled
def add_bias(planes, bias):  # type: ignore[no-untyped-def]
    """K(z c) -> K(z c) + b K c, in place."""
    for channel in range(2):
        for y in range(planes.shape[1]):
            for x in range(planes.shape[2]):
                planes[2 + channel, y, x] += bias[channel] * planes[channel, y, x]


@compiled
def halved(planes):  # type: ignore[no-untyped-def]
    """As `confidence_pool`: c and z c of the most confident pixel of each 2x2 block, divided by four."""
    height, width = planes.shape[1] // 2 - MARGIN, planes.shape[2] // 2 - MARGIN
    out = np.zeros((4, height + 2 * MARGIN, width + 2 * MARGIN), np.float32)
    for channel in range(2):
        for y in range(height):
            for x in range(width):
                row, column = 2 * y + MARGIN, 2 * x + MARGIN
                most, chosen = planes[channel, row, column], planes[2 + channel, row, column]
                for i, j in ((row, column + 1), (row + 1, column), (row + 1, column + 1)):
                    more = planes[channel, i, j] > most
                    chosen = planes[2 + channel, i, j] if more else chosen
                    most = planes[channel, i, j] if more else most
                out[channel, y + MARGIN, x + MARGIN] = most * QUARTER
                out[2 + channel, y + MARGIN, x + MARGIN] = chosen * QUARTER
    return out


@compiled
def doubled(planes, shape):  # type: ignore[no-untyped-def]
    """Nearest-neighbour upsampling by two, to planes of that shape."""
    out = np.zeros(shape, np.float32)
    for channel in range(4):
        for y in range(MARGIN, planes.shape[1] - MARGIN):
            for x in range(MARGIN, planes.shape[2] - MARGIN):
                value = planes[channel, y, x]
                for row in range(2):
                    out[channel, 2 * y - MARGIN + row, 2 * x - MARGIN] = value
                    out[channel, 2 * y - MARGIN + row, 2 * x - MARGIN + 1] = value
    return out


@compiled
def finish(planes, kernel, bias, guard, depth, confidence):  # type: ignore[no-untyped-def]
    """The last layer, 1x1 to one channel, and the division z c / c, into `depth` and `confidence` (h,w)."""
    for y in range(depth.shape[0]):
        for x in range(depth.shape[1]):
            row, column = y + MARGIN, x + MARGIN
            known = kernel[0] * planes[0, row, column] + kernel[1] * planes[1, row, column]
            weighted = kernel[0] * planes[2, row, column] + kernel[1] * planes[3, row, column]
            depth[y, x] = weighted / max(known, guard) + bias
            confidence[y, x] = known
