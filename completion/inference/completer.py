"""`DepthCompleter`: image and sparse depth -> dense depth and confidence, with any `DepthNetwork`."""

import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import cv2
import numpy as np
import torch
from numpy.typing import NDArray

from completion.confidence import confidence_from_error, error_from_confidence
from completion.data.sampling_training import normalise_log
from completion.inference.kriging import towards_points
from completion.inference.resolution import resized, resolution_factor, restore_resolution
from completion.networks.checkpoint import load_network
from completion.networks.precision import choose_precision
from completion.networks.protocol import DepthNetwork, Estimate, most_iterations
from completion.networks.recurrence import DEFAULT_ITERATIONS, refine_iteratively
from completion.weights.shipped_weights import resolve_weights, validate_iterations
from haustra.core.errors import CompletionError
from haustra.core.threads import single_threaded, workers

# Dark images are brought to the exposure of the training frames. Bright ones stay: dimmed, a burnt wall would look like
# a grey one, and that it is burnt says that it is near.
TYPICAL_BRIGHTNESS = 130.0  # grey levels: median over the training frames of the mean brightest channel
MAX_GAIN = 2.0  # factor on grey levels
GPU_BATCH = 8  # frames; not measured, since no GPU was at hand
UNKNOWN_ERROR = 1e6  # relative, of a sparse point: no trust is left, and its square is still a float32
LEAST_ERROR, GREATEST_ERROR = 0.0025, 2.7  # relative, of an estimate that is refined: what networks can state


