"""Millimetres: the lumen of a tube of known width, and scale files."""

import numpy as np
import pytest

from haustra.core.errors import HaustraError
from pipeline.mapping.submap import Submap
from pipeline.surface.scale import SCENE, Scale, ScaleSource, check_scale_frames, checked_against, find_scale
from reconstruction.coverage.lumen_diameter import measure_lumen
from reconstruction.mesh.surface_mesh import SurfaceMesh


def bent_tube(radius=8.0, bend=60.0, turns=1.2):
    """A tube about an arc of a circle of radius `bend` in the x-z plane, and camera poses along its middle."""
    along, around = np.linspace(0, turns, 160), np.linspace(0, 2 * np.pi, 64, endpoint=False)
    centre = np.stack([bend * np.cos(along), 0 * along, bend * np.sin(along)], axis=1)
    outward = np.stack([np.cos(along), 0 * along, np.sin(along)], axis=1)
    ring = np.cos(around)[None, :, None] * outward[:, None] + np.sin(around)[None, :, None] * np.array([0, 1.0, 0])
    vertices = (centre[:, None] + radius * ring).reshape(-1, 3)
    i, j = np.meshgrid(np.arange(159), np.arange(64), indexing="ij")
    a, b, c, d = i * 64 + j, i * 64 + (j + 1) % 64, (i + 1) * 64 + j, (i + 1) * 64 + (j + 1) % 64
    faces = np.concatenate([np.stack([a, b, c], -1).reshape(-1, 3), np.stack([b, d, c], -1).reshape(-1, 3)])
    poses = np.tile(np.eye(4), (40, 1, 1))
    for world_from_camera, k in zip(poses, np.linspace(30, 130, 40).astype(int), strict=True):
        tangent = np.cross(outward[k], [0, 1.0, 0])
        world_from_camera[:3, :3] = np.stack([outward[k], np.cross(tangent, outward[k]), tangent], axis=1)
        # Far off the middle: the width must not depend on where the camera is.
        world_from_camera[:3, 3] = centre[k] + 0.5 * radius * outward[k]
    return vertices, faces, poses


@pytest.mark.parametrize("radius", [5.0, 8.0])
def test_lumen_of_a_bent_tube(radius):
    vertices, faces, poses = bent_tube(radius)
    width = measure_lumen(vertices, faces, poses, reach=10.0)
    assert width.diameter == pytest.approx(2 * radius, rel=0.02)
    assert width.stations > 30


def test_an_open_wall_has_no_lumen():
    vertices, faces, poses = bent_tube()
    one_side = vertices[faces].mean(axis=1)[:, 1] > 4
    assert measure_lumen(vertices, faces[one_side], poses, reach=10.0) is None


def submap_of(poses):
    empty = np.zeros((0, 2))
    return Submap(
        np.arange(len(poses)), poses, np.zeros((0, 3)), np.zeros(0), empty.astype(int), empty, (1.0, 1.0, 0.0, 0.0)
    )


def test_the_lumen_sets_millimetres():
    vertices, faces, poses = bent_tube(radius=0.8, bend=9.0)
    scale = find_scale(ScaleSource(lumen_mm=48.0), submap_of(poses), SurfaceMesh.from_triangles(vertices, faces))
    assert scale.unit == "mm"
    assert scale.factor == pytest.approx(30.0, rel=0.02)


def test_scale_files(tmp_path):
    _, _, poses = bent_tube()
    mesh = SurfaceMesh.from_triangles(np.eye(3), [[0, 1, 2]])
    path = tmp_path / "scale.yaml"
    path.write_text("mm_per_unit: 2.5")
    assert find_scale(ScaleSource(file=path), submap_of(poses), mesh).factor == 2.5
    path.write_text("frame_a: 0\nframe_b: 7\ndistance_mm: 12.0")
    true = np.linalg.norm(poses[7, :3, 3] - poses[0, :3, 3])
    assert find_scale(ScaleSource(file=path), submap_of(poses), mesh).factor == pytest.approx(12 / true)
    for text, words in (
        ("mm_per_unit: -1", "positive numbers"),
        ("mm_per_unit: 0", "positive numbers"),
        ("mm_per_unit: .nan", "positive numbers"),
        ("width: 3", "must give mm_per_unit"),
        ("mm_per_unit: wide", "must name numbers"),
        ("mm_per_unit: true", "must name numbers"),
        ("frame_a: 10.7\nframe_b: 12\ndistance_mm: 5", "frames are whole ones"),
        ("12.5", "must name numbers, as"),
        ("mm_per_unit: 1" + 400 * "0", "must name numbers"),
    ):
        path.write_text(text)
        with pytest.raises(HaustraError, match=words):
            find_scale(ScaleSource(file=path), submap_of(poses), mesh)


