"""Mesh files read back by us, by trimesh, by Open3D and by VTK."""

import base64
import errno
import xml.etree.ElementTree as ElementTree
from dataclasses import replace

import numpy as np
import pytest
import trimesh

from haustra.core.errors import ReconstructionError
from reconstruction.mesh.formats import MESH_FORMATS, MeshFormat
from reconstruction.mesh.mesh_io import (
    check_textured,
    read_face_property,
    read_mesh,
    read_vertex_property,
    write_mesh,
    write_textured,
)
from reconstruction.mesh.open3d_import import import_open3d
from reconstruction.mesh.surface_mesh import SurfaceMesh
from reconstruction.mesh.textured_mesh import TexturedMesh

SUFFIXES = [suffix for suffix, row in MESH_FORMATS.items() if not row.write_only]


@pytest.fixture
def mesh():
    sphere = trimesh.creation.icosphere(subdivisions=2, radius=20)
    rng = np.random.default_rng(0)
    count = len(sphere.vertices)
    return SurfaceMesh.from_triangles(
        sphere.vertices,
        sphere.faces,
        colours=rng.integers(0, 256, (count, 3)),
        confidence=rng.random(count),
        observations=rng.integers(0, 500, count),
    )


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_open3d_and_trimesh_find_the_same_triangles(mesh, tmp_path, suffix):
    path = write_mesh(mesh, tmp_path / f"mesh{suffix}")
    by_trimesh = trimesh.load(path, process=False, force="mesh")
    by_open3d = import_open3d().io.read_triangle_mesh(str(path))
    assert len(by_trimesh.faces) == len(by_open3d.triangles) == len(mesh.faces)
    expected = mesh.vertices[mesh.faces].mean(axis=1)
    for vertices, faces in (
        (by_trimesh.vertices, by_trimesh.faces),
        (np.asarray(by_open3d.vertices), np.asarray(by_open3d.triangles)),
    ):
        np.testing.assert_allclose(vertices[faces].mean(axis=1), expected, atol=1e-4)


@pytest.mark.parametrize("suffix", [".ply", ".obj"])
def test_open3d_and_trimesh_find_the_same_colours(mesh, tmp_path, suffix):
    path = write_mesh(mesh, tmp_path / f"mesh{suffix}")
    by_trimesh = trimesh.load(path, process=False, force="mesh")
    by_open3d = import_open3d().io.read_triangle_mesh(str(path))
    expected = mesh.colours[mesh.faces]  # by face: Open3D numbers the vertices of an OBJ anew
    np.testing.assert_array_equal(by_trimesh.visual.vertex_colors[:, :3][by_trimesh.faces], expected)
    theirs = np.asarray(by_open3d.vertex_colors)[np.asarray(by_open3d.triangles)]
    np.testing.assert_array_equal(np.rint(255 * theirs), expected)


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_reading_gives_back_what_the_format_holds(mesh, tmp_path, suffix):
    again = read_mesh(write_mesh(mesh, tmp_path / f"mesh{suffix}"))
    assert len(again.vertices) == len(mesh.vertices)
    np.testing.assert_allclose(again.vertices[again.faces], mesh.vertices[mesh.faces], atol=1e-4)
    if suffix != ".stl":
        # Eight linear bits hold the darkest sRGB values of a GLB only to within six levels.
        assert np.abs(again.colours.astype(int) - mesh.colours).max() <= (6 if suffix == ".glb" else 0)
    if suffix == ".ply":
        np.testing.assert_allclose(again.normals, mesh.normals, atol=1e-6)
        np.testing.assert_allclose(again.confidence, mesh.confidence)
        np.testing.assert_array_equal(again.observations, mesh.observations)
    else:
        assert np.isnan(again.confidence).all()
        assert not again.observations.any()


def test_open3d_reads_the_point_cloud(mesh, tmp_path):
    cloud = import_open3d().io.read_point_cloud(str(write_mesh(mesh, tmp_path / "cloud.pcd")))
    np.testing.assert_allclose(np.asarray(cloud.points), mesh.vertices, atol=1e-5)
    np.testing.assert_allclose(np.asarray(cloud.normals), mesh.normals, atol=1e-6)
    np.testing.assert_array_equal(np.rint(255 * np.asarray(cloud.colors)), mesh.colours)
    with pytest.raises(ReconstructionError, match=r"\.pcd is only written"):
        read_mesh(tmp_path / "cloud.pcd")


