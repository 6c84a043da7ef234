"""SIFT features of a picture, and the form in which their descriptors are compared.

The tracker's corners sit wherever a cell of its grid was empty, so a second visit finds others. SIFT finds the same
ones.
"""

from collections.abc import Callable
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

MOST_FEATURES = 1000  # of a picture, the strongest
CONTRAST = 0.002  # a twentieth of OpenCV's: pale mucosa has little more


@dataclass(frozen=True)
class SiftFeatures:
    """pixels (N,2), COLMAP's convention; descriptors (N,128) as SIFT gives them; sizes (N,), pixels across."""

    pixels: Array
    descriptors: NDArray[np.uint8]
    sizes: Array

    def at(self, chosen: NDArray[np.bool_]) -> "SiftFeatures":
        return SiftFeatures(self.pixels[chosen], self.descriptors[chosen], self.sizes[chosen])


FindFeatures = Callable[[int], SiftFeatures]  # of a frame, by its number


def detect_sift(rgb: NDArray[np.uint8], mask: NDArray[np.uint8], contrast: float = CONTRAST) -> SiftFeatures:
    """The strongest SIFT features of a picture (H,W,3) within a mask (H,W)."""
    # Without `enable_precise_upscale` OpenCV puts every feature a quarter of a pixel too far right and down.
    detector = cv2.SIFT.create(nfeatures=MOST_FEATURES, contrastThreshold=contrast, enable_precise_upscale=True)
    keypoints, descriptors = detector.detectAndCompute(cv2.cvtColor(rgb, cv2.COLOR_RGB2GRAY), mask)
    if descriptors is None:
        return SiftFeatures(np.zeros((0, 2)), np.zeros((0, 128), dtype=np.uint8), np.zeros(0))
    pixels = np.array([k.pt for k in keypoints], dtype=np.float64) + 0.5
    return SiftFeatures(pixels, descriptors.astype(np.uint8), np.array([k.size for k in keypoints], dtype=np.float64))


def rootsift(descriptors: NDArray[np.uint8]) -> NDArray[np.float32]:
    """SIFT (N,128) to RootSIFT (Arandjelovic and Zisserman, CVPR 2012), (N,128), each of length one."""
    whole = descriptors.astype(np.float32)
    return np.sqrt(whole / np.maximum(whole.sum(axis=1, keepdims=True), 1e-6)).astype(np.float32)
