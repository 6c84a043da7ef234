"""One lens and its rays by OpenCV, for tests of camera files."""

import cv2
import numpy as np
from numpy.typing import NDArray

from haustra.core.camera import Camera

K = np.array([[410.0, 0, 322.5], [0, 405.0, 238.25], [0, 0, 1]])  # OpenCV's pixels
TERMS = (-0.2, 0.05, 0.001, -0.002, 0.01)
FISHEYE = (-0.13, -0.006, 0.0016, -0.0001)
PINHOLE_RAYS = np.random.default_rng(0).uniform([-0.7, -0.5, 1], [0.7, 0.5, 1.001], (300, 3))
HALF_PIXEL = 0.5


def opencv_pixels(rays: NDArray, matrix: NDArray, terms: tuple[float, ...]) -> NDArray:
    """(N,2) in COLMAP's pixels, by OpenCV."""
    pixels, _ = cv2.projectPoints(rays, np.zeros(3), np.zeros(3), matrix, np.array(terms, float))
    return pixels[:, 0] + HALF_PIXEL


def fisheye_pixels(rays: NDArray, matrix: NDArray, terms: tuple[float, ...]) -> NDArray:
    """The same by OpenCV's fisheye."""
    zero = np.zeros(3)
    matrix = np.asarray(matrix, np.float64)
    pixels, _ = cv2.fisheye.projectPoints(rays[:, None], zero, zero, matrix, np.array(terms, float))
    return pixels[:, 0] + HALF_PIXEL


def ray_error(camera: Camera, pixels: NDArray, rays: NDArray) -> float:
    """Largest angle, rad, between the camera's rays of pixels (N,2) and the true ones (N,3); infinite where the camera
    has none."""
    plane, known = camera.unproject(pixels)
    found = np.column_stack([plane, np.ones(len(plane))])
    cross = np.cross(found, rays)
    sine = np.linalg.norm(cross, axis=1) / (np.linalg.norm(found, axis=1) * np.linalg.norm(rays, axis=1))
    return float(np.where(known, sine, np.inf).max())
