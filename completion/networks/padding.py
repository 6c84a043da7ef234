"""Images of any size for networks that halve their sides."""

import torch.nn.functional as F
from torch import Tensor


def pad_to_multiple(x: Tensor, stride: int, repeat_edge: bool = False) -> Tensor:
    """(B,C,H,W) -> zeros, or the last row and column again, added at the right and at the bottom until `stride` divides
    both sides.

    There and not all round: the principal point stays where it is.
    """
    right, below = -x.shape[3] % stride, -x.shape[2] % stride
    if not right and not below:
        return x  # `pad` would copy it
    return F.pad(x, (0, right, 0, below), mode="replicate" if repeat_edge else "constant")
