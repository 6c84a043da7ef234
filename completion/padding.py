"""Images of any size for networks that halve their sides."""

import torch.nn.functional as F
from torch import Tensor


def pad_to_multiple(x: Tensor, stride: int, repeat_edge: bool = False) -> Tensor:
    """(B,C,H,W) -> zeros, or the last row and column again, added at the right and at the bottom until `stride` divides
    both sides.

    There and not all round: the principal point stays where it is.
    """
    height, width = x.shape[2:]
    return F.pad(x, (0, -width % stride, 0, -height % stride), mode="replicate" if repeat_edge else "constant")
