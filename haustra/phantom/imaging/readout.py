"""Readout in parts: a picture whose lines or colours were exposed one after the other.

An interlaced film combs where anything moves: the odd lines are half a frame later than the even ones. A processor
that lights the wall with red, green and blue in turn fringes: each colour is a third of a frame apart.
The truth of such a frame (pose, depth, triangles) is that of its nominal time: of the even lines, or of green.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float32]
EXPOSURES = {"at_once": (0.0,), "interlaced": (0.0, 0.5), "sequential": (0.0, -1 / 3, 1 / 3)}  # frames; nominal first


def assembled(parts: Sequence[NDArray[Any]], readout: str) -> NDArray[Any]:
    """One picture (H,W,3) from those at the EXPOSURES of a readout."""
    picture = parts[0].copy()
    if readout == "interlaced":
        picture[1::2] = parts[1][1::2]
    elif readout == "sequential":
        picture[..., 0], picture[..., 2] = parts[1][..., 0], parts[2][..., 2]
    return picture
