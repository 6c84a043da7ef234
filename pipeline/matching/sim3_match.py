"""A verified match of two keyframes: one similarity that many of their features agree on, in both pictures.

Used before the depth, to merge submaps that saw the same place, and after it, to close loops.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from haustra.core.ray_table import RayTable
from haustra.core.se3 import Array
from haustra.core.threads import prefetched, workers
from pipeline.matching.descriptor_matching import match_descriptors
from pipeline.matching.keyframe_features import MIN_FEATURES, KeyframeFeatures
from pipeline.matching.sim3_ransac import Correspondences, refine_similarity, verified_similarity

STATIC_PX = 1.0  # features that lie at the same pixel of both pictures are dirt, text or a reflection
# Of the matches. Keyframes that do not show the same agree in 12 of them at most, a fifth: the number of inliers, 20,
# is the stricter limit there, the share where there are hundreds of matches (docs/lab/front_end.md).
MIN_INLIER_SHARE = 0.2
MAX_ROUNDS = 1000  # so few that agree are met in 99.9 of 100 tries

Rows = NDArray[np.int64]


@dataclass(frozen=True)
class Sim3Match:
    """Two keyframes' features, numbers `first` and `second` of two lists, and the similarity (4,4) between the axes and
    units of their cameras. rows (K,2): the features that agree."""

    first: int
    second: int
    first_from_second: NDArray[np.float64]
    rows: Rows

    @property
    def inliers(self) -> int:
        return len(self.rows)


def candidate_rows(first: KeyframeFeatures, second: KeyframeFeatures, drop_static: bool) -> Rows:
    """(K,2) features that look alike; with `drop_static` not those at the same pixel of both pictures.

    Where the camera may have come back to the very view, what is at the same pixel may be wall, and must stay.
    """
    rows = match_descriptors(first.rootsift, second.rootsift)
    if not drop_static:
        return rows
    way = np.linalg.norm(first.pixels[rows[:, 0]] - second.pixels[rows[:, 1]], axis=1)
    return rows[way > STATIC_PX]


def rows_of_pairs(
    first: Sequence[KeyframeFeatures],
    second: Sequence[KeyframeFeatures],
    pairs: Sequence[tuple[int, int]],
    drop_static: bool,
) -> Iterator[Rows]:
    """`candidate_rows` of each pair of numbers in the two lists, in their order; the next ones are found by other
    threads while the caller works on the last."""

    def of(pair: tuple[int, int]) -> Rows:
        return candidate_rows(first[pair[0]], second[pair[1]], drop_static)

    return prefetched(of, pairs, workers(), workers())


def correspondences(
    features: KeyframeFeatures, rows: Rows, rays: RayTable, camera_from_world: Array | None = None
) -> Correspondences:
    """Features `rows` (K,) with their points in a world; without one in the camera's own axes."""
    xy, jacobian = rays.unproject(features.pixels[rows])
    if camera_from_world is None:
        return Correspondences(features.points[rows], np.eye(4), xy, jacobian)
    return Correspondences(features.world_points(camera_from_world)[rows], camera_from_world, xy, jacobian)


def verify_match(
    numbers: tuple[int, int],
    first: KeyframeFeatures,
    second: KeyframeFeatures,
    rays: tuple[RayTable, RayTable],
    rng: np.random.Generator,
    rows: Rows,
) -> Sim3Match | None:
    """The match of two keyframes, numbers `numbers` of their lists; None where too few features agree on one
    similarity, or where they lie too close together to determine it. rows: their `candidate_rows`."""
    if min(len(first), len(second)) < MIN_FEATURES:
        return None
    here, there = (correspondences(f, r, table) for f, r, table in zip((first, second), rows.T, rays, strict=True))
    pixels = second.pixels[rows[:, 1]], first.pixels[rows[:, 0]]
    found = verified_similarity(there, here, pixels, rays[0].camera.width, rng, MIN_INLIER_SHARE, MAX_ROUNDS)
    if found is None:
        return None
    start, inlier = found
    refined = refine_similarity(start, [(there.at(inlier), here.at(inlier))])
    return Sim3Match(*numbers, np.asarray(refined, np.float64), rows[inlier])
