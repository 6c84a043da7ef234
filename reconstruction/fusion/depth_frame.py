"""One checked RGB-D frame for fusion: unusable depth removed, the rest weighted."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from haustra.core.errors import ReconstructionError

Image = NDArray[np.float32]


@dataclass(frozen=True)
class DepthFrame:
    """A frame as fusion takes it."""

    colour: NDArray[np.float32]  # (H,W,3) 0..255
    depth: Image  # (H,W) z-depth, 0 where nothing usable was measured
    confidence: Image  # (H,W) in [0,1], 0 wherever depth is 0
    weight: Image  # (H,W) >= 0, inverse variance of the surface's position; 0 wherever depth is 0
    centred_intrinsics: NDArray[np.float64]  # (3,3), the top-left pixel's centre at (0,0)
    camera_from_world: NDArray[np.float64]  # (4,4)


def prepare_frame(
    rgb: NDArray[np.uint8],
    depth: NDArray[np.float32],
    confidence: NDArray[np.float32] | None,
    intrinsics: NDArray[np.float64],
    world_from_camera: NDArray[np.float64],
    max_depth: float,
    max_grazing_deg: float,
    typical_depth: float,
) -> DepthFrame:
    """`DepthFrame` of rgb (H,W,3), z-depth (H,W), confidence (H,W), intrinsics (3,3), world_from_camera (4,4).

    Intrinsics have the top-left pixel's centre at (0.5, 0.5) (COLMAP); the frame has it at (0, 0) (Open3D). Depth that
    is NaN, infinite, not positive or above `max_depth` is dropped; so are pixels that see their surface at more than
    `max_grazing_deg` from its normal, and pixels whose confidence is NaN or not positive.

    The weight is confidence x (cosine x typical_depth / depth)^2. Confidence is about the relative error, so a wall
    twice as far is twice as uncertain in position: inverse variance. The square of the slant's cosine is a heuristic:
    where depth changes fast from pixel to pixel, an edge that is a pixel off or smeared errs most.
    """
    _check_shapes(rgb, depth, confidence, intrinsics, world_from_camera)
    centred = np.array(intrinsics, np.float64)
    centred[:2, 2] -= 0.5
    trust = np.ones(depth.shape, np.float32) if confidence is None else np.asarray(confidence, np.float32)
    usable = np.isfinite(depth) & (depth > 0) & (depth <= max_depth) & (trust > 0)
    clean = np.where(usable, depth, 0).astype(np.float32)
    cosine = view_cosine(clean, centred)
    usable &= cosine >= np.cos(np.radians(max_grazing_deg))
    confidence_there = np.where(usable, np.minimum(trust, 1), np.float32(0))
    nearness = np.float32(typical_depth) / np.where(usable, clean, np.float32(np.inf))
    return DepthFrame(
        colour=rgb.astype(np.float32),
        depth=np.where(usable, clean, np.float32(0)),
        confidence=confidence_there,
        weight=(confidence_there * (cosine * nearness) ** 2).astype(np.float32),
        centred_intrinsics=centred,
        camera_from_world=np.linalg.inv(world_from_camera).astype(np.float64),
    )


def view_cosine(depth: Image, centred_intrinsics: NDArray[np.float64]) -> Image:
    """Cosine (H,W) of the angle between each pixel's ray and its surface's normal; 0 where there is no depth.

    With gradient (zu, zv) of z-depth in pixels, the normal is along (fx zu, fy zv, -(z + x fx zu + y fy zv)) for the
    ray (x, y, 1), and its product with the ray is -z. A fold's edge, smeared over several pixels by a depth network,
    is a steep ramp and shows as grazing.
    """
    fx, fy, cx, cy = (np.float32(value) for value in centred_intrinsics[[0, 1, 0, 1], [0, 1, 2, 2]])
    height, width = depth.shape
    x = ((np.arange(width, dtype=np.float32) - cx) / fx)[None, :]
    y = ((np.arange(height, dtype=np.float32) - cy) / fy)[:, None]
    across, down = fx * _slope(depth, axis=1), fy * _slope(depth, axis=0)
    normal_length = np.sqrt(across**2 + down**2 + (depth + x * across + y * down) ** 2)
    ray_length = np.sqrt(x**2 + y**2 + 1)
    return np.divide(depth, ray_length * normal_length, out=np.zeros_like(depth), where=depth > 0)


def _slope(depth: Image, axis: int) -> Image:
    """Central difference of depth (H,W) per pixel; one-sided beside a missing depth, 0 where both are missing."""
    image = np.moveaxis(depth, axis, 0)
    known = ((image[1:] > 0) & (image[:-1] > 0)).astype(np.float32)
    step = (image[1:] - image[:-1]) * known
    total, count = np.zeros(image.shape, np.float32), np.zeros(image.shape, np.float32)
    for place in (slice(1, None), slice(None, -1)):
        total[place] += step
        count[place] += known
    slope: NDArray[Any] = total / np.maximum(count, 1)
    return np.moveaxis(slope, 0, axis)


def _check_shapes(
    rgb: NDArray[np.uint8],
    depth: NDArray[np.float32],
    confidence: NDArray[np.float32] | None,
    intrinsics: NDArray[np.float64],
    world_from_camera: NDArray[np.float64],
) -> None:
    """Raise `ReconstructionError` unless the arrays of a frame fit each other."""
    if depth.ndim != 2 or min(depth.shape) < 2:
        raise ReconstructionError(f"depth must be (H,W), not {depth.shape}")
    if rgb.shape != (*depth.shape, 3) or rgb.dtype != np.uint8:
        raise ReconstructionError(f"rgb must be uint8 {(*depth.shape, 3)}, not {rgb.dtype} {rgb.shape}")
    if confidence is not None and confidence.shape != depth.shape:
        raise ReconstructionError(f"confidence must be {depth.shape} like depth, not {confidence.shape}")
    if np.shape(intrinsics) != (3, 3) or np.shape(world_from_camera) != (4, 4):
        raise ReconstructionError("intrinsics must be (3,3) and world_from_camera (4,4)")
    if not np.isfinite(world_from_camera).all():
        raise ReconstructionError("world_from_camera has values that are not finite")
