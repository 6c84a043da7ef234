"""Fusion of depth that a formula gives: spheres, planes and steps, whose surface is known exactly."""

import numpy as np
import pytest
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from haustra.core.errors import ReconstructionError
from reconstruction.fusion.depth_frame import prepare_frame, view_cosine
from reconstruction.fusion.tsdf import SurfaceFusion, TsdfSettings, choose_voxel_size
from reconstruction.mesh.rendering import render_mesh
from reconstruction.mesh.surface_mesh import SurfaceMesh, drop_small_components
from tests.helpers.sphere_views import INTRINSICS, RADIUS, RED, SIZE, VOXEL, fuse, pixel_rays, sphere_depth, views


@pytest.fixture(scope="module")
def sphere():
    world_from_camera = views()
    return fuse(world_from_camera, [sphere_depth(transform) for transform in world_from_camera])


def wall(depth):
    return np.full((SIZE, SIZE), depth, np.float32)


def test_a_sphere_from_inside_has_its_radius(sphere):
    error = np.abs(np.linalg.norm(sphere.vertices, axis=1) - RADIUS)
    assert len(sphere.vertices) > 5000
    assert np.mean(error) < 0.05 * VOXEL
    assert np.percentile(error, 99) < 0.15 * VOXEL


def test_pixel_centres_lie_at_half_integers():
    """Taken as whole numbers, a tilted wall 20 away with f = 60 would move sideways by a sixth of a unit."""
    transform = np.eye(4)
    depth = (20 / (1 - 1.5 * pixel_rays()[..., 0].clip(-1, 0.5))).astype(np.float32)
    mesh = fuse([transform], [depth], voxel_size=0.3)
    slanted = mesh.vertices[(mesh.vertices[:, 0] > -8) & (mesh.vertices[:, 0] < 10)]
    assert np.abs(np.mean(slanted[:, 2] - 1.5 * slanted[:, 0]) - 20) < 0.03


def test_normals_and_winding_point_to_the_cameras(sphere):
    inwards = -sphere.vertices / np.linalg.norm(sphere.vertices, axis=1, keepdims=True)
    assert np.min(np.sum(sphere.normals * inwards, axis=1)) > 0.9
    corners = sphere.vertices[sphere.faces]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    assert np.mean(np.sum(normal * -corners.mean(axis=1), axis=1) > 0) > 0.999


def test_colour_confidence_and_observations_come_through(sphere):
    assert np.abs(sphere.colours.astype(int) - RED[0, 0]).max() <= 1
    np.testing.assert_allclose(sphere.confidence, 1, atol=1e-5)
    assert 1 <= sphere.observations.min() <= sphere.observations.max() <= 10


def test_observations_count_the_frames_that_saw_the_wall():
    """The fourth frame looks past the place of the wall at 20, to one at 24.5: beyond the truncation of 3.5."""
    mesh = fuse([np.eye(4)] * 4, [wall(20)] * 3 + [wall(24.5)])
    front = mesh.vertices[:, 2] < 22
    assert front.sum() > 1000
    assert set(mesh.observations[front]) == {3}


def test_order_of_frames_does_not_matter():
    world_from_camera = views(6)
    depths = [sphere_depth(transform) for transform in world_from_camera]
    confidences = np.random.default_rng(1).uniform(0.1, 1, (6, SIZE, SIZE)).astype(np.float32)
    forward = fuse(world_from_camera, depths, confidences)
    backward = fuse(world_from_camera[::-1], depths[::-1], confidences[::-1])
    assert len(forward.vertices) == len(backward.vertices)
    assert cKDTree(forward.vertices).query(backward.vertices)[0].max() < 1e-3 * VOXEL


def test_the_same_frames_give_the_same_arrays():
    world_from_camera = views(4)
    first, second = (
        fuse(world_from_camera, [sphere_depth(transform) for transform in world_from_camera]) for _ in range(2)
    )
    np.testing.assert_array_equal(first.vertices, second.vertices)
    np.testing.assert_array_equal(first.faces, second.faces)


