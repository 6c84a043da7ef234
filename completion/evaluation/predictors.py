"""One call for every completion method: classical baselines, shipped models, weight files of any registered network."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from completion.networks.classical import CLASSICAL
from haustra.core.errors import CompletionError

RGB = NDArray[np.uint8]
Depth = NDArray[np.float32]
Complete = Callable[[RGB, Depth, NDArray[np.float64] | None], tuple[Depth, Depth | None]]

if TYPE_CHECKING:
    from torch import nn


@dataclass(frozen=True)
class Predictor:
    """(rgb (H,W,3), sparse (H,W), intrinsics (4,) or None) -> depth (H,W) and, where the model has one, confidence."""

    complete: Complete
    network: nn.Module | None = None  # None for classical fills
    precision: str | None = None  # of a `DepthNetwork`'s convolutions: int8, bf16 or fp32

    @property
    def predicts_error(self) -> bool:
        """Whether it says how far off its depth is, as confidence."""
        return self.precision is not None

    def __call__(
        self, rgb: RGB, sparse: Depth, intrinsics: NDArray[np.float64] | None = None
    ) -> tuple[Depth, Depth | None]:
        return self.complete(rgb, sparse, intrinsics)


def load_predictor(model: str | Path, device: str = "auto", precision: str = "auto") -> Predictor:
    """A model by name or file.

    `model`: nearest, linear or ip_basic; a shipped model's name; or a weight file. CompletionError if it is none.
    """
    if str(model) in CLASSICAL:
        fill = CLASSICAL[str(model)]
        return Predictor(lambda rgb, sparse, intrinsics: (fill(sparse), None))
    from completion.inference.completer import DepthCompleter
    from completion.networks.checkpoint import load_network, read_metadata
    from completion.networks.protocol import DepthNetwork
    from completion.weights.shipped_weights import resolve_weights

    try:
        path = resolve_weights(model)
    except CompletionError as error:
        raise CompletionError(f"{error}, {', '.join(CLASSICAL)}") from None
    network = load_network(path)
    if isinstance(network, DepthNetwork):
        completer = DepthCompleter(network, device, precision)
        made: Any = completer.network  # also a module
        return Predictor(lambda rgb, sparse, intrinsics: completer(rgb, sparse), made, completer.precision)
    return Predictor(_metric(network, device, float(read_metadata(path).get("unit_mm", 1.0))), network)


def _metric(network: nn.Module, device: str, unit: float) -> Complete:
    """Call of a metric network, whose depth is in multiples of `unit`; it has no confidence."""
    import torch

    from completion.inference.completer import choose_device

    where = choose_device(device)
    module = network.to(where).eval()

    def predict(rgb: RGB, sparse: Depth, intrinsics: NDArray[np.float64] | None) -> tuple[Depth, None]:
        if not (sparse > 0).any():
            raise CompletionError("a metric network needs at least one point")
        image = torch.from_numpy(np.ascontiguousarray(rgb)).to(where).permute(2, 0, 1)[None].float() / 255
        points = torch.from_numpy(np.ascontiguousarray(sparse / np.float32(unit))).to(where)[None, None]
        lens = None if intrinsics is None else torch.tensor(intrinsics, dtype=torch.float32, device=where)[None]
        with torch.inference_mode():
            depth = module(image, points, lens)[0, 0].float().cpu().numpy()
        return depth * np.float32(unit), None

    return predict
