"""`DepthCompleter`: one image and its sparse depth in, dense depth and confidence out."""

import contextlib
from pathlib import Path

import cv2
import numpy as np
import torch
from numpy.typing import NDArray
from torch import nn

from completion.checkpoint import load_network
from completion.confidence import confidence_from_error
from completion.errors import CompletionError
from completion.feedback import look_again
from completion.look_norm import fold_batch_norm
from completion.sampling import normalise_log
from completion.scale_free import ScaleFreeMSCSANet
from completion.shipped import resolve_weights

# The shipped weights were trained on images of 192 to 320 px, and on few as bright as SimCol3D's: pictures are brought
# to what they know. With few points and one look a smaller size is better, since it brings them nearer to each other;
# a second look does that better. Chosen on rendered frames of 480 px (docs/completion.md).
WORKING_SIDE = 320  # px, longer side
SIDE_FOR_FEW, FEW_POINTS = 224, 250
LOOKS = 2  # a third gains at most 3 % and costs as much time again
EDGE = 1.2  # ratio of depths within 3x3 pixels from which a larger picture keeps an edge there instead of a slope
TYPICAL_BRIGHTNESS = 130.0  # grey levels: median over the training frames of the mean brightest channel
GAIN_RANGE = (0.5, 2.0)


class DepthCompleter:
    """Dense depth in the unit of the sparse depth, whatever that unit is.

    >>> completer = DepthCompleter.load("mscsa")
    >>> depth, confidence = completer(rgb, sparse_depth)      # doctest: +SKIP
    """

    def __init__(
        self,
        network: ScaleFreeMSCSANet,
        device: str = "auto",
        precision: str = "auto",
        working_side: int | None = None,
        looks: int | None = None,
    ) -> None:
        """`working_side`: px, to which larger pictures are reduced; None chooses it by looks and points.

        `looks`: how often the network completes a frame, each time with its last estimate as further points
        (`completion.feedback`), and time grows with it; None: as often as it was trained for, at most `LOOKS` times.
        """
        if precision not in ("auto", "bf16", "fp32"):
            raise CompletionError(f"precision is auto, bf16 or fp32, not {precision!r}")
        self.looks = min(LOOKS, network.config.looks) if looks is None else looks
        if self.looks < 1 or (working_side is not None and working_side < 1):
            raise CompletionError(f"looks and working_side are at least 1, not {looks} and {working_side}")
        self.device = choose_device(device)
        self.working_side = working_side
        self.network = self._folded(network, again=False)
        self.later = self._folded(network, again=True) if self.looks > 1 else self.network
        self.half = _has_fast_bfloat16(self.device) if precision == "auto" else precision == "bf16"

    def _folded(self, network: ScaleFreeMSCSANet, again: bool) -> nn.Module:
        return fold_batch_norm(network, again).to(self.device, memory_format=torch.channels_last)

    @classmethod
    def load(cls, model: str | Path = "mscsa", device: str = "auto", precision: str = "auto") -> "DepthCompleter":
        """A shipped model by name, or a weight file; raises `CompletionError` if it does not fit."""
        return cls(load_scale_free(model), device, precision)

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
        errors = None if sparse_error is None else sparse_error[None]
        depth, confidence = self.batch(rgb[None], sparse_depth[None], errors)
        return depth[0], confidence[0]

    def batch(
        self,
        rgb: NDArray[np.uint8],
        sparse_depth: NDArray[np.float32],
        sparse_error: NDArray[np.float32] | None = None,
    ) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """Complete B frames of one size at once: as `__call__`, each array with a first axis B."""
        _check_shapes(rgb, sparse_depth, sparse_error)
        sparse = np.where(np.isfinite(sparse_depth) & (sparse_depth > 0), sparse_depth, 0).astype(np.float32)
        trust = (sparse > 0).astype(np.float32)
        if sparse_error is not None:
            trust *= confidence_from_error(np.nan_to_num(sparse_error, nan=1.0)).astype(np.float32)
        points = np.count_nonzero(sparse, axis=(1, 2))
        sides = np.array([self.working_side or self._side_for(int(count)) for count in points])
        depth, error = np.zeros((2, *sparse.shape), np.float32)
        for side in np.unique(sides):
            here = sides == side
            depth[here], error[here] = self._at_side(int(side), rgb[here], sparse[here], trust[here])
        known = points[:, None, None] > 0
        return depth * known, confidence_from_error(error) * known

    def _side_for(self, points: int) -> int:
        return SIDE_FOR_FEW if self.looks == 1 and points < FEW_POINTS else WORKING_SIDE

    def _at_side(
        self, side: int, rgb: NDArray[np.uint8], sparse: NDArray[np.float32], trust: NDArray[np.float32]
    ) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """Depth and relative error (B,H,W), made at a reduced size if the pictures' longer side exceeds `side`."""
        height, width = sparse.shape[1:]
        factor = min(1.0, side / max(height, width))
        frames = [_reduced(normalise_exposure(i), s, t, factor) for i, s, t in zip(rgb, sparse, trust, strict=True)]
        depth, error = self._predict(*(np.stack(parts) for parts in zip(*frames, strict=True)))
        if factor == 1:
            return depth, error
        enlarged = [_enlarged(d, e, (width, height)) for d, e in zip(depth, error, strict=True)]
        return np.stack([d for d, _ in enlarged]), np.stack([e for _, e in enlarged])

    def _predict(
        self, rgb: NDArray[np.uint8], sparse: NDArray[np.float32], trust: NDArray[np.float32]
    ) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """Depth and relative error (B,H,W) from (B,H,W,3), (B,H,W), (B,H,W)."""
        image = torch.from_numpy(rgb).to(self.device).permute(0, 3, 1, 2).float() / 255
        points, weights = (torch.from_numpy(a).to(self.device)[:, None] for a in (sparse, trust))
        with torch.inference_mode(), self._autocast():
            log_sparse, median = normalise_log(points)
            log_depth, log_error = look_again(self.network, self.later, image, log_sparse, weights, self.looks)
            depth = torch.exp(log_depth) * median
        return depth[:, 0].cpu().numpy(), torch.exp(log_error)[:, 0].cpu().numpy()

    def _autocast(self) -> contextlib.AbstractContextManager:
        if not self.half:
            return contextlib.nullcontext()
        return torch.autocast(self.device.type, torch.bfloat16)


