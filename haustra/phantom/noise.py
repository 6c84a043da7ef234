"""Smooth noise: fields in space, and signals along a path.

Texture and relief are functions of the 3-D position, not of the unrolled sheet, which is distorted at fold rims and
has a seam.
"""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy import fft
from scipy.interpolate import make_interp_spline
from scipy.ndimage import map_coordinates
from scipy.spatial.transform import Rotation

Floats = NDArray[np.float32]
MAX_VOXELS = 96  # per axis of a noise volume; the repetition after 96 voxels does not show on a curved wall


class SolidNoise:
    """Zero-mean, unit-variance field in space with wavelengths between two sizes in mm.

    Amplitude per octave falls as frequency**-slope. A periodic volume is filtered in the Fourier domain once and
    sampled by trilinear interpolation; its axes are rotated at random, so that its period does not show.
    """

    def __init__(self, largest_mm: float, smallest_mm: float, rng: np.random.Generator, slope: float = 0.0) -> None:
        self._voxel_mm = 0.5 * smallest_mm
        count = int(np.clip(3 * largest_mm / self._voxel_mm, 32, MAX_VOXELS))
        f = fft.fftfreq(count, self._voxel_mm)
        frequency = np.sqrt(f[:, None, None] ** 2 + f[None, :, None] ** 2 + fft.rfftfreq(count, self._voxel_mm) ** 2)
        frequency = np.maximum(frequency, 1e-9).astype(np.float32)
        band = np.exp(-((frequency * smallest_mm) ** 2) - (1.0 / (frequency * largest_mm)) ** 2)
        white = rng.standard_normal((count,) * 3, dtype=np.float32)
        volume = fft.irfftn(fft.rfftn(white) * (band * frequency ** -(slope + 1.5)), s=white.shape)
        self._volume = (volume / volume.std()).astype(np.float32)
        self._turn = Rotation.random(rng=rng).as_matrix().astype(np.float32)

    def __call__(self, points: Floats) -> Floats:
        """Values (...) at points (...,3) mm."""
        places = self._turn @ (points.reshape(-1, 3).T.astype(np.float32) / np.float32(self._voxel_mm))
        values = map_coordinates(self._volume, places, output=np.float32, order=1, mode="grid-wrap")
        return values.reshape(points.shape[:-1])

    def coarsely(self, points: Floats, step: int) -> Floats:
        """Values (R,C) on a sheet of points (R,C,3), evaluated at every `step`-th point and interpolated between."""
        coarse = self(points[step // 2 :: step, step // 2 :: step])
        return cv2.resize(coarse, (points.shape[1], points.shape[0]), interpolation=cv2.INTER_LINEAR)


def path_noise(count: int, period: float, rng: np.random.Generator) -> NDArray[np.float64]:
    """Smooth signal (count,), about within [-1, 1], whose swings last roughly `period` samples."""
    knots = rng.uniform(-1.0, 1.0, int(np.ceil(2.0 * count / period)) + 4)
    place = np.arange(count) * 2.0 / period + 1.5
    return make_interp_spline(np.arange(len(knots)), knots, k=3)(place)
