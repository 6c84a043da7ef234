"""Structure awareness (SA): self-attention between the channels of the deepest feature map, paper Fig. 3.

The module is the "structure perception module" of CADepth (the paper's [34]), itself DANet's channel attention:
E = X X^T over the N = H*W positions, A = softmax(max(E) - E), output = A X + X. The softmax of max - E gives the
*least* similar channel the greatest weight, which is what both released codes do; the paper's text reads the other
way round, hence the `sign` option.
"""

from collections.abc import Callable
from typing import Literal

import torch
from torch import Tensor, nn


class StructureAwareness(nn.Module):
    """Channel self-attention (B,C,H,W) -> (B,C,H,W).

    similarity: "sum" is the paper's plain X X^T, which grows with the image; "mean" divides by N, so that
        the attention does not depend on the image size.
    learned_gain: False adds A X with weight one (paper); True with a learnt weight that starts at zero (DANet).
    sign: "distinct" = softmax(max - E) as in the released codes; "similar" = softmax(E).
    """

    def __init__(
        self,
        similarity: Literal["sum", "mean"] = "sum",
        learned_gain: bool = False,
        sign: Literal["distinct", "similar"] = "distinct",
    ) -> None:
        super().__init__()
        self.similarity = similarity
        self.sign = sign
        self.gain = nn.Parameter(torch.zeros(())) if learned_gain else None

    def forward(self, features: Tensor) -> Tensor:
        # float32 whatever the autocast: sums over hundreds of positions go through an exponential.
        with torch.autocast(features.device.type, enabled=False):
            x = features.float().flatten(2)
            gathered = (self.attention(x) @ x).view_as(features)
        if self.gain is not None:
            gathered = self.gain * gathered
        return features + gathered.to(features.dtype)

    def attention(self, x: Tensor) -> Tensor:
        """A, (B,C,C): the weights with which each channel of x (B,C,N) takes up all of them; rows sum to one."""
        energy = x @ x.transpose(1, 2)
        if self.similarity == "mean":
            energy = energy / x.shape[2]
        if self.sign == "distinct":
            energy = energy.amax(dim=2, keepdim=True) - energy
        return energy.softmax(dim=2)


def structure_awareness_of(network: nn.Module) -> StructureAwareness | None:
    """The first such module of a network; None without any."""
    return next((module for module in network.modules() if isinstance(module, StructureAwareness)), None)


def attention_features(network: nn.Module, run: Callable[[], object]) -> tuple[Tensor, Tensor] | None:
    """Features (C,h,w) before and after structure awareness while `run()` calls the network (paper Fig. 6).

    Of the first frame of the batch and the module's last call; None for a network without the module.
    """
    seen: dict[str, Tensor] = {}
    found = structure_awareness_of(network)
    if found is None:
        return None

    def remember(module: nn.Module, given: tuple[Tensor], result: Tensor) -> None:
        seen.update(before=given[0][0].float().cpu(), after=result[0].float().cpu())

    handle = found.register_forward_hook(remember)
    try:
        run()
    finally:
        handle.remove()
    return seen["before"], seen["after"]
