"""`DepthCompleter`: one image and its sparse depth in, dense depth and confidence out."""

import contextlib
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn
from torch.nn.utils.fusion import fuse_conv_bn_eval

from completion.checkpoint import load_network
from completion.errors import CompletionError
from completion.network import DoubleConv, ScaleFreeMSCSANet
from completion.sampling import normalise_log
from completion.shipped import resolve_weights

# Confidence is e0^2 / (e0^2 + e^2) of the predicted relative error e: one half at 3 %, the depth error at which a
# wall 25 mm away is 0.75 mm off. Fusion weights by inverse variance, to which this is proportional for large e.
HALF_CONFIDENCE_ERROR = 0.03


class DepthCompleter:
    """Dense depth in the unit of the sparse depth, whatever that unit is.

    >>> completer = DepthCompleter.load("mscsa")
    >>> depth, confidence = completer(rgb, sparse_depth)      # doctest: +SKIP
    """

    def __init__(self, network: ScaleFreeMSCSANet, device: str = "auto", precision: str = "auto") -> None:
        self.device = _choose_device(device)
        self.network = _fold_batch_norm(network.eval()).to(self.device, memory_format=torch.channels_last)
        self.half = _has_fast_bfloat16(self.device) if precision == "auto" else precision == "bf16"

    @classmethod
    def load(cls, model: str | Path = "mscsa", device: str = "auto", precision: str = "auto") -> "DepthCompleter":
        """A shipped model by name, or a weight file; raises `CompletionError` if it does not fit."""
        network = load_network(resolve_weights(model))
        if not isinstance(network, ScaleFreeMSCSANet):
            raise CompletionError(f"{model} is a metric network; completing SfM depth needs a scale-free one")
        return cls(network, device, precision)

    def __call__(
        self,
        rgb: NDArray[np.uint8],
        sparse_depth: NDArray[np.float32],
        sparse_error: NDArray[np.float32] | None = None,
    ) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """Complete one frame.

        rgb: (H,W,3) uint8. sparse_depth: (H,W), 0, negative or NaN = none. sparse_error: (H,W) relative standard
        deviation of each point, or None. Returns depth (H,W) float32 and confidence (H,W) float32 in [0,1]. Without
        a single point there is no scale: depth and confidence are zero everywhere.
        """
        _check_shapes(rgb, sparse_depth, sparse_error)
        sparse = np.where(np.isfinite(sparse_depth) & (sparse_depth > 0), sparse_depth, 0).astype(np.float32)
        if not sparse.any():
            return np.zeros_like(sparse), np.zeros_like(sparse)
        trust = (sparse > 0).astype(np.float32)
        if sparse_error is not None:
            trust *= confidence_from_error(np.nan_to_num(sparse_error, nan=1.0)).astype(np.float32)
        depth, error = self._predict(rgb, sparse, trust)
        return depth, confidence_from_error(error)

    def _predict(
        self, rgb: NDArray[np.uint8], sparse: NDArray[np.float32], trust: NDArray[np.float32]
    ) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        image = torch.from_numpy(np.ascontiguousarray(rgb)).to(self.device).permute(2, 0, 1)[None].float() / 255
        log_sparse, median = normalise_log(self._as_map(sparse))
        with torch.inference_mode(), self._autocast():
            log_depth, log_error = self.network(image, log_sparse, self._as_map(trust))
            depth = torch.exp(log_depth) * median
        return depth[0, 0].cpu().numpy(), torch.exp(log_error)[0, 0].cpu().numpy()

    def _as_map(self, array: NDArray[np.float32]) -> Tensor:
        return torch.from_numpy(array).to(self.device)[None, None]

    def _autocast(self) -> contextlib.AbstractContextManager:
        if not self.half:
            return contextlib.nullcontext()
        return torch.autocast(self.device.type, torch.bfloat16)


def confidence_from_error(error: NDArray[np.float32]) -> NDArray[np.float32]:
    """Relative error -> confidence in [0,1]; one half at `HALF_CONFIDENCE_ERROR`."""
    return (HALF_CONFIDENCE_ERROR**2 / (HALF_CONFIDENCE_ERROR**2 + np.square(error))).astype(np.float32)


def _choose_device(device: str) -> torch.device:
    if device == "auto":
        return torch.device("cuda" if torch.cuda.is_available() else "cpu")
    if device == "cuda" and not torch.cuda.is_available():
        raise CompletionError("no CUDA device is available here; use --device cpu")
    return torch.device(device)


def _check_shapes(rgb: NDArray, sparse: NDArray, error: NDArray | None) -> None:
    if rgb.ndim != 3 or rgb.shape[2] != 3 or rgb.dtype != np.uint8:
        raise CompletionError(f"the image must be (H, W, 3) uint8, not {rgb.shape} {rgb.dtype}")
    if sparse.shape != rgb.shape[:2] or (error is not None and error.shape != sparse.shape):
        raise CompletionError(f"the sparse depth must have the image's size {rgb.shape[:2]}, not {sparse.shape}")


def _fold_batch_norm(network: ScaleFreeMSCSANet) -> ScaleFreeMSCSANet:
    """Fold each batch normalisation into the convolution before it: the same function, a fifth faster."""
    for block in network.modules():
        if isinstance(block, DoubleConv) and isinstance(block[1], nn.BatchNorm2d):
            for index in (0, 3):
                block[index] = fuse_conv_bn_eval(block[index], block[index + 1])
                block[index + 1] = nn.Identity()
    return network


def _has_fast_bfloat16(device: torch.device) -> bool:
    """True on a GPU and on CPUs with native bfloat16; emulated bfloat16 is slower than float32."""
    if device.type != "cpu":
        return True
    capability = getattr(torch.cpu, "_is_avx512_bf16_supported", None)
    return bool(capability and capability())
