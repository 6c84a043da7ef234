"""True motion of a living wall, read back from a film's folder."""

import numpy as np

from benchmarks.common.living_truth import TrueMotion
from haustra.phantom.motion.living_wall import WallState, displaced

STATE = WallState(((30.0, 3.0),), 0.5, (0.4, -0.2, 0.1), (10.0, 0.0, 20.0), (1.5, 0.0, 0.0))


def tube():
    """Vertices (V,3), axis points and arc (V,) of a tube of radius 10 along z."""
    arc, angle = (a.ravel() for a in np.meshgrid(np.arange(0, 60, 1.0), np.linspace(0, 2 * np.pi, 80, endpoint=False)))
    vertices = np.column_stack([10 * np.cos(angle), 10 * np.sin(angle), arc])
    return vertices, np.column_stack([0 * arc, 0 * arc, arc]), arc


def test_points_of_the_moved_wall_are_taken_back_to_rest():
    vertices, axis, arc = tube()
    motion = TrueMotion(vertices, axis, arc, [STATE])
    asked = np.arange(0, len(vertices), 7)
    between = vertices[asked] + np.array([0, 0, 0.37])  # no vertex of the mesh
    moved = displaced(between, axis[asked] + np.array([0, 0, 0.37]), arc[asked] + 0.37, STATE)
    assert np.linalg.norm(moved - between, axis=1).max() > 2
    back = moved + motion.to_rest(moved, 0)
    assert np.median(np.linalg.norm(back - between, axis=1)) < 0.05


def test_a_still_film_has_no_motion(tmp_path):
    assert TrueMotion.of(tmp_path) is None
