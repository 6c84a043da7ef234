"""How far apart frames lie that are chosen by the camera's motion between them."""

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

LEAST_FRAMES = 32  # of a film that has as many
HALVINGS = 3  # of the motion between two of them, at most: the errors of poses and tracks are no motion


def least_of_each(frames: Sequence[int]) -> list[int]:
    """How many frames to choose at least from submaps with so many frames: together at least `LEAST_FRAMES`."""
    return [-(-LEAST_FRAMES * count // sum(frames)) for count in frames]


def closer_where_few(
    choose: Callable[[float], NDArray[np.int64]], motion: float, available: int, least: int
) -> NDArray[np.int64]:
    """Rows of the frames that `choose` takes `motion` apart; if they are fewer than `least`, with others between them
    up to so many, no closer than an eighth of `motion`.

    available: how many there are to choose from. Where a camera hovers, a few frames hold all of its motion: few rays
    meet in a point then, and there are few depth maps to average.
    """
    rows = closer = choose(motion)
    least = min(least, available)
    for _ in range(HALVINGS):
        if len(closer) >= least:
            break
        motion /= 2
        closer = choose(motion)
    between = np.setdiff1d(closer, rows)
    count = min(max(least - len(rows), 0), len(between))
    evenly = np.linspace(0, len(between) - 1, count).round().astype(np.int64)
    return np.union1d(rows, between[evenly])
