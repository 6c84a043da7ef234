"""Wall in plain view but in no mesh: against rays and triangles worked out one by one, and in tubes of known shape."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from test_coverage import HOLE, RADIUS, cameras, straight, tube

from pipeline.camera import Camera
from pipeline.coverage import seen_picture
from reconstruction.coverage import measure_coverage
from reconstruction.coverage_picture import draw_coverage
from reconstruction.mesh import SurfaceMesh
from reconstruction.plain_view import Picture, Sight, in_plain_view
from reconstruction.unrolled import MISSED, SEEN, UNMEASURED, unroll

SIZE = 100
WIDE = np.array([[50.0, 0, 50], [0, 50.0, 50], [0, 0, 1]])


def through_a_pinhole(points):
    """A picture of 100x100 pixels, 90 degrees from side to side."""
    pixels = points @ WIDE.T
    return np.where(points[:, 2:] > 0, pixels[:, :2] / np.maximum(pixels[:, 2:], 1e-9), np.nan)


PICTURE = Picture(through_a_pinhole, np.ones((SIZE, SIZE), bool))


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
    poses = np.tile(np.eye(4), (3, 1, 1))
    poses[:, :3, 3] = rng.normal(0, 1, (3, 3))
    content = rng.random((SIZE, SIZE)) > 0.2
    picture, sight = Picture(through_a_pinhole, content), Sight(0.3, 12.0, 0.05, 3.0)
    seen = in_plain_view(points, normals, wall, poses, picture, sight)
    for row, (point, normal) in enumerate(zip(points, normals, strict=True)):
        free, through = 0, 0
        for pose in poses:
            way = point - pose[:3, 3]
            length = np.linalg.norm(way)
            if way[2] <= 0 or length > 12:
                continue
            column, line = np.floor((WIDE @ way)[:2] / way[2]).astype(int)
            if not (0 <= column < SIZE and 0 <= line < SIZE) or not content[line, column]:
                continue
            if -normal @ way < 0.3 * length:
                continue
            first = min(d for d, _ in distances(pose[:3, 3], way / length, corners))
            if first > length - 0.05:
                free += 1
                start = point - 0.05 * way / length
                nearest, facing = min(distances(start, way / length, corners))
                through += nearest < 3.05 and facing
        assert seen[row] == (free > 2 * through)


def test_no_points_and_no_surface_are_answers_too():
    none = SurfaceMesh.from_triangles([], [])
    far = SurfaceMesh.from_triangles([[90.0, 0, 0], [91, 0, 0], [90, 1, 0]], [[0, 1, 2]])
    here, sight = np.eye(4)[None], Sight(0.3, 9.0, 0.1, 2.0)
    assert in_plain_view(np.zeros((0, 3)), np.zeros((0, 3)), none, here, PICTURE, sight).shape == (0,)
    point, towards = np.array([[0.0, 0, 5]]), np.array([[0.0, 0, -1]])
    for mesh in (none, far):
        assert in_plain_view(point, towards, mesh, here, PICTURE, sight).tolist() == [True]
    assert in_plain_view(point, towards, far, here, PICTURE, replace(sight, farthest=4.9)).tolist() == [False]
    assert in_plain_view(point, -towards, far, here, PICTURE, sight).tolist() == [False]


def test_what_cameras_look_through_is_no_wall():
    """A place at 5 before a wall at 6 that faces the camera, or shows it its back, or is too far behind."""
    corners = np.array([[-9.0, -9, 6], [0, 9, 6], [9, -9, 6]])
    facing = SurfaceMesh.from_triangles(corners, [[0, 1, 2]])
    point, towards, here = np.array([[0.0, 0, 5]]), np.array([[0.0, 0, -1]]), np.eye(4)[None]
    sight = Sight(0.3, 9.0, 0.1, 2.0)
    assert facing.normals[0, 2] < 0
    assert in_plain_view(point, towards, facing, here, PICTURE, sight).tolist() == [False]
    assert in_plain_view(point, towards, facing, here, PICTURE, replace(sight, behind=0.9)).tolist() == [True]
    away = SurfaceMesh.from_triangles(corners, [[0, 2, 1]])
    assert in_plain_view(point, towards, away, here, PICTURE, sight).tolist() == [True]
    aside = np.tile(np.eye(4), (3, 1, 1))
    aside[1:, 0, 3] = 4.0  # two more, whose rays pass the wall's edge
    aside[1:, 1, 3] = (4.0, 4.4)
    assert in_plain_view(point, towards, facing, aside[:1], PICTURE, sight).tolist() == [False]
    small = SurfaceMesh.from_triangles(0.02 * corners + [0, 0, 5.88], [[0, 1, 2]])
    assert in_plain_view(point, towards, small, aside[:1], PICTURE, sight).tolist() == [False]
    assert in_plain_view(point, towards, small, aside, PICTURE, sight).tolist() == [True]


def test_a_hole_that_cameras_look_at_is_seen_but_not_measured(tmp_path):
    mesh, poses = tube(straight, HOLE), cameras(straight)
    bare, viewed = measure_coverage(mesh, poses), measure_coverage(mesh, poses, picture=PICTURE)
    assert bare.unmeasured_share == 0
    assert (viewed.share, viewed.regions) == (1.0, [])
    assert viewed.unmeasured_share == pytest.approx(1 - bare.share, rel=1e-9)
    unrolled = unroll(viewed, mesh)
    missed, open_ = unroll(bare, mesh).state == MISSED, unrolled.state == UNMEASURED
    assert (missed == open_).all()
    assert open_.sum() > 50
    assert (unrolled.colour[open_] == 0).all()
    assert (unrolled.colour[unrolled.state == SEEN] > 0).all()
    draw_coverage(viewed, unrolled, viewed.segments(50), 0, tmp_path / "coverage.png")
    assert (tmp_path / "coverage.png").stat().st_size > 10_000


def test_a_hole_outside_the_picture_is_still_missed():
    """It lies at 3 o'clock, and the right half of the picture shows nothing."""
    mesh, poses = tube(straight, HOLE), cameras(straight)
    content = np.ones((SIZE, SIZE), bool)
    content[:, SIZE // 2 :] = False
    half = measure_coverage(mesh, poses, picture=Picture(through_a_pinhole, content))
    assert half.share == measure_coverage(mesh, poses).share


def test_the_pocket_behind_a_fold_stays_missed():
    """As in tests/test_coverage.py, by cameras that only go in: the fold stands between."""

    def fold(s, angle):
        crescent = np.clip(np.cos(angle - np.pi), 0, 1) ** 0.5
        return RADIUS - 8 * crescent * np.exp(-(((s - 60) / 3) ** 2))

    def hidden(s, angle):
        return (s > 60) & (s < 66) & (np.abs(angle - np.pi) < 1.0)

    mesh, poses = tube(straight, hidden, radius=fold), cameras(straight)
    (bare,) = [r for r in measure_coverage(mesh, poses).regions if r.diameter > 2]
    (viewed,) = [r for r in measure_coverage(mesh, poses, picture=PICTURE).regions if r.diameter > 2]
    assert viewed.area > 0.85 * bare.area
    assert viewed.clock == pytest.approx(6, abs=0.2)


def test_the_answer_moves_and_scales_with_the_mesh():
    mesh, poses = tube(straight, HOLE), cameras(straight)
    content = np.ones((SIZE, SIZE), bool)
    content[40:60] = False
    here = measure_coverage(mesh, poses, picture=Picture(through_a_pinhole, content))
    turn = np.linalg.qr(np.random.default_rng(0).normal(size=(3, 3)))[0]
    turn *= np.linalg.det(turn)
    similarity = np.eye(4)
    similarity[:3, :3], similarity[:3, 3] = 0.02 * turn, (3, -1, 2)
    moved = np.tile(np.eye(4), (len(poses), 1, 1))
    moved[:, :3, :3] = turn @ poses[:, :3, :3]
    moved[:, :3, 3] = poses[:, :3, 3] @ similarity[:3, :3].T + similarity[:3, 3]
    there = measure_coverage(mesh.transformed(similarity), moved, picture=Picture(through_a_pinhole, content))
    assert there.share == pytest.approx(here.share, abs=0.002)
    assert there.unmeasured_share == pytest.approx(here.unmeasured_share, abs=0.002)
    assert 0 < here.unmeasured_share < 1 - measure_coverage(mesh, poses).share


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
    picture = seen_picture(camera, content)
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
    shown = picture.shows(rays * rng.uniform(1, 9, (4000, 1)))
    assert 300 < on[clear].sum() < 3500
    np.testing.assert_array_equal(shown[clear], on[clear])
