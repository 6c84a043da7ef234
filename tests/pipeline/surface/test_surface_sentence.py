"""What is said of a surface."""

import numpy as np
import pytest

from pipeline.surface.fusion_stage import Surface, _sentence
from pipeline.surface.scale import Scale
from reconstruction.mesh.surface_mesh import SurfaceMesh

MESH = SurfaceMesh(
    np.eye(3), np.arange(3)[None], np.zeros((3, 3), np.uint8), np.eye(3), np.zeros(3, np.float32), np.zeros(3, np.int64)
)


@pytest.mark.parametrize(
    ("unit", "left_out", "told"),
    [
        ("mm", (), "voxel 0.5 mm; 1.0 % of the area was loose and dropped; said so"),
        (
            "scene",
            (4,),
            "voxel 0.5 scene units; 1.0 % of the area was loose and dropped",
        ),
        ("scene", (4,), "; without 1 keyframe that the others contradict"),
        ("scene", (4, 7), "without 2 keyframes that the others contradict"),
    ],
)
def test_units_and_keyframes_left_out_are_words(unit, left_out, told):
    assert told in _sentence(Surface(MESH, Scale(1.0, unit, "said so"), 0.5, 0.01, left_out))
