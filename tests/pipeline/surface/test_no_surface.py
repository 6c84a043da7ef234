"""The sentence about an empty surface names what was measured: the depth, its expected error, or the keyframes."""

import re
from types import SimpleNamespace

import numpy as np
import pytest

from completion.confidence import confidence_from_error
from pipeline.config import FusionSettings
from pipeline.surface.no_surface import why_no_surface

KEYFRAMES = 5


class Submap(SimpleNamespace):
    """Walls at a median depth of 2 scene units, expected to err by 1 % of it."""

    def __len__(self):
        return KEYFRAMES


def submap(shown=1.0):
    depth = np.where(np.arange(400).reshape(20, 20) < 400 * shown, 2, 0).astype(np.float32)
    confidence = confidence_from_error(np.full_like(depth, 0.01))
    return Submap(rows=np.arange(KEYFRAMES), depth=lambda row: (depth, confidence, np.eye(4)))


@pytest.mark.parametrize(
    ("settings", "voxel_size", "sentence"),
    [
        ({"voxel_size": 1e-7}, 1e-7, "expected error is 0.02 scene units in the median, and at most 3e-07 is fused"),
        ({"max_error_voxels": 1e-9}, 0.02, "at most 2e-11 is fused, 1e-09 voxels of 0.02"),
        ({"voxel_size": 50}, 50, "voxels of 50 scene units are too large for wall at 2 scene units"),
        ({}, 0.02, r"agree on no surface: .* contradict each other \(5 keyframes\)"),
        ({"min_observations": 3}, 0.02, r"\(5 keyframes, 3 must agree\)"),
    ],
)
def test_what_is_named(settings, voxel_size, sentence):
    told = why_no_surface(submap(), FusionSettings(**settings), voxel_size)
    assert re.search(sentence, told), told


def test_without_any_depth():
    assert "agree on no surface" in why_no_surface(submap(shown=0), FusionSettings(), 0.0)