class DepthCompleter:
    """Dense depth in the unit of the sparse depth, and its confidence in [0,1].

    >>> completer = DepthCompleter.load("mscsa")
    >>> depth, confidence = completer(rgb, sparse_depth)      # doctest: +SKIP
    """

    def __init__(
        self,
        network: DepthNetwork,
        device: str = "auto",
        precision: str = "auto",
        resolution: int | None = None,
        iterations: int | None = None,
        looks: int | None = None,
    ) -> None:
        """resolution: px, longer side to which every image is resized; None chooses by iterations and points
        (`completion.inference.resolution`).

        iterations: of the network for each frame (`completion.networks.recurrence`), in proportion to which time
        grows; None: as many as it was trained for, at most `DEFAULT_ITERATIONS`. looks: its former name, deprecated.
        """
        iterations = renamed_looks(iterations, looks)
        self.trained_iterations = trained = most_iterations(network.config)
        self.iterations = min(DEFAULT_ITERATIONS, trained) if iterations is None else iterations
        if self.iterations < 1 or (resolution is not None and resolution < 1):
            raise CompletionError(f"iterations and resolution are at least 1, not {iterations} and {resolution}")
        validate_iterations(self.iterations, trained)
        self.device = choose_device(device)
        self.resolution = resolution
        self.precision = choose_precision(precision, self.device, network.precisions)
        self.network = network.for_device(self.device, self.precision, recurrent=False)
        self.recurrent = self.network
        if trained > 1:
            self.recurrent = network.for_device(self.device, self.precision, recurrent=True)

    @classmethod
    def load(
        cls,
        model: str | Path = "mscsa",
        device: str = "auto",
        precision: str = "auto",
        iterations: int | None = None,
        looks: int | None = None,
    ) -> "DepthCompleter":
        """A shipped model by name, or a weight file; CompletionError if it does not load or is a metric network."""
        return cls(load_depth_network(model), device, precision, iterations=renamed_looks(iterations, looks))

    def __call__(
        self,
        rgb: NDArray[np.uint8],
        sparse_depth: NDArray[np.float32],
        sparse_error: NDArray[np.float32] | None = None,
    ) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """Complete one frame.

        rgb: (H,W,3) uint8. sparse_depth: (H,W), 0, negative or NaN = none. sparse_error: (H,W) relative standard
        deviation of each point, by which the network's depth is corrected in the end (`towards_points`), or None.
        Returns depth (H,W) float32 and confidence (H,W) float32 in [0,1]. Without a single point there is no scale:
        depth and confidence are zero everywhere.
        """
        errors = None if sparse_error is None else np.asarray(sparse_error)[None]
        depth, confidence = self.batch(np.asarray(rgb)[None], np.asarray(sparse_depth)[None], errors)
        return depth[0], confidence[0]

    @property
    def at_once(self) -> int:
        """How many frames are best completed at once, each in a thread of its own; see `working_side_by_side`."""
        return workers() if self.device.type == "cpu" else 1

    @property
    def batch_size(self) -> int:
        """How many frames `batch` is best given: on a GPU several; on a CPU one, whose values stay in its cache."""
        return 1 if self.device.type == "cpu" else GPU_BATCH

    @contextmanager
    def working_side_by_side(self) -> Iterator[None]:
        """While `at_once` threads call this completer, each computes on one processor: two frames side by side take
        less time than two after each other, each on two processors. The results are the same. Until it ends, torch's
        and BLAS' numbers of threads are those of the whole process."""
        if self.at_once == 1:
            yield
            return
        before = torch.get_num_threads()
        torch.set_num_threads(1)
        try:
            with single_threaded():
                yield
        finally:
            torch.set_num_threads(before)

    @property
    def can_refine(self) -> bool:
        """Whether the network was trained to take a depth that a frame has already."""
        return self.trained_iterations > 1

    def refine(
        self,
        rgb: NDArray[np.uint8],
        sparse_depth: NDArray[np.float32],
        sparse_error: NDArray[np.float32],
        depth: NDArray[np.float32],
        confidence: NDArray[np.float32],
    ) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """One more iteration on a frame that has a depth, with points that it had not when that was made.

        rgb, sparse_depth as in `__call__`; sparse_error (H,W) relative standard deviations, by which points are trusted
        (depth is not corrected by them as there); depth (H,W), 0 = none, and confidence (H,W) as `__call__` returned
        them. Returns both anew. CompletionError if the network was trained for one iteration only.
        """
        validate_iterations(2, self.trained_iterations)
        _check_shapes(rgb[None], sparse_depth[None], sparse_error[None])
        sparse, trust = valid_points(sparse_depth, sparse_error)
        factor = self._factor(sparse.shape, int(np.count_nonzero(sparse)))
        image, points, weights = resized(normalise_exposure(rgb), sparse, trust, factor)
        if not points.any():
            return depth, confidence
        size = points.shape[::-1]
        error = error_from_confidence(confidence, least=1e-6)
        known = np.where(depth > 0, depth, np.median(sparse[sparse > 0])).astype(np.float32)
        last = cv2.resize(known, size), np.clip(cv2.resize(error, size), LEAST_ERROR, GREATEST_ERROR)
        small = self._predict(image[None], points[None], weights[None], (last[0][None], last[1][None]))
        refined, refined_error = restore_resolution(small[0][0], small[1][0], (sparse.shape[1], sparse.shape[0]))
        return refined, confidence_from_error(refined_error)

    def batch(
        self,
        rgb: NDArray[np.uint8],
        sparse_depth: NDArray[np.float32],
        sparse_error: NDArray[np.float32] | None = None,
        corrected: bool = True,
    ) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """As `__call__`, of B frames of one size: each array has a first axis B. corrected: False leaves the correction
        by the points to the caller."""
        _check_shapes(rgb, sparse_depth, sparse_error)
        sparse, trust = valid_points(sparse_depth, sparse_error)
        points = np.count_nonzero(sparse, axis=(1, 2))
        factors = np.array([self._factor(sparse.shape[1:], int(count)) for count in points])
        depth, error = np.zeros((2, *sparse.shape), np.float32)
        for factor in np.unique(factors):
            here = factors == factor
            depth[here], error[here] = self._resized(float(factor), rgb[here], sparse[here], trust[here])
        known = points[:, None, None] > 0
        depth *= known
        if sparse_error is not None and corrected:
            frames = zip(depth, error, sparse, sparse_error, strict=True)
            depth = np.stack([towards_points(*frame) for frame in frames])
        return depth, confidence_from_error(error) * known

    def _factor(self, shape: tuple[int, ...], points: int) -> float:
        """By which an image of a shape (H,W) with so many sparse points is resized before it is completed."""
        if self.resolution is not None:
            return self.resolution / max(shape)
        return resolution_factor(max(shape), points, self.iterations)

    def _resized(
        self, factor: float, rgb: NDArray[np.uint8], sparse: NDArray[np.float32], trust: NDArray[np.float32]
    ) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """Depth and relative error (B,H,W), computed at `factor` times the images' resolution."""
        frames = [resized(normalise_exposure(i), s, t, factor) for i, s, t in zip(rgb, sparse, trust, strict=True)]
        images, points, weights = (np.stack(parts) for parts in zip(*frames, strict=True))
        depth, error = self._predict(images, points, weights)
        size = (sparse.shape[2], sparse.shape[1])
        back = [restore_resolution(d, e, size) for d, e in zip(depth, error, strict=True)]
        return np.stack([d for d, _ in back]), np.stack([e for _, e in back])

    def _predict(
        self,
        rgb: NDArray[np.uint8],
        sparse: NDArray[np.float32],
        trust: NDArray[np.float32],
        last: tuple[NDArray[np.float32], NDArray[np.float32]] | None = None,
    ) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """Image (B,H,W,3), sparse depth and trust (B,H,W) -> depth and relative error (B,H,W).

        last: depth and relative error (B,H,W) that a single iteration refines; None begins anew.
        """
        points, weights = (torch.from_numpy(a).to(self.device)[:, None] for a in (sparse, trust))
        with torch.inference_mode():
            log_sparse, median = normalise_log(points)
            image = self.network.prepare(torch.from_numpy(rgb).to(self.device).permute(0, 3, 1, 2))
            first, recurrent = self.network.iterate, self.recurrent.iterate
            if last is None:
                estimate = refine_iteratively(first, recurrent, image, log_sparse, weights, self.iterations)
            else:
                depth, error = (torch.from_numpy(a).to(self.device)[:, None] for a in last)
                estimate = recurrent(image, log_sparse, weights, Estimate(torch.log(depth / median), torch.log(error)))
            depth = torch.exp(estimate.log_depth) * median
        return depth[:, 0].cpu().numpy(), torch.exp(estimate.log_error)[:, 0].cpu().numpy()


