"""How far apart frames lie that are chosen by the camera's motion between them."""

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

LEAST_FRAMES = 32  # of a film that has as many
HALVINGS = 3  # of the motion between two of them; the errors of poses and tracks are no motion


def least_of_each(frames: Sequence[int]) -> list[int]:
    """How many frames to choose at least from submaps with so many frames: together `LEAST_FRAMES`, by their shares."""
    return [-(-LEAST_FRAMES * count // sum(frames)) for count in frames]


def closer_where_few(
    choose: Callable[[float], NDArray[np.int64]], motion: float, available: int, least: int
) -> NDArray[np.int64]:
    """Rows of the frames that `choose` takes `motion` apart; if they are fewer than `least`, so many, closer together.

    available: how many there are to choose from. Where a camera hovers, a few frames hold all of its motion: few rays
    meet in a point then, and there are few depth maps to average.
    """
    rows = choose(motion)
    least = min(least, available)
    if len(rows) >= least:
        return rows
    for _ in range(HALVINGS):
        motion /= 2
        rows = choose(motion)
        if len(rows) >= least:
            break
    evenly = np.linspace(0, len(rows) - 1, min(len(rows), least)).round().astype(np.int64)
    return rows[evenly]
