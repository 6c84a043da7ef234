"""Why a submap's depth made no surface, in one sentence."""

import numpy as np

from completion.confidence import error_from_confidence
from haustra.core.text import counted
from pipeline.config import FusionSettings
from pipeline.depth.completed_submap import CompletedSubmap
from pipeline.surface.depth_filter import LEAST_CONFIDENCE

LARGEST_VOXEL = 0.2  # of the median depth; a wall that a camera sees is then one or two voxels across
LEAST_SURE = 0.01  # share of the pixels with depth; where fewer are sure enough, that is the reason
SAMPLES = 12  # keyframes looked at


def why_no_surface(completed: CompletedSubmap, settings: FusionSettings, voxel_size: float) -> str:
    """voxel_size: scene units, as it was fused; 0 without any depth."""
    step = max(1, len(completed) // SAMPLES)
    maps = [completed.depth(int(row)) for row in completed.rows[::step]]
    depth = np.concatenate([depth[depth > 0] for depth, *_ in maps]) if maps else np.zeros(0)
    if len(depth) and voxel_size > LARGEST_VOXEL * float(np.median(depth)):
        return (
            f"voxels of {voxel_size:.3g} scene units are too large for wall at {np.median(depth):.3g} scene units, the "
            "median depth: make fusion.voxel_size smaller"
        )
    confidence = np.concatenate([confidence[depth > 0] for depth, confidence, _ in maps]) if maps else np.zeros(0)
    error = depth * error_from_confidence(confidence.astype(np.float32), LEAST_CONFIDENCE)
    limit = settings.max_error_voxels * voxel_size
    if len(depth) and (error <= limit).mean() < LEAST_SURE:
        return (
            f"no depth is sure enough to be fused: its expected error is {np.median(error):.3g} scene units in the "
            f"median, and at most {limit:.3g} is fused, {settings.max_error_voxels:g} voxels of {voxel_size:.3g}; "
            "make fusion.voxel_size or fusion.max_error_voxels larger"
        )
    agreeing = f", {settings.min_observations} must agree" if settings.min_observations > 1 else ""
    return (
        "the keyframes agree on no surface: too few of them see the same place, or they contradict each other "
        f"({counted(len(completed), 'keyframe')}{agreeing})"
    )
