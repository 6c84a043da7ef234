"""Sharpness and roughness of completed depth: what they tell apart."""

import cv2
import numpy as np

from benchmarks.paper.figure_4 import edge_figures
from completion.evaluation.evaluate import FrameResult
from completion.evaluation.metrics import depth_errors


def result(prediction):
    truth = np.where(np.arange(120)[None] < 60, 20.0, 40.0) + np.linspace(0, 1, 100)[:, None]
    image = np.zeros((*truth.shape, 3), np.uint8)
    given = prediction(truth)
    return FrameResult("0", 1, depth_errors(given, truth), image, truth, np.zeros_like(truth), given, None)


def test_blur_is_not_sharp_and_a_shifted_edge_is():
    assert edge_figures(result(lambda truth: truth)) == (1.0, 1.0)
    shifted, _ = edge_figures(result(lambda truth: np.roll(truth, 3, axis=1)))
    blurred, _ = edge_figures(result(lambda truth: cv2.GaussianBlur(truth, (0, 0), 2)))
    assert shifted == 1.0
    assert blurred < 0.6
    assert edge_figures(result(lambda truth: np.full_like(truth, 30.0)))[0] == 0.0


def test_noise_is_rough():
    rng = np.random.default_rng(0)
    assert edge_figures(result(lambda truth: truth * np.exp(0.02 * rng.normal(size=truth.shape))))[1] > 5
