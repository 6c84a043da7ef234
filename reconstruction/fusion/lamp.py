"""A lamp that was measured: how its light falls off its own axis, and how the lens darkens the picture's edge.

What is fitted to a film, with or without such a lamp, is `photometry.Illumination`.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True)
class Lamp:
    """EndoMapper's spot light (Modrzejewski et al. 2020): e^(-spread (1 - axis . ray)), times cos(phi)^vignetting, phi
    between ray and optical axis.

    axis: unit vector in the camera's axes. gamma: of the picture's grey levels, light^(1/gamma). Where the lamp sits,
    some mm beside the lens, is not used: the wall's distance from the lens stands for that from the lamp.
    """

    axis: tuple[float, float, float]
    spread: float
    vignetting: float = 0.0
    gamma: float = 2.2

    def log_emission(self, rays: NDArray[np.float32]) -> NDArray[np.float32]:
        """(...) of unit rays (...,3): 0 along a lamp's axis that is the optical one."""
        ahead = np.log(np.maximum(rays[..., 2], 1e-6))
        fall = 1 - rays @ np.array(self.axis, np.float32)
        return np.asarray(self.vignetting * ahead - self.spread * fall, np.float32)