def vtp_arrays(path):
    """Name and numbers of every array, by the definition of VTK's XML: base64 of a length in eight bytes, then data."""
    kinds = {"Float32": "<f4", "Float64": "<f8", "Int32": "<i4", "Int64": "<i8", "UInt8": "u1"}
    for array in ElementTree.parse(path).iter("DataArray"):
        data = base64.b64decode(array.text)
        assert int.from_bytes(data[:8], "little") == len(data) - 8
        yield array.get("Name"), np.frombuffer(data[8:], kinds[array.get("type")])


def test_vtp_holds_all_that_paraview_shows(mesh, tmp_path):
    found = dict(vtp_arrays(write_mesh(mesh, tmp_path / "mesh.vtp")))
    np.testing.assert_array_equal(found["Points"].reshape(-1, 3), mesh.vertices)
    np.testing.assert_array_equal(found["connectivity"].reshape(-1, 3), mesh.faces)
    np.testing.assert_array_equal(found["offsets"], 3 * np.arange(1, len(mesh.faces) + 1))
    np.testing.assert_array_equal(found["RGB"].reshape(-1, 3), mesh.colours)
    np.testing.assert_allclose(found["Normals"].reshape(-1, 3), mesh.normals, atol=1e-6)
    np.testing.assert_array_equal(found["confidence"], mesh.confidence)
    np.testing.assert_array_equal(found["observations"], mesh.observations)


def test_vtk_reads_vtp(mesh, tmp_path):
    reader = pytest.importorskip("vtkmodules.vtkIOXML", reason="vtk is not installed").vtkXMLPolyDataReader()
    reader.SetFileName(str(write_mesh(mesh, tmp_path / "mesh.vtp")))
    reader.Update()
    found = reader.GetOutput()
    assert (found.GetNumberOfPoints(), found.GetNumberOfPolys()) == (len(mesh.vertices), len(mesh.faces))
    np.testing.assert_array_equal(found.GetPoint(7), mesh.vertices[7])
    assert found.GetPointData().GetArray("observations").GetValue(7) == mesh.observations[7]
    assert found.GetPointData().GetArray("RGB").GetTuple(7) == tuple(mesh.colours[7])


def test_glb_colours_are_linear(mesh, tmp_path):
    """glTF wants linear light: sRGB 188 is half of the light of 255."""
    grey = SurfaceMesh.from_triangles(mesh.vertices, mesh.faces, colours=np.full((len(mesh.vertices), 3), 188))
    loaded = trimesh.load(write_mesh(grey, tmp_path / "grey.glb"), process=False, force="mesh")
    assert np.abs(loaded.visual.vertex_colors[:, :3].astype(int) - 128).max() <= 1


def test_an_empty_surface_survives_ply_only(tmp_path):
    empty = SurfaceMesh.from_triangles(np.empty((0, 3)), np.empty((0, 3), int))
    assert not len(read_mesh(write_mesh(empty, tmp_path / "empty.ply")).faces)
    with pytest.raises(ReconstructionError, match="without faces"):
        write_mesh(empty, tmp_path / "empty.glb")


@pytest.mark.parametrize("encoding", ["ascii", "binary"])
def test_values_of_vertices_are_read(tmp_path, encoding):
    sphere = trimesh.creation.icosphere(subdivisions=1)
    arc = np.linspace(0, 9, len(sphere.vertices), dtype=np.float32)
    sphere.vertex_attributes["arc_mm"] = arc
    sphere.export(tmp_path / "truth.ply", encoding=encoding)
    np.testing.assert_allclose(read_vertex_property(tmp_path / "truth.ply", "arc_mm"), arc, rtol=1e-6)
    assert read_vertex_property(tmp_path / "truth.ply", "other") is None


@pytest.mark.parametrize("encoding", ["ascii", "binary"])
def test_flags_of_faces_are_read(tmp_path, encoding):
    sphere = trimesh.creation.icosphere(subdivisions=1)
    flags = np.arange(len(sphere.faces)) % 3 == 0
    sphere.face_attributes["seen"] = flags.astype(np.uint8)
    sphere.export(tmp_path / "truth.ply", encoding=encoding)
    np.testing.assert_array_equal(read_face_property(tmp_path / "truth.ply", "seen"), flags)
    assert read_face_property(tmp_path / "truth.ply", "other") is None


