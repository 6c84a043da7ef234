"""How far apart frames lie that are chosen from a film by the camera's motion between them."""

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

LEAST_FRAMES = 32  # of a film, where it has so many
CLOSER = 0.7  # times the motion between two of them
MOST_ROUNDS = 6  # then it is an eighth; frames that are nearer still are duplicates


def closer_where_few(choose: Callable[[float], NDArray[np.int64]], motion: float) -> NDArray[np.int64]:
    """The rows of frames that `choose` gives for `motion`; while they are fewer than `LEAST_FRAMES`, for less of it.

    Where a camera hovers, a few frames hold all of its motion: few rays for a point, and few depth maps to average.
    """
    rows = choose(motion)
    for _ in range(MOST_ROUNDS):
        if len(rows) >= LEAST_FRAMES:
            break
        motion *= CLOSER
        rows = choose(motion)
    return rows
