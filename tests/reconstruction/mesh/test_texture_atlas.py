"""Light textured meshes against the fine ones they stand for."""

import numpy as np
import pytest
import trimesh

from haustra.core.errors import ReconstructionError
from reconstruction.mesh.mesh_io import write_textured
from reconstruction.mesh.surface_mesh import SurfaceMesh
from reconstruction.mesh.texture_atlas import distance_to_surface, simplified, textured


def painted_tube(rings=60, around=72):
    """A wavy open tube whose colour is a smooth function of place."""
    height, angle = np.meshgrid(np.linspace(0, 60, rings), np.linspace(0, 2 * np.pi, around, False), indexing="ij")
    radius = 20 + 2 * np.sin(height / 6)
    vertices = np.stack([radius * np.cos(angle), radius * np.sin(angle), height], axis=-1).reshape(-1, 3)
    k = np.arange(rings * around).reshape(rings, around)
    a, b, c, d = k[:-1], np.roll(k, -1, 1)[:-1], k[1:], np.roll(k, -1, 1)[1:]
    faces = np.concatenate([np.stack([a, c, b], -1).reshape(-1, 3), np.stack([b, c, d], -1).reshape(-1, 3)])
    return SurfaceMesh.from_triangles(vertices, faces, colours=paint(vertices))


def paint(places):
    x, y, z = np.asarray(places).T
    return np.stack([128 + 100 * np.sin(x / 8), 128 + 100 * np.cos(y / 8), 60 + 2 * z], axis=1).clip(0, 255).astype(int)


@pytest.fixture(scope="module")
def fine():
    return painted_tube()


@pytest.fixture(scope="module")
def made(fine):
    light, _ = simplified(fine, 0.4)
    return light, textured(light, fine)


@pytest.mark.parametrize("bound", [0.4, *(pytest.param(bound, marks=pytest.mark.slow) for bound in (0.1, 1.5))])
def test_no_vertex_is_farther_from_the_light_mesh_than_allowed(fine, bound):
    light, error = simplified(fine, bound)
    assert error <= bound
    ways = ((light, fine), (fine, light))
    for one, other in ways:
        ours = trimesh.Trimesh(one.vertices, one.faces, process=False)
        places = trimesh.sample.sample_surface(trimesh.Trimesh(other.vertices, other.faces, process=False), 300, seed=0)
        _, distance, _ = trimesh.proximity.closest_point_naive(ours, places[0])
        assert distance.max() <= 1.05 * error + 1e-4  # between the places that are measured it may be a little more
    assert bound < 0.2 or len(light.faces) < 0.3 * len(fine.faces)


def test_a_bound_that_nothing_meets_keeps_the_mesh(fine):
    light, error = simplified(fine, 1e-9)
    assert light is fine
    assert error == 0
    with pytest.raises(ReconstructionError, match="positive length"):
        simplified(fine, 0)


def test_the_picture_shows_the_colours_of_the_place(fine, made):
    """A point in the middle of every light triangle: the texel there against the paint's own formula."""
    _, laid = made
    middle = laid.vertices[laid.faces].mean(axis=1)
    uv = laid.uv[laid.faces].mean(axis=1)
    side = len(laid.texture)
    column, row = (uv[:, 0] * side).astype(int), ((1 - uv[:, 1]) * side).astype(int)
    off = np.abs(laid.texture[row, column].astype(int) - paint(middle)).max(axis=1)
    assert np.median(off) < 6
    assert np.percentile(off, 99) < 25


def test_charts_cover_every_face_of_the_mesh(made):
    light, laid = made
    assert len(laid.faces) == len(light.faces)
    assert laid.uv.min() >= 0
    assert laid.uv.max() <= 1
    np.testing.assert_allclose(laid.vertices[laid.faces], light.vertices[light.faces], atol=1e-12)


@pytest.mark.parametrize("suffix", [".glb", ".obj"])
def test_files_read_back_with_the_same_counts_and_picture(made, tmp_path, suffix):
    _, laid = made
    path = write_textured(laid, tmp_path / f"colon{suffix}")
    read = trimesh.load(path, process=False, force="mesh")
    assert len(read.faces) == len(laid.faces)
    assert read.visual.kind == "texture"
    material = read.visual.material
    picture = np.asarray((material.baseColorTexture if suffix == ".glb" else material.image).convert("RGB"))
    np.testing.assert_array_equal(picture, laid.texture)
    order = np.lexsort(np.round(read.vertices[read.faces].mean(axis=1), 3).T)
    ours = np.lexsort(np.round(laid.vertices[laid.faces].mean(axis=1), 3).T)
    there = read.visual.uv[read.faces][order].mean(axis=1)
    np.testing.assert_allclose(there, laid.uv[laid.faces][ours].mean(axis=1), atol=1e-4)
    if suffix == ".obj":
        assert {p.name for p in tmp_path.iterdir()} == {"colon.obj", "colon.mtl", "colon_texture.png"}


def test_open3d_reads_the_obj_with_its_picture(made, tmp_path):
    import open3d

    _, laid = made
    write_textured(laid, tmp_path / "colon.obj")
    read = open3d.io.read_triangle_mesh(str(tmp_path / "colon.obj"), True)
    assert len(read.triangles) == len(laid.faces)
    assert np.asarray(read.textures[0]).shape == laid.texture.shape


def test_nothing_that_was_not_named_is_overwritten(made, tmp_path):
    (tmp_path / "coverage.png").write_text("mine")
    write_textured(made[1], tmp_path / "coverage.obj")
    assert (tmp_path / "coverage.png").read_text() == "mine"
    write_textured(made[1], tmp_path / "coverage.obj")  # again: these are its own
    (tmp_path / "other.mtl").write_text("mine")
    with pytest.raises(ReconstructionError, match=r"other\.mtl lies beside"):
        write_textured(made[1], tmp_path / "other.obj")


def test_other_formats_and_empty_meshes_are_refused(made, fine, tmp_path):
    with pytest.raises(ReconstructionError, match=r"\.glb or \.obj"):
        write_textured(made[1], tmp_path / "colon.stl")
    with pytest.raises(ReconstructionError, match="without faces"):
        textured(SurfaceMesh.from_triangles([], []), fine)


def test_distance_is_that_to_the_nearest_triangle(fine):
    shifted = fine.vertices + 0.5 * fine.normals
    assert np.median(distance_to_surface(shifted, fine)) == pytest.approx(0.5, rel=0.02)