def load_scale_free(model: str | Path) -> ScaleFreeMSCSANet:
    """The network of a shipped name or a weight file; CompletionError if it is one of the paper's metric ones."""
    network = load_network(resolve_weights(model))
    if not isinstance(network, ScaleFreeMSCSANet):
        raise CompletionError(f"{model} is a metric network; completing SfM depth needs a scale-free one")
    return network


def normalise_exposure(rgb: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Bring the mean brightness of the lit area to that of the training frames, within a factor of two."""
    brightest = np.maximum.reduce(cv2.split(rgb))
    lit = brightest > 16  # video black: the border is not part of the picture
    if not lit.any():
        return rgb
    gain = np.clip(TYPICAL_BRIGHTNESS / brightest[lit].mean(), *GAIN_RANGE)
    return cv2.convertScaleAbs(rgb, alpha=float(gain))


def _reduced(
    rgb: NDArray[np.uint8], sparse: NDArray[np.float32], trust: NDArray[np.float32], factor: float
) -> tuple[NDArray[np.uint8], NDArray[np.float32], NDArray[np.float32]]:
    """Image and points at `factor` times the size; where points then share a pixel, the surest stays."""
    if factor == 1:
        return rgb, sparse, trust
    size = (max(1, round(rgb.shape[1] * factor)), max(1, round(rgb.shape[0] * factor)))
    rows, columns = np.nonzero(sparse)
    order = np.argsort(trust[rows, columns], kind="stable")
    rows, columns = rows[order], columns[order]
    new_rows = ((rows + 0.5) * size[1] / rgb.shape[0]).astype(int)
    new_columns = ((columns + 0.5) * size[0] / rgb.shape[1]).astype(int)
    small_sparse, small_trust = np.zeros((2, size[1], size[0]), dtype=np.float32)
    small_sparse[new_rows, new_columns] = sparse[rows, columns]
    small_trust[new_rows, new_columns] = trust[rows, columns]
    return cv2.resize(rgb, size, interpolation=cv2.INTER_AREA), small_sparse, small_trust


def _enlarged(
    depth: NDArray[np.float32], error: NDArray[np.float32], size: tuple[int, int]
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Depth and error at `size` (width, height): bilinear, but never a depth between the two sides of an edge, where
    there is no surface."""
    around = np.ones((3, 3), np.uint8)
    edge = cv2.dilate(depth, around) > EDGE * cv2.erode(depth, around)
    edge = cv2.resize(edge.astype(np.uint8), size, interpolation=cv2.INTER_NEAREST_EXACT) > 0
    nearest = cv2.resize(depth, size, interpolation=cv2.INTER_NEAREST_EXACT)
    return np.where(edge, nearest, cv2.resize(depth, size)), cv2.resize(error, size)


def choose_device(device: str) -> torch.device:
    if device == "auto":
        return torch.device("cuda" if torch.cuda.is_available() else "cpu")
    if device == "cuda" and not torch.cuda.is_available():
        raise CompletionError("no CUDA device is available here; use --device cpu")
    return torch.device(device)


def _check_shapes(rgb: NDArray, sparse: NDArray, error: NDArray | None) -> None:
    if rgb.ndim != 4 or rgb.shape[3] != 3 or rgb.dtype != np.uint8:
        raise CompletionError(f"the image must be (H, W, 3) uint8, not {rgb.shape[1:]} {rgb.dtype}")
    if not rgb.size:
        raise CompletionError(f"there is no picture in images of shape {rgb.shape}")
    for name, array in (("sparse depth", sparse), ("sparse error", error)):
        if array is not None and array.shape != rgb.shape[:3]:
            raise CompletionError(f"the {name} must have the image's size {rgb.shape[1:3]}, not {array.shape[1:]}")


def _has_fast_bfloat16(device: torch.device) -> bool:
    """True on a GPU and on CPUs with native bfloat16; emulated bfloat16 is slower than float32."""
    if device.type != "cpu":
        return True
    capability = getattr(torch.cpu, "_is_avx512_bf16_supported", None)
    return bool(capability and capability())
