"""The picture of a surface from outside shows the side that was seen."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from reconstruction.mesh.rendering import render_mesh
from reconstruction.mesh.surface_mesh import SurfaceMesh


def bent_patch(turn: np.ndarray, arc_deg: float) -> SurfaceMesh:
    """Part of a tube's wall of length 6 and radius 1, whose faces look at the tube's axis."""
    along, around = np.meshgrid(np.linspace(0, 6, 25), np.radians(np.linspace(0, arc_deg, 25)), indexing="ij")
    vertices = np.stack([along, np.cos(around), np.sin(around)], axis=-1).reshape(-1, 3)
    corner = (np.arange(24)[:, None] * 25 + np.arange(24)).ravel()
    faces = np.concatenate(
        [
            np.column_stack([corner, corner + 25, corner + 1]),
            np.column_stack([corner + 1, corner + 25, corner + 26]),
        ]
    )
    mesh = SurfaceMesh.from_triangles(vertices, faces)
    inward = -vertices[faces].mean(axis=1) * [0, 1, 1]
    assert (np.sum(mesh.face_normals * inward, axis=1) > 0).all()
    return SurfaceMesh.from_triangles(vertices @ turn.T, faces)


@pytest.mark.parametrize("arc_deg", [60.0, 150.0])
@pytest.mark.parametrize("seed", range(6))
def test_wall_that_was_seen_on_one_side_is_shown_from_that_side(seed, arc_deg):
    patch = bent_patch(Rotation.random(random_state=seed).as_matrix(), arc_deg)
    for size in ((96, 72), (72, 96)):
        picture = render_mesh(patch, None, *size, cut_away=True)
        shown = (picture != 255).any(axis=2)
        columns, rows = np.flatnonzero(shown.any(axis=0)), np.flatnonzero(shown.any(axis=1))
        assert np.ptp(columns) > 0.8 * size[0] or np.ptp(rows) > 0.8 * size[1]
        box = shown[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1]
        assert box.mean() > 0.8  # a rectangle without holes
