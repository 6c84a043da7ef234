"""Similarities, Sim(3), as 4x4 matrices whose upper left corner is scale times rotation."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from haustra.core.errors import ReconstructionError

Array = NDArray[np.floating[Any]]


def scale_of(similarity: Array) -> Array:
    """Scale of one similarity (4,4), a scalar, or of many (N,4,4), (N,). Also of (3,3) and (N,3,3) linear parts."""
    return np.cbrt(np.linalg.det(similarity[..., :3, :3]))


def transform_points(target_from_source: Array, points: Array) -> Array:
    """Points (N,3) moved by a similarity (4,4)."""
    return points @ target_from_source[:3, :3].T + target_from_source[:3, 3]


def transform_camera(target_from_source: Array, camera_from_source: Array) -> Array:
    """`camera_from_target` (4,4), rigid, in the target's unit, of a camera given by `camera_from_source`."""
    scale, result = float(scale_of(target_from_source)), np.eye(4)
    result[:3, :3] = camera_from_source[:3, :3] @ (target_from_source[:3, :3] / scale).T
    result[:3, 3] = scale * camera_from_source[:3, 3] - result[:3, :3] @ target_from_source[:3, 3]
    return result


def umeyama(source: Array, target: Array, with_scale: bool) -> NDArray[np.float64]:
    """The 4x4 `target_from_source` that minimises the squared distance of points (N,3) to their partners.

    Umeyama, "Least-squares estimation of transformation parameters between two point patterns", PAMI 1991;
    the equation numbers are his. Points on one line leave the roll about it free: any minimiser is returned.
    """
    if source.shape != target.shape or source.ndim != 2 or source.shape[1] != 3 or len(source) < 2:
        raise ReconstructionError(f"alignment needs two or more pairs of points, got {source.shape} and {target.shape}")
    target_from_source = umeyama_batch(source[None], target[None], with_scale)[0]
    if not np.isfinite(target_from_source).all():
        raise ReconstructionError("the camera does not move, so the scale of its path cannot be aligned")
    return target_from_source


def umeyama_batch(source: Array, target: Array, with_scale: bool) -> NDArray[np.float64]:
    """(K,4,4), as `umeyama` gives them, of K sets of points (K,N,3); NaN where no scale can be aligned."""
    source_mean, target_mean = source.mean(axis=1, keepdims=True), target.mean(axis=1, keepdims=True)  # eqs. 34, 35
    source_variance = ((source - source_mean) ** 2).sum(axis=2).mean(axis=1)  # eq. 36
    covariance = np.swapaxes(target - target_mean, 1, 2) @ (source - source_mean) / source.shape[1]  # eq. 38
    u, singular, vt = np.linalg.svd(covariance)
    signs = np.ones_like(singular)
    signs[:, 2] = np.sign(np.linalg.det(u) * np.linalg.det(vt))  # eqs. 39, 43: no mirror
    scale = np.ones(len(source))
    if with_scale:
        known = (singular[:, 0] > 0) & (source_variance > 0)
        scale = np.where(known, (singular * signs).sum(axis=1) / np.where(known, source_variance, 1), np.nan)  # eq. 42
    found = np.tile(np.eye(4), (len(source), 1, 1))
    found[:, :3, :3] = scale[:, None, None] * (u * signs[:, None]) @ vt  # eq. 40
    found[:, :3, 3] = target_mean[:, 0] - np.einsum("kij,kj->ki", found[:, :3, :3], source_mean[:, 0])  # eq. 41
    return found