def valid_points(
    sparse_depth: NDArray[np.float32], sparse_error: NDArray[np.float32] | None
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Sparse depth (...,H,W), 0 where there is no valid one, and the trust in it, both float32."""
    sparse = np.where(np.isfinite(sparse_depth) & (sparse_depth > 0), sparse_depth, 0).astype(np.float32)
    trust = (sparse > 0).astype(np.float32)
    if sparse_error is not None:
        told = np.minimum(np.nan_to_num(sparse_error, nan=1.0), UNKNOWN_ERROR)
        trust *= confidence_from_error(told).astype(np.float32)
    return sparse, trust


def renamed_looks(iterations: int | None, looks: int | None) -> int | None:
    """The iterations asked for, by that name or by the one of earlier releases."""
    if looks is not None:
        warnings.warn("looks= is now iterations=, and will be refused", DeprecationWarning, stacklevel=3)
    return looks if iterations is None else iterations


def load_depth_network(model: str | Path) -> DepthNetwork:
    """The network of a shipped name or a weight file; CompletionError if it is one of the paper's metric ones."""
    network = load_network(resolve_weights(model))
    if not isinstance(network, DepthNetwork):
        raise CompletionError(f"{model} is a metric network; completing SfM depth needs a scale-invariant one")
    return network


def normalise_exposure(rgb: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Image (H,W,3) times the factor from 1 to `MAX_GAIN` that brings its lit area's mean to `TYPICAL_BRIGHTNESS`."""
    brightest = np.maximum.reduce(cv2.split(rgb))
    lit = (brightest > 16).view(np.uint8)  # above video black, so that the border does not count
    if not lit.any():
        return rgb
    gain = np.clip(TYPICAL_BRIGHTNESS / cv2.mean(brightest, lit)[0], 1, MAX_GAIN)
    return cv2.convertScaleAbs(rgb, alpha=float(gain))


def choose_device(device: str) -> torch.device:
    """The device of "auto" (CUDA where there is one), "cpu" or "cuda"; CompletionError without CUDA.

    From then on CUDA computes float32 convolutions in float32, as a CPU does: torch rounds their inputs to TF32, with
    11 bits, which normalised convolution divides.
    """
    if device == "cuda" and not torch.cuda.is_available():
        raise CompletionError("no CUDA device is available here; use --device cpu")
    chosen = ("cuda" if torch.cuda.is_available() else "cpu") if device == "auto" else device
    if chosen == "cuda":
        torch.backends.cudnn.allow_tf32 = False
    return torch.device(chosen)


def _check_shapes(rgb: NDArray, sparse: NDArray, error: NDArray | None) -> None:
    if rgb.ndim != 4 or rgb.shape[3] != 3 or rgb.dtype != np.uint8:
        raise CompletionError(f"the image must be (H, W, 3) uint8, not {rgb.shape[1:]} {rgb.dtype}")
    if not rgb.size:
        raise CompletionError(f"there is no image in an array of shape {rgb.shape}")
    for name, array in (("sparse depth", sparse), ("sparse error", error)):
        if array is not None and array.shape != rgb.shape[:3]:
            raise CompletionError(f"the {name} must have the image's size {rgb.shape[1:3]}, not {array.shape[1:]}")
