"""Boundary edges, beside trimesh's; the rays of a picture do not depend on how many are cast at once."""

import numpy as np
import pytest
import trimesh
from hypothesis import given
from hypothesis import strategies as st

from reconstruction.mesh import rendering
from reconstruction.mesh.surface_mesh import SurfaceMesh, boundary_sides, vertex_normals


def opened_ball(missing=7):
    ball = trimesh.creation.icosphere(subdivisions=3)
    return np.asarray(ball.vertices), np.asarray(ball.faces).astype(np.int64)[missing:]


@given(st.lists(st.tuples(*3 * [st.integers(0, 8)]), max_size=40))
def test_a_side_is_a_boundary_where_no_other_face_has_its_edge(faces):
    corners = np.array(faces, np.int64).reshape(-1, 3)
    edges = [[tuple(sorted((b, c))), tuple(sorted((c, a))), tuple(sorted((a, b)))] for a, b, c in corners.tolist()]
    every = [edge for of_face in edges for edge in of_face]
    expected = [[every.count(edge) == 1 for edge in of_face] for of_face in edges]
    np.testing.assert_array_equal(boundary_sides(corners), np.array(expected, bool).reshape(-1, 3))


def test_the_boundary_of_an_opened_ball_is_trimeshs():
    vertices, faces = opened_ball()
    sides = boundary_sides(faces)
    edges = np.sort(faces[:, [[1, 2], [2, 0], [0, 1]]], axis=2)[sides]
    mesh = trimesh.Trimesh(vertices, faces, process=False)
    alone = mesh.edges_sorted[trimesh.grouping.group_rows(mesh.edges_sorted, require_count=1)]
    assert {tuple(edge) for edge in edges} == {tuple(edge) for edge in alone.tolist()}
    assert sides.sum() == len(alone) > 3


def test_normals_do_not_depend_on_how_many_faces_are_taken_at_once(monkeypatch):
    vertices, faces = opened_ball()
    whole = vertex_normals(vertices, faces)
    monkeypatch.setattr("reconstruction.mesh.surface_mesh.CHUNK", 11)
    np.testing.assert_array_equal(vertex_normals(vertices, faces), whole)
    np.testing.assert_allclose(whole, vertices, atol=0.1)


@pytest.mark.parametrize("cut_away", [False, True])
def test_a_picture_does_not_depend_on_how_many_rays_are_cast_at_once(monkeypatch, cut_away):
    mesh = SurfaceMesh.from_triangles(*opened_ball())
    whole = rendering.render_mesh(mesh, None, 48, 36, cut_away=cut_away)
    monkeypatch.setattr(rendering, "CHUNK", 100)
    np.testing.assert_array_equal(rendering.render_mesh(mesh, None, 48, 36, cut_away=cut_away), whole)
    assert len(np.unique(whole)) > 10
