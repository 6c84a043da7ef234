"""Whether a wall moved while it was filmed, by points that had no part in finding the motion.

A still map misses its observations by noise, and by what of the wall's motion the camera path has not taken up. The
points are parted in two. A smooth field of offsets (`offset_field`) is fitted to what the map misses one half by, and
foretells what it misses the other half by. Noise, sliding corners and outliers foretell nothing; what is foretold is
wall that moved. By how much is not said: a camera path and points that were adjusted as if it stood still have taken up
most of its motion (docs/lab/living.md).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from reconstruction.motion.offset_field import fit_offsets, make_field

Array = NDArray[np.float64]
NODES, KNOT_S = 60, 0.3  # knots as dense as a contraction that passes in half a second needs
SIGMA = 0.005  # of an offset that a map leaves, in median depths: 0.15 mm at 30 mm; chosen of 0.002 to 0.01
NOISE_PX = 0.5
LOSS_PX = 1.0  # Cauchy
CELL = 0.05  # median depths: points so near may be one corner found twice, whose errors are the same
TOLD = 0.02  # share of the held-out residuals; of still walls through the right lens it was below -0.01
LEAST_POINTS, LEAST_SECONDS = 50, 1.0


@dataclass(frozen=True)
class Residuals:
    """M observations of a still map, lengths in units of its median depth.

    point (M,): number of the point. world (M,3): where the map has it. seconds (M,). pixels (M,2): how far beside the
    observation the map's point is seen. jacobian (M,2,3): of that by the point.
    """

    point: NDArray[np.int64]
    world: Array
    seconds: Array
    pixels: Array
    jacobian: Array


@dataclass(frozen=True)
class HeldOutMotion:
    """before: sum of the weighted squares of the held-out residuals. gained: how much less it is with what the motion
    of the others foretells; negative where that only adds."""

    before: float
    gained: float

    @property
    def explained(self) -> float:
        """Share of the held-out squared residuals that is foretold."""
        return self.gained / max(self.before, 1e-12)

    @property
    def is_told(self) -> bool:
        """Whether neighbouring points miss a still map together: by motion of the wall, or by what looks like it."""
        return self.explained > TOLD

    def __add__(self, other: HeldOutMotion) -> HeldOutMotion:
        return HeldOutMotion(self.before + other.before, self.gained + other.gained)


def held_out_motion(seen: Residuals) -> HeldOutMotion | None:
    """None where too few points are followed for too short a time to tell."""
    points, first = np.unique(seen.point, return_index=True)
    if len(points) < LEAST_POINTS or np.ptp(seen.seconds) < LEAST_SECONDS:
        return None
    field = make_field(seen.world[first], seen.seconds, NODES, KNOT_S)
    weights, fold = field.weights(seen.world, seen.seconds), np.floor(seen.world / CELL).sum(axis=1) % 2
    weight = 1 / (1 + (seen.pixels**2).sum(axis=1) / LOSS_PX**2) / NOISE_PX**2
    foretold = np.zeros_like(seen.pixels)
    for number in (0, 1):
        known, asked = fold != number, fold == number
        found = fit_offsets(weights[known], seen.jacobian[known], seen.pixels[known], weight[known], SIGMA)
        foretold[asked] = np.einsum("mij,mj->mi", seen.jacobian[asked], weights[asked] @ found)
    before = weight @ (seen.pixels**2).sum(axis=1)
    after = weight @ ((seen.pixels + foretold) ** 2).sum(axis=1)
    return HeldOutMotion(float(before), float(before - after))
