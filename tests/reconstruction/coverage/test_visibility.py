"""Visible wall that is in no mesh: against rays and triangles worked out one by one, and in tubes of known shape."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from haustra.core.camera import Camera
from haustra.core.ray_table import RayTable
from pipeline.surface.coverage_stage import lens_field_of_view
from reconstruction.coverage.coverage import measure_coverage
from reconstruction.coverage.coverage_figure import draw_coverage
from reconstruction.coverage.hole_closing import ClosedWall
from reconstruction.coverage.unrolled_map import MISSED, SEEN, UNMEASURED, unroll
from reconstruction.coverage.visibility import FieldOfView, VisibilityLimits, visible_points
from reconstruction.mesh.surface_mesh import SurfaceMesh
from tests.helpers.tubes.holed_tube import HOLE, RADIUS, cameras, straight, tube

SIZE = 100
WIDE = np.array([[50.0, 0, 50], [0, 50.0, 50], [0, 0, 1]])


def through_a_pinhole(points):
    """A picture of 100x100 pixels, 90 degrees from side to side."""
    pixels = points @ WIDE.T
    return np.where(points[:, 2:] > 0, pixels[:, :2] / np.maximum(pixels[:, 2:], 1e-9), np.nan)


FIELD_OF_VIEW = FieldOfView(through_a_pinhole, np.ones((SIZE, SIZE), bool))


def distances(origin, ray, triangles):
    """Where a unit ray meets each triangle, infinite where it does not, and whether that faces it (Moeller and
    Trumbore, JGT 1997)."""
    result = []
    for a, b, c in triangles:
        normal = np.cross(ray, c - a)
        det = (b - a) @ normal
        u = (origin - a) @ normal / det
        across = np.cross(origin - a, b - a)
        v, distance = ray @ across / det, (c - a) @ across / det
        hit = u >= 0 and v >= 0 and u + v <= 1 and distance > 0
        result.append((distance if hit else np.inf, ray @ np.cross(b - a, c - a) < 0))
    return result


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_it_agrees_with_rays_and_triangles_one_by_one(seed):
    rng = np.random.default_rng(seed)
    corners = rng.uniform((-4, -4, 2), (4, 4, 10), (12, 3, 3))
    wall = SurfaceMesh.from_triangles(corners.reshape(-1, 3), np.arange(36).reshape(-1, 3))
    points = rng.uniform((-8, -8, 0), (8, 8, 16), (40, 3))
    normals = rng.normal(size=(40, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    world_from_camera = np.tile(np.eye(4), (6, 1, 1))
    world_from_camera[:, :3, 3] = rng.normal(0, 1, (6, 3))
    content = rng.random((SIZE, SIZE)) > 0.2
    field_of_view, limits = FieldOfView(through_a_pinhole, content), VisibilityLimits(0.3, 12.0, 0.05, 3.0, 1e-3)
    seen = visible_points(points, normals, wall, world_from_camera, field_of_view, limits)
    for row, (point, normal) in enumerate(zip(points, normals, strict=True)):
        free, through = 0, 0
        for transform in world_from_camera:
            way = point - transform[:3, 3]
            length = np.linalg.norm(way)
            if way[2] <= 0 or length > 12:
                continue
            column, line = np.floor((WIDE @ way)[:2] / way[2]).astype(int)
            if not (0 <= column < SIZE and 0 <= line < SIZE) or not content[line, column]:
                continue
            if -normal @ way < 0.3 * length:
                continue
            first = min(d for d, _ in distances(transform[:3, 3], way / length, corners))
            if first > length - 0.05:
                free += 1
                start = point - 0.05 * way / length
                nearest, facing = min(distances(start, way / length, corners))
                through += nearest < 3.05 and facing
        assert seen[row] == (free >= 2 and free > 2 * through)


POINT, TOWARDS = np.array([[0.0, 0, 5]]), np.array([[0.0, 0, -1]])
LIMITS = VisibilityLimits(0.3, 9.0, 0.1, 2.0, 0.05)
NOTHING = SurfaceMesh.from_triangles([], [])


def corners_at(x, y, z, size=1.0):
    """Of a triangle square to z around a place, 18 wide and high."""
    return size * np.array([[-9.0, -9, 0], [0, 9, 0], [9, -9, 0]]) + np.array([x, y, z])


def moved(*aside):
    """Cameras that look along z from places aside of the origin."""
    world_from_camera = np.tile(np.eye(4), (len(aside), 1, 1))
    world_from_camera[:, 0, 3] = aside
    return world_from_camera


def is_seen(wall=NOTHING, world_from_camera=None, normal=TOWARDS, limits=LIMITS):
    world_from_camera = moved(0, 0.1) if world_from_camera is None else world_from_camera
    return bool(visible_points(POINT, normal, wall, world_from_camera, FIELD_OF_VIEW, limits)[0])


def test_no_points_and_no_surface_are_answers_too():
    far = SurfaceMesh.from_triangles(corners_at(90, 0, 0), [[0, 1, 2]])
    assert visible_points(np.zeros((0, 3)), np.zeros((0, 3)), far, moved(0, 1), FIELD_OF_VIEW, LIMITS).shape == (0,)
    assert is_seen()
    assert is_seen(far)
    assert not is_seen(far, limits=replace(LIMITS, max_distance=4.9))
    assert not is_seen(far, normal=-TOWARDS)


def test_one_view_is_not_enough_and_standing_still_makes_no_second():
    assert not is_seen(world_from_camera=moved(0))
    assert not is_seen(world_from_camera=moved(*[0] * 30))
    assert not is_seen(world_from_camera=moved(0, 0.04))
    assert is_seen(world_from_camera=moved(0, 0.06))
    turned = moved(0, 0)
    turned[1, :3, :3] = Rotation.from_rotvec([0, np.radians(4), 0]).as_matrix()
    assert is_seen(world_from_camera=turned)


def test_what_stands_between_hides():
    screen = SurfaceMesh.from_triangles(corners_at(0, 0, 3, 0.2), [[0, 1, 2]])
    assert not is_seen(screen)
    assert is_seen(screen, world_from_camera=moved(0, 4, 4.2))  # two of three look past it


def test_what_cameras_look_through_is_no_wall():
    """A place at 5 before a wall at 6 that faces the camera, or shows it its back, or is too far behind."""
    facing = SurfaceMesh.from_triangles(corners_at(0, 0, 6), [[0, 1, 2]])
    assert facing.normals[0, 2] < 0
    assert not is_seen(facing)
    assert is_seen(facing, limits=replace(LIMITS, see_through_depth=0.9))
    assert is_seen(SurfaceMesh.from_triangles(corners_at(0, 0, 6), [[0, 2, 1]]))
    small = SurfaceMesh.from_triangles(corners_at(0, 0, 6, 0.02), [[0, 1, 2]])
    assert not is_seen(small, world_from_camera=moved(0, 0.1))
    assert not is_seen(small, world_from_camera=moved(0, 4))  # one of two
    assert is_seen(small, world_from_camera=moved(0, 4, 4.2))
    assert is_seen(small, world_from_camera=moved(*[0] * 9, 4, 4.2))  # however long it stood still


def test_a_hole_that_cameras_look_at_is_seen_but_not_measured(tmp_path):
    mesh, world_from_camera = tube(straight, HOLE), cameras(straight)
    bare, viewed = (
        measure_coverage(mesh, world_from_camera),
        measure_coverage(mesh, world_from_camera, field_of_view=FIELD_OF_VIEW),
    )
    assert bare.whole.unmeasured_share == 0
    assert (viewed.share, viewed.regions) == (1.0, [])
    assert viewed.whole.unmeasured_share == pytest.approx(1 - bare.share, rel=1e-9)
    unrolled_map = unroll(viewed, mesh)
    missed, open_ = unroll(bare, mesh).state == MISSED, unrolled_map.state == UNMEASURED
    assert (missed == open_).all()
    assert open_.sum() > 50
    assert (unrolled_map.colour[open_] == 0).all()
    assert (unrolled_map.colour[unrolled_map.state == SEEN] > 0).all()
    draw_coverage(viewed, unrolled_map, viewed.segments(50), 0, tmp_path / "coverage.png")
    assert (tmp_path / "coverage.png").stat().st_size > 10_000


def test_a_hole_outside_the_picture_is_still_missed():
    """It lies at 3 o'clock, and the right half of the picture shows nothing."""
    mesh, world_from_camera = tube(straight, HOLE), cameras(straight)
    content = np.ones((SIZE, SIZE), bool)
    content[:, SIZE // 2 :] = False
    half = measure_coverage(mesh, world_from_camera, field_of_view=FieldOfView(through_a_pinhole, content))
    assert half.share == measure_coverage(mesh, world_from_camera).share


def test_the_pocket_behind_a_fold_stays_missed():
    """As in tests/test_coverage.py: no camera has it square enough."""

    def fold(s, angle):
        crescent = np.clip(np.cos(angle - np.pi), 0, 1) ** 0.5
        return RADIUS - 8 * crescent * np.exp(-(((s - 60) / 3) ** 2))

    def hidden(s, angle):
        return (s > 60) & (s < 66) & (np.abs(angle - np.pi) < 1.0)

    mesh, world_from_camera = tube(straight, hidden, radius=fold), cameras(straight)
    (bare,) = [r for r in measure_coverage(mesh, world_from_camera).regions if r.diameter > 2]
    (viewed,) = [
        r for r in measure_coverage(mesh, world_from_camera, field_of_view=FIELD_OF_VIEW).regions if r.diameter > 2
    ]
    assert viewed.area > 0.85 * bare.area
    assert viewed.clock == pytest.approx(6, abs=0.2)


@pytest.mark.slow
def test_the_answer_moves_and_scales_with_the_mesh():
    mesh, world_from_camera = tube(straight, HOLE), cameras(straight)
    content = np.ones((SIZE, SIZE), bool)
    content[40:60] = False
    here = measure_coverage(mesh, world_from_camera, field_of_view=FieldOfView(through_a_pinhole, content))
    turn = np.linalg.qr(np.random.default_rng(0).normal(size=(3, 3)))[0]
    turn *= np.linalg.det(turn)
    similarity = np.eye(4)
    similarity[:3, :3], similarity[:3, 3] = 0.02 * turn, (3, -1, 2)
    moved = np.tile(np.eye(4), (len(world_from_camera), 1, 1))
    moved[:, :3, :3] = turn @ world_from_camera[:, :3, :3]
    moved[:, :3, 3] = world_from_camera[:, :3, 3] @ similarity[:3, :3].T + similarity[:3, 3]
    there = measure_coverage(mesh.transformed(similarity), moved, field_of_view=FieldOfView(through_a_pinhole, content))
    assert there.share == pytest.approx(here.share, abs=0.002)
    assert there.whole.unmeasured_share == pytest.approx(here.whole.unmeasured_share, abs=0.002)
    assert 0 < here.whole.unmeasured_share < 1 - measure_coverage(mesh, world_from_camera).share


@pytest.mark.parametrize(
    ("model", "params"),
    [
        ("PINHOLE", (60.0, 60.0, 50.0, 50.0)),
        ("OPENCV", (60.0, 60.0, 50.0, 50.0, -0.3, 0.05, 0.0, 0.0)),
        ("OPENCV_FISHEYE", (45.0, 45.0, 50.0, 50.0, -0.02, 0.0, 0.0, 0.0)),
    ],
)
def test_a_lens_shows_what_lies_behind_its_own_pixels_and_nothing_else(model, params):
    """Rays of known pixels are shown if those pixels are; rays far off the axis, which a polynomial would fold back
    into the picture, are not."""
    camera = Camera(model, SIZE, SIZE, params, True)
    content = np.zeros((SIZE, SIZE), np.uint8)
    content[20:80, 10:90] = 255
    field_of_view = lens_field_of_view(RayTable(camera), content)
    rng = np.random.default_rng(0)
    angle, turn = np.radians(rng.uniform(0, 70, 4000)), rng.uniform(0, 2 * np.pi, 4000)
    rays = np.stack([np.sin(angle) * np.cos(turn), np.sin(angle) * np.sin(turn), np.cos(angle)], axis=1)
    row, column = np.floor(camera.project(rays)[:, ::-1]).astype(int).T
    on = (row >= 20) & (row < 80) & (column >= 10) & (column < 90)
    if model == "OPENCV":  # past its greatest radius the polynomial falls
        radius = np.linalg.norm(camera.project(rays) - 50, axis=1)
        order = np.argsort(angle)
        turning = angle[order][np.argmax(radius[order])]
        assert 0.5 < turning < np.radians(70)
        on &= angle < turning
        clear = np.abs(angle - turning) > 0.1
    else:
        clear = np.ones(len(rays), bool)
    shown = field_of_view.in_view(rays * rng.uniform(1, 9, (4000, 1)))
    assert 300 < on[clear].sum() < 3500
    np.testing.assert_array_equal(shown[clear], on[clear])


@pytest.mark.parametrize(("slant", "seen"), [(30, True), (57, True), (63, False), (75, False)])
def test_more_than_sixty_degrees_off_the_normal_is_not_visible(slant, seen):
    """One triangle ahead of two cameras, which the mesh does not hold and nothing hides."""
    turn = Rotation.from_euler("y", slant, degrees=True).as_matrix()
    corners = np.array([[0, 0.02, 0], [0.02, -0.02, 0], [-0.02, -0.02, 0]]) @ turn.T + (0, 0, 2)
    one = np.array([True])
    closed_wall = ClosedWall(corners, np.array([[0, 1, 2]]), one, np.zeros(1), np.zeros(1), ~one, np.ones(1))
    assert closed_wall.surface.face_normals[0] @ (0, 0, 1) == pytest.approx(-np.cos(np.radians(slant)))
    world_from_camera = np.tile(np.eye(4), (2, 1, 1))
    world_from_camera[1, 1, 3] = 0.1
    behind = SurfaceMesh.from_triangles([[-9.0, -9, -5], [9, -9, -5], [0, 9, -5]], [[0, 1, 2]])
    assert closed_wall.with_visible(behind, world_from_camera, FIELD_OF_VIEW, 1.0).unmeasured[0] == seen