def test_frames_of_a_scale_file_that_have_no_pose_cost_the_scale_and_not_the_run(tmp_path):
    _, _, poses = bent_tube()
    mesh, path = SurfaceMesh.from_triangles(np.eye(3), [[0, 1, 2]]), tmp_path / "scale.yaml"
    still = np.concatenate([poses, poses[-1:]])
    for frame, placed, why in (
        (99, poses, "frame 99 of the scale file scale.yaml has no pose"),
        (40, still, "same place"),
    ):
        path.write_text(f"frame_a: 39\nframe_b: {frame}\ndistance_mm: 12.0")
        for given, unit in (((), "scene"), ((Scale(30.0, "mm", "depth of the sensor"),), "mm")):
            found = find_scale(ScaleSource(file=path, given=given), submap_of(placed), mesh)
            assert found.unit == unit
            assert why in found.doubt
            assert "--resume" in found.doubt


def test_frames_of_a_scale_file_are_looked_for_before_the_work(tmp_path):
    path, used = tmp_path / "scale.yaml", np.array([3, 4, 6, 9])
    for frame, why in (
        (5, "frame 5 of the scale file .* is none of the 4 frames that are used, from 3 to 9"),
        (3, "twice"),
    ):
        path.write_text(f"frame_a: 3\nframe_b: {frame}\ndistance_mm: 12.0")
        with pytest.raises(HaustraError, match=why):
            check_scale_frames(path, used)
    path.write_text("frame_a: 3\nframe_b: 9\ndistance_mm: 12.0")
    check_scale_frames(path, used)
    check_scale_frames(None, used)


@pytest.mark.parametrize("unit", ["scene", "mm"])
def test_a_file_speaks_of_the_unit_that_the_run_has_without_it(tmp_path, unit):
    """Something of 3 units in the mesh of a run without the file is 12 mm."""
    _, _, poses = bent_tube()
    mesh, given = SurfaceMesh.from_triangles(np.eye(3), [[0, 1, 2]]), (Scale(0.03, unit, "given"),)
    before = find_scale(ScaleSource(given=given), submap_of(poses), mesh)
    (tmp_path / "scale.yaml").write_text("mm_per_unit: 4.0")
    after = find_scale(ScaleSource(given=given, file=tmp_path / "scale.yaml"), submap_of(poses), mesh)
    assert 3 / before.factor * after.factor == pytest.approx(12)
    assert after.unit == "mm"
    assert bool(after.doubt) == (unit == "mm")  # two sources that contradict each other
    true = np.linalg.norm(poses[7, :3, 3] - poses[0, :3, 3])
    (tmp_path / "scale.yaml").write_text("frame_a: 0\nframe_b: 7\ndistance_mm: 12.0")
    between = find_scale(ScaleSource(given=given, file=tmp_path / "scale.yaml"), submap_of(poses), mesh)
    assert between.factor == pytest.approx(12 / true)


def test_an_open_wall_keeps_the_scale_that_something_else_gives():
    vertices, faces, poses = bent_tube()
    one_side = faces[vertices[faces].mean(axis=1)[:, 1] > 4]
    sensed = Scale(27.3, "mm", "depth of the sensor")
    for mesh in (SurfaceMesh.from_triangles(vertices, one_side), SurfaceMesh.from_triangles([], [])):
        found = find_scale(ScaleSource(lumen_mm=50.0, given=(sensed,)), submap_of(poses), mesh)
        assert (found.factor, found.unit) == (27.3, "mm")
        assert found.origin.startswith("depth of the sensor; the surface nowhere surrounds")
        assert find_scale(ScaleSource(lumen_mm=50.0), submap_of(poses), mesh).unit == "scene"


def test_no_scale_stays_scene():
    scale = find_scale(ScaleSource(), submap_of(np.eye(4)[None]), SurfaceMesh.from_triangles(np.eye(3), [[0, 1, 2]]))
    assert (scale.factor, scale.unit) == (1.0, "scene")


def test_another_source_that_contradicts_the_scale_is_named():
    by_file, by_sensor = Scale(40.0, "mm", "scale file a.yaml"), Scale(10.0, "mm", "depth of the sensor")
    doubt = (
        "do not trust the millimetres: one of two is wrong, all lengths would be 0.25 times these by the depth of the "
        "sensor"
    )
    found = checked_against(by_file, [None, SCENE, by_sensor])
    assert (found.factor, found.origin, found.doubt) == (40.0, "scale file a.yaml", doubt)
    assert str(found) == f"scale file a.yaml; {doubt}"
    unit = Scale(40.0, "mm", "depth of the sensor", "the unit")
    assert checked_against(unit, [Scale(1.0, "mm", "poses")]).doubt.startswith("the unit; one of two")
    assert checked_against(by_file, [Scale(43.0, "mm", "poses")]) == by_file
    assert checked_against(SCENE, [by_sensor]) == SCENE


def test_the_lumen_and_a_file_are_held_against_what_a_sensor_gave(tmp_path):
    vertices, faces, poses = bent_tube(radius=0.8, bend=9.0)
    mesh, submap = SurfaceMesh.from_triangles(vertices, faces), submap_of(poses)
    sensed = Scale(3.0, "mm", "depth of the sensor")
    (tmp_path / "s.yaml").write_text("mm_per_unit: 30.0")
    for source in (
        ScaleSource(given=(sensed,), lumen_mm=500.0),
        ScaleSource(given=(sensed,), file=tmp_path / "s.yaml"),
    ):
        assert "by the depth of the sensor" in find_scale(source, submap, mesh).doubt
    assert find_scale(ScaleSource(given=(sensed,)), submap, mesh) == sensed