def test_one_thread_gives_the_same_bytes_as_four(monkeypatch):
    world_from_camera = views(4)
    depths = [sphere_depth(transform) for transform in world_from_camera]
    monkeypatch.setattr("reconstruction.fusion.tsdf.BLOCKS_PER_TASK", 5)
    meshes = []
    for threads in (1, 4):
        monkeypatch.setattr("reconstruction.fusion.tsdf.THREADS", threads)
        meshes.append(fuse(world_from_camera, depths))
    for name in ("vertices", "faces", "colours", "confidence", "observations"):
        np.testing.assert_array_equal(*(getattr(mesh, name) for mesh in meshes))


def test_nothing_is_lost_when_memory_grows(monkeypatch):
    world_from_camera = views(3)
    depths = [sphere_depth(transform) for transform in world_from_camera]
    roomy = fuse(world_from_camera, depths)
    monkeypatch.setattr("reconstruction.fusion.voxel_grid.FIRST_CAPACITY", 16)
    np.testing.assert_array_equal(fuse(world_from_camera, depths).vertices, roomy.vertices)


def test_confidence_zero_changes_nothing():
    good = fuse([np.eye(4)], [wall(20)])
    with_ghost = fuse([np.eye(4)] * 2, [wall(20), wall(19)], [np.ones((SIZE, SIZE)), np.zeros((SIZE, SIZE))])
    np.testing.assert_array_equal(good.vertices, with_ghost.vertices)
    np.testing.assert_array_equal(good.observations, with_ghost.observations)


def test_the_surface_lies_where_the_confidence_is():
    """Walls at 20 (confidence 0.9) and 21 (0.1) average to 20.1; without confidence they would to 20.5."""
    sure, unsure = np.full((SIZE, SIZE), 0.9, np.float32), np.full((SIZE, SIZE), 0.1, np.float32)
    mesh = fuse([np.eye(4)] * 2, [wall(20), wall(21)], [sure, unsure])
    np.testing.assert_allclose(mesh.vertices[:, 2], 20.1, atol=0.02)
    np.testing.assert_allclose(mesh.confidence, 0.82, atol=0.01)


def test_two_views_with_equal_relative_errors_meet_where_inverse_variance_says():
    """A wall at z = 10, judged 2 % too far from 10 away and 2 % too near from 20: 0.2 and -0.4."""
    near, far = np.eye(4), np.eye(4)
    far[2, 3] = -10
    mesh = fuse([near, far], [wall(10.2), wall(19.6)], voxel_size=0.1, truncation=12.0)
    middle = np.linalg.norm(mesh.vertices[:, :2], axis=1) < 2  # elsewhere the rays slant differently
    weight = (19.6 / 10.2) ** 2  # of the near view against the far one
    np.testing.assert_allclose(mesh.vertices[middle, 2], 10 + (0.2 * weight - 0.4) / (weight + 1), atol=0.006)


def test_the_weight_of_a_tilted_plane_is_the_stated_formula_of_its_exact_cosine():
    tilted = (30 / (1 + 0.8 * pixel_rays()[..., 0])).astype(np.float32)  # the plane z + 0.8 x = 30
    confidence = np.full((SIZE, SIZE), 0.6, np.float32)
    frame = prepare_frame(RED, tilted, confidence, INTRINSICS, np.eye(4), 1e3, 80.0, typical_depth=25.0)
    rays = pixel_rays()
    cosine = (rays @ [0.8, 0, 1]) / np.linalg.norm(rays, axis=-1) / np.hypot(0.8, 1)
    expected = 0.6 * (cosine * 25 / tilted) ** 2
    seen = cosine > 0.25
    np.testing.assert_allclose(frame.weight[seen], expected[seen], rtol=0.05)
    assert (frame.weight[cosine < 0.16] == 0).all()  # beyond the grazing limit of 80 degrees


