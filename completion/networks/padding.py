"""Padding of images of any size to sides that a network can halve."""

import torch.nn.functional as F
from torch import Tensor


def pad_to_multiple(x: Tensor, stride: int, repeat_edge: bool = False) -> Tensor:
    """(B,C,H,W) -> (B,C,H',W'), sides the next multiples of `stride` px: padded with zeros or with the repeated edge.

    At the right and the bottom only, so that the principal point keeps its pixel coordinates.
    """
    right, below = -x.shape[3] % stride, -x.shape[2] % stride
    if not right and not below:
        return x  # without the copy that `pad` makes
    return F.pad(x, (0, right, 0, below), mode="replicate" if repeat_edge else "constant")