def test_files_that_cannot_be_used_are_named(mesh, tmp_path):
    with pytest.raises(ReconstructionError, match=r"mesh\.fbx: meshes are written as"):
        write_mesh(mesh, tmp_path / "mesh.fbx")
    with pytest.raises(ReconstructionError, match="there is no mesh"):
        read_mesh(tmp_path / "absent.ply")
    (tmp_path / "broken.ply").write_bytes(b"this is not a mesh")
    with pytest.raises(ReconstructionError, match="cannot be read"):
        read_mesh(tmp_path / "broken.ply")
    trimesh.PointCloud(mesh.vertices).export(tmp_path / "points.ply")
    with pytest.raises(ReconstructionError, match="no faces"):
        read_mesh(tmp_path / "points.ply")


@pytest.mark.parametrize("suffix", [".ply", ".obj", ".stl", ".glb", ".vtp", ".pcd"])
def test_a_disk_that_is_full_leaves_what_was_there(mesh, tmp_path, monkeypatch, suffix):
    target = tmp_path / f"colon{suffix}"
    write_mesh(mesh, target)
    before = target.read_bytes()
    row = MESH_FORMATS[suffix]

    def half_written(what, path):
        row.write(what, path)
        path.write_bytes(path.read_bytes()[:100])
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setitem(MESH_FORMATS, suffix, replace(row, write=half_written))
    with pytest.raises(OSError, match="No space left"):
        write_mesh(mesh, target)
    assert target.read_bytes() == before
    assert [path.name for path in tmp_path.iterdir()] == [target.name]


def test_arrays_that_do_not_belong_together_are_refused(mesh):
    with pytest.raises(ReconstructionError, match="colours must be"):
        SurfaceMesh.from_triangles(mesh.vertices, mesh.faces, colours=np.zeros((3, 3), np.uint8))
    with pytest.raises(ReconstructionError, match="one value for each"):
        SurfaceMesh.from_triangles(mesh.vertices, mesh.faces, confidence=np.zeros(3))
    with pytest.raises(ReconstructionError, match="outside"):
        SurfaceMesh.from_triangles(mesh.vertices, mesh.faces + len(mesh.vertices))


def test_a_new_format_is_one_row_for_plain_and_textured_export(mesh, tmp_path, monkeypatch):
    """A toy format of one line: how many vertices and faces, and the texture's side where it has one."""

    def write(what, path):
        path.write_text(f"{len(what.vertices)} {len(what.faces)}")

    def write_with_texture(what, path):
        path.write_text(f"{len(what.vertices)} {len(what.faces)} {len(what.texture)}")

    monkeypatch.setitem(MESH_FORMATS, ".toy", MeshFormat(write, write_with_texture, without_faces=True))
    assert write_mesh(mesh, tmp_path / "a.toy").read_text() == f"{len(mesh.vertices)} {len(mesh.faces)}"
    assert write_mesh(SurfaceMesh.from_triangles([], []), tmp_path / "b.TOY").read_text() == "0 0"
    laid = TexturedMesh(mesh.vertices, mesh.faces, mesh.normals, mesh.vertices[:, :2], np.zeros((8, 8, 3), np.uint8))
    check_textured(tmp_path / "c.toy")
    assert write_textured(laid, tmp_path / "c.toy").read_text() == f"{len(mesh.vertices)} {len(mesh.faces)} 8"
    with pytest.raises(ReconstructionError, match=r"written as \.ply, \.glb, \.obj, \.stl, \.vtp, \.pcd, \.toy"):
        write_mesh(mesh, tmp_path / "mesh.fbx")
    with pytest.raises(ReconstructionError, match=r"\.glb or \.obj or \.toy"):
        check_textured(tmp_path / "mesh.stl")
    monkeypatch.setitem(MESH_FORMATS, ".bare", MeshFormat(write))
    with pytest.raises(ReconstructionError, match=r"without faces can be written as \.ply, \.pcd, \.toy only"):
        write_mesh(SurfaceMesh.from_triangles([], []), tmp_path / "b.bare")


def test_other_programs_find_confidence_where_the_guide_says(mesh, tmp_path):
    """docs/guide/open_elsewhere.md: which readers of Open3D and trimesh keep it."""
    path, io = write_mesh(mesh, tmp_path / "mesh.ply"), import_open3d().t.io
    cloud, drawn = io.read_point_cloud(str(path)), io.read_triangle_mesh(str(path))
    kept = trimesh.load(path).metadata["_ply_raw"]["vertex"]["data"]
    for name, expected in (("confidence", mesh.confidence), ("observations", mesh.observations)):
        np.testing.assert_allclose(cloud.point[name].numpy().ravel(), expected, rtol=1e-6)
        np.testing.assert_allclose(kept[name], expected, rtol=1e-6)
        assert name not in drawn.vertex
