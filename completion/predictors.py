"""Anything that completes depth, behind one call: classical fills, shipped models, weight files of any network."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from completion.classical import CLASSICAL
from completion.errors import CompletionError

RGB = NDArray[np.uint8]
Depth = NDArray[np.float32]
Predictor = Callable[[RGB, Depth, NDArray[np.float64] | None], tuple[Depth, Depth | None]]


def load_predictor(model: str | Path, device: str = "auto", precision: str = "auto") -> Predictor:
    """(rgb (H,W,3), sparse (H,W), intrinsics (4,) or None) -> depth (H,W) and, where the model has one, confidence.

    `model`: nearest, linear or ip_basic; a shipped model's name; or a weight file. CompletionError if it is none.
    """
    if str(model) in CLASSICAL:
        fill = CLASSICAL[str(model)]
        return lambda rgb, sparse, intrinsics: (fill(sparse), None)
    from completion.checkpoint import load_network, read_metadata
    from completion.infer import DepthCompleter
    from completion.network import ScaleFreeMSCSANet
    from completion.shipped import resolve_weights

    path = resolve_weights(model)
    network = load_network(path)
    if isinstance(network, ScaleFreeMSCSANet):
        completer = DepthCompleter(network, device, precision)
        return lambda rgb, sparse, intrinsics: completer(rgb, sparse)
    return _metric(network, device, float(read_metadata(path).get("unit_mm", 1.0)))


def _metric(network: Callable, device: str, unit: float) -> Predictor:
    """A network of the paper's kind: metric depth in and out, no confidence; it works in multiples of `unit`."""
    import torch

    from completion.infer import choose_device

    where = choose_device(device)
    module = network.to(where).eval()  # type: ignore[attr-defined]

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