@pytest.mark.filterwarnings("error::RuntimeWarning")
@pytest.mark.parametrize("nothing", [np.nan, np.inf, -np.inf, -5.0, 0.0, 900.0])
def test_what_is_no_depth_makes_no_surface(nothing):
    depth = wall(20)
    depth[:, :60] = nothing
    max_depth = 100 if nothing == 900 else np.inf
    mesh = fuse([np.eye(4)], [depth], max_depth=max_depth)
    assert len(mesh.vertices)
    assert mesh.vertices[:, 0].min() > -VOXEL
    fusion = SurfaceFusion(TsdfSettings(voxel_size=VOXEL, max_depth=max_depth))
    assert fusion.integrate(RED, wall(nothing), None, INTRINSICS, np.eye(4)) == 0
    assert not len(fusion.extract().faces)


def between(mesh):
    """Share of the vertices that lie neither on the disc at 15 nor on the wall at 30."""
    z = mesh.vertices[:, 2]
    assert np.isclose(z, 15, atol=0.2).sum() > 100
    assert np.isclose(z, 30, atol=0.2).sum() > 1000
    return np.mean((np.abs(z - 15) > VOXEL) & (np.abs(z - 30) > VOXEL))


def test_hardly_a_web_between_a_fold_and_the_wall_behind_it():
    """A disc at 15 before a wall at 30, seen from a row of places: between them there is nothing."""
    world_from_camera = np.tile(np.eye(4), (9, 1, 1))
    world_from_camera[:, 0, 3] = np.linspace(-4, 4, 9)
    depths = []
    for transform in world_from_camera:
        at_disc = 15 * pixel_rays() + transform[:3, 3]
        depths.append(np.where(np.hypot(at_disc[..., 0], at_disc[..., 1]) < 5, 15, 30).astype(np.float32))
    assert between(fuse(world_from_camera[4:5], depths[4:5])) == 0
    webs, webs_unscreened = (
        between(fuse(world_from_camera, depths)),
        between(fuse(world_from_camera, depths, max_grazing_deg=89.9)),
    )
    assert webs < 0.01
    assert webs < 0.4 * webs_unscreened


def test_a_smeared_edge_is_left_out():
    """A depth network draws a ramp over a few pixels where a fold ends; it is steeper than any wall it sees."""
    depth = np.where(np.arange(SIZE) < 60, 15, 30).astype(np.float32)
    depth[58:62] = np.linspace(15, 30, 6)[1:-1]
    z = fuse([np.eye(4)], [np.tile(depth, (SIZE, 1))]).vertices[:, 2]
    assert not np.any((z > 16) & (z < 29))


def test_view_cosine_of_a_tilted_plane_is_exact():
    normal = np.array([0.6, 0.2, -0.7])
    normal /= np.linalg.norm(normal)
    rays = pixel_rays()
    towards = rays @ normal < -0.05
    depth = np.divide(normal @ [0, 0, 20], rays @ normal, where=towards, out=np.zeros((SIZE, SIZE)))
    centred = INTRINSICS.copy()
    centred[:2, 2] -= 0.5
    expected = -(rays @ normal) / np.linalg.norm(rays, axis=-1)
    inner = (slice(1, -1), slice(1, -1))
    steep_enough = expected[inner] > 0.3
    np.testing.assert_allclose(
        view_cosine(depth.astype(np.float32), centred)[inner][steep_enough], expected[inner][steep_enough], atol=0.01
    )


def test_voxel_size_follows_the_camera_and_the_depth():
    coarse = choose_voxel_size([wall(28)], np.diag([160.0, 160, 1]))
    assert 0.3 < coarse < 0.5
    assert choose_voxel_size([wall(56)], np.diag([160.0, 160, 1])) == pytest.approx(2 * coarse)
    assert choose_voxel_size([wall(28)], np.diag([1000.0, 1000, 1])) == pytest.approx(0.28)
    with pytest.raises(ReconstructionError, match="no frame has a valid depth"):
        choose_voxel_size([wall(np.nan)], INTRINSICS)


