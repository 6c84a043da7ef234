"""What the rest of the project asks of a lens model."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Distortion = tuple[float, ...]


@dataclass(frozen=True)
class LensModel:
    """A family of lenses. A picture's point is focal length times `distort` plus the centre.

    parameters: how many there are, `focal_lengths` (1 or 2) and the centre's two among them; the others are distortion.
    distort: points (N,3) in the camera's axes -> (N,2), a pinhole's x/z and y/z where there is no distortion.
    first_guess: (N,2) distorted -> (N,2) near x/z and y/z, from which Newton's method inverts `distort`.
    valid_angle: angle off the axis, rad, beyond which the model turns back on itself; infinite if nowhere.
    widest: angle, rad, up to which the field of view is searched.
    straight_at_zero: whether it is a pinhole where all distortion is zero.
    in_colmap: whether COLMAP has it by this name.
    undistort: (N,2) distorted -> (N,2) x/z and y/z, where that has a closed form; None: by Newton's method.
    """

    parameters: int
    focal_lengths: int
    distort: Callable[[Array, Distortion], Array]
    first_guess: Callable[[Array], Array]
    valid_angle: Callable[[Distortion], float]
    widest: float = 1.5
    straight_at_zero: bool = True
    in_colmap: bool = True
    undistort: Callable[[Array, Distortion], Array] | None = None
