"""Depth between sparse points of a picture: inverse depth is linear across a plane's image."""

import numpy as np
from scipy.interpolate import LinearNDInterpolator
from scipy.spatial import Delaunay, QhullError

from haustra.core.se3 import Array


def delaunay(pixels: Array) -> Delaunay | None:
    """Triangles of pixels (K,2); None where there are none: fewer than four pixels, or all on one line."""
    try:
        return Delaunay(pixels) if len(pixels) > 3 else None
    except QhullError:
        return None


def interpolate_inverse_depth(pixels: Array, triangles: Delaunay | None, depth: Array) -> Array:
    """(N,) inverse depth at pixels (N,2) from those of the triangles' corners, of depth (K,); NaN outside them."""
    if triangles is None:
        return np.full(len(pixels), np.nan)
    return LinearNDInterpolator(triangles, 1 / depth)(pixels)