def test_more_observations_can_be_asked_for():
    depths = [wall(20), wall(20)]
    depths[1][:, :60] = 0
    mesh = fuse([np.eye(4)] * 2, depths, min_observations=2)
    assert mesh.vertices[:, 0].min() > -VOXEL
    assert fuse([np.eye(4)] * 2, depths).vertices[:, 0].min() < -15


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"voxel_size": 0}, "voxel size"),
        ({"voxel_size": np.nan}, "voxel size"),
        ({"truncation": 1}, "truncation"),
        ({"max_depth": -1}, "largest depth"),
        ({"max_grazing_deg": 90}, "grazing"),
    ],
)
def test_settings_that_cannot_work_are_refused(settings, message):
    with pytest.raises(ReconstructionError, match=message):
        TsdfSettings(**{"voxel_size": 1.0, **settings})


def test_frames_that_do_not_fit_are_refused():
    fusion = SurfaceFusion(TsdfSettings(voxel_size=VOXEL))
    with pytest.raises(ReconstructionError, match="rgb must be"):
        fusion.integrate(RED[:10], wall(20), None, INTRINSICS, np.eye(4))
    with pytest.raises(ReconstructionError, match="confidence must be"):
        fusion.integrate(RED, wall(20), np.ones((3, 3), np.float32), INTRINSICS, np.eye(4))
    with pytest.raises(ReconstructionError, match="not finite"):
        fusion.integrate(RED, wall(20), None, INTRINSICS, np.full((4, 4), np.nan))
    with pytest.raises(ReconstructionError, match="one unit"):
        fusion.integrate(RED, wall(1e9), None, INTRINSICS, np.eye(4))


def two_pieces():
    """A square of area 4 and a triangle of area 0.5 apart from it."""
    vertices = [[0, 0, 0], [2, 0, 0], [2, 2, 0], [0, 2, 0], [9, 0, 0], [10, 0, 0], [9, 1, 0]]
    return SurfaceMesh.from_triangles(vertices, [[0, 1, 2], [0, 2, 3], [4, 5, 6]])


def test_small_components_are_dropped_and_reported():
    mesh, dropped = drop_small_components(two_pieces(), min_fraction=0.2)
    assert (len(mesh.vertices), len(mesh.faces)) == (4, 2)
    assert (dropped.components, dropped.faces, dropped.kept_components) == (1, 1, 1)
    assert dropped.area == pytest.approx(0.5)
    assert len(drop_small_components(two_pieces(), min_area=0.4)[0].faces) == 3


def test_a_sim3_moves_vertices_and_turns_normals():
    sim3 = np.eye(4)
    sim3[:3, :3] = 3 * Rotation.from_euler("x", 90, degrees=True).as_matrix()
    sim3[:3, 3] = [1, 2, 3]
    mesh = two_pieces().transformed(sim3)
    np.testing.assert_allclose(mesh.vertices[2], [7, 2, 9], atol=1e-12)
    np.testing.assert_allclose(mesh.normals[0], [0, -1, 0], atol=1e-12)
    assert mesh.face_areas.sum() == pytest.approx(9 * 4.5)
    with pytest.raises(ReconstructionError, match="mirror"):
        mesh.transformed(np.diag([1.0, 1, -1, 1]))


def test_pictures_show_the_lumen_only_where_it_is_open(sphere):
    """Into its opening a half sphere is red, from behind it is plaster; a whole one shows its red when cut away."""
    half = sphere.with_faces((sphere.vertices[sphere.faces][..., 2] > 0).all(axis=1))
    into, onto = np.eye(4), np.diag([1.0, -1, -1, 1])
    into[2, 3], onto[2, 3] = -60, 60

    def redness(picture):
        red, _, blue = picture[48, 64].astype(int)
        return red - blue

    assert redness(render_mesh(half, into, 128, 96)) > 60
    assert redness(render_mesh(half, onto, 128, 96)) < 40
    assert redness(render_mesh(sphere, onto, 128, 96)) < 40
    assert redness(render_mesh(sphere, onto, 128, 96, cut_away=True)) > 60
    outside = render_mesh(half, width=128, height=96)
    assert (outside[0] == 255).all()
    assert (outside < 250).any(axis=2).mean() > 0.2
