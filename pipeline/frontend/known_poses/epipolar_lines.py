"""Matched features of posed frames, and how far each lies from the epipolar line that the poses give it."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from haustra.core.ray_table import RayTable
from haustra.core.se3 import Array
from pipeline.matching.descriptor_matching import match_descriptors
from pipeline.matching.sift import FindFeatures, rootsift

PAIRS = 12  # spread over the film
GAPS = (2, 4, 8, 16, 32)  # posed frames between the two of a pair, until the picture has moved
LEAST_MOTION = 0.02  # of the width, in the median: less says nothing
FEWEST_MATCHES = 15  # of a pair
OFF_LINE_PX, OFF_LINE_SHARE = 1.5, 0.15  # of an inlier, the larger of px and share of its way


@dataclass(frozen=True)
class MatchedPair:
    """Two posed frames, by their rows, and the unit rays (K,3), (K,3) of what is the same in both; way (K,) in px."""

    rows: tuple[int, int]
    first: Array
    second: Array
    way: Array


def matched_pairs(frames: Sequence[int], rays: RayTable, find: FindFeatures) -> list[MatchedPair]:
    """Pairs of posed frames, spread over the film, between which the picture has moved."""
    pairs: list[MatchedPair] = []
    if len(frames) <= GAPS[0]:
        return pairs
    for row in np.unique(np.linspace(0, len(frames) - 1 - GAPS[0], PAIRS).round().astype(int)):
        for gap in GAPS:
            if row + gap >= len(frames):
                break
            pair = _matched(int(row), int(row + gap), frames, rays, find)
            if pair is not None and np.median(pair.way) >= LEAST_MOTION * rays.camera.width:
                pairs.append(pair)
                break
    return pairs


def _matched(row: int, other: int, frames: Sequence[int], rays: RayTable, find: FindFeatures) -> MatchedPair | None:
    here, there = find(frames[row]), find(frames[other])
    same = match_descriptors(rootsift(here.descriptors), rootsift(there.descriptors))
    if len(same) < FEWEST_MATCHES:
        return None
    first, second = here.pixels[same[:, 0]], there.pixels[same[:, 1]]
    way = np.linalg.norm(second - first, axis=1)
    return MatchedPair((row, other), unit_rays(rays, first), unit_rays(rays, second), way)


def unit_rays(rays: RayTable, pixels: Array) -> Array:
    """(N,2) pixels -> (N,3) in the camera's axes."""
    plane, _ = rays.unproject(pixels)
    found = np.concatenate([plane, np.ones((len(plane), 1))], axis=1)
    return found / np.linalg.norm(found, axis=1, keepdims=True)


def off_line_px(pair: MatchedPair, world_from_camera: Array, focal_px: float) -> Array:
    """(K,) distance of each match's second ray from the epipolar plane of the poses (N,4,4), as px at the centre."""
    turned, shift = _in_second(pair, world_from_camera)
    normal = np.cross(turned, shift)
    normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-12)
    off: Array = focal_px * np.abs(np.einsum("ki,ki->k", normal, pair.second))
    return off


def inliers(pair: MatchedPair, world_from_camera: Array, focal_px: float) -> tuple[NDArray[np.bool_], Array]:
    """(K,) whether each match lies on its epipolar line and before both cameras, and (K,) its depth in the first."""
    turned, shift = _in_second(pair, world_from_camera)
    off_px = off_line_px(pair, world_from_camera, focal_px)
    across = np.cross(pair.second, turned)
    square = np.maximum(np.einsum("ki,ki->k", across, across), 1e-12)
    near = -np.einsum("ki,ki->k", across, np.cross(pair.second, shift)) / square
    far = -np.einsum("ki,ki->k", across, np.cross(turned, shift)) / square
    fits = off_px < np.maximum(OFF_LINE_PX, OFF_LINE_SHARE * pair.way)
    return fits & (near > 0) & (far > 0), near * pair.first[:, 2]


def _in_second(pair: MatchedPair, world_from_camera: Array) -> tuple[Array, Array]:
    """The first rays (K,3) turned into the second camera's axes, and the first camera's centre (3,) there."""
    here, there = world_from_camera[pair.rows[0]], world_from_camera[pair.rows[1]]
    turn = there[:3, :3].T @ here[:3, :3]
    return pair.first @ turn.T, there[:3, :3].T @ (here[:3, 3] - there[:3, 3])
