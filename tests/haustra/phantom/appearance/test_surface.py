"""What is painted on the phantom's wall is where it should be, the moved wall is shaded as it lies, views are fair."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.ndimage import label
from scipy.spatial import cKDTree

import haustra.phantom.appearance.texture as texture
import haustra.phantom.motion.viewpoints as viewpoints
from haustra.phantom.anatomy.colon import Colon, build_colon
from haustra.phantom.appearance.texture import SurfaceTexture
from haustra.phantom.appearance.vessels import polygon_network, vessel_trees
from haustra.phantom.config import AnatomyConfig, CameraConfig, EventsConfig, PhantomConfig
from haustra.phantom.imaging.camera import make_camera
from haustra.phantom.imaging.render import Phantom
from haustra.phantom.motion.peristalsis import MovedWall, Peristalsis
from haustra.phantom.raycaster import Hits, RayCaster
from haustra.phantom.timeline import Slot
from tests.helpers.phantom_oracles import BARE, COLOURLESS

SMOOTH = AnatomyConfig(
    length_mm=80.0, radius_mm=12.0, fold_depth_mm=0.0, taenia_depth_mm=1.0, edge_mm=1.2, polyps=0, flexures=0, bend=0.1
)
CONFIG = PhantomConfig(
    seed=3, anatomy=SMOOTH, appearance=COLOURLESS, imaging=BARE, camera=CameraConfig(width=64, height=64)
)
WAVE_MM = 9.0  # wavelength of what is painted below: a shift by half a texel of 0.5 mm shows as 0.07
WAY = np.array([0.48, 0.6, 0.64])


def waves(points: np.ndarray) -> np.ndarray:
    """A pattern in space (...): whoever knows the point knows its value, without any sheet."""
    return 0.5 + 0.4 * np.sin(2 * np.pi / WAVE_MM * (np.asarray(points, float) @ WAY))


def painted(points: np.ndarray, *rest: object) -> np.ndarray:
    """Instead of `_paint`: red shows the waves, green nothing, blue their complement."""
    red = waves(points)
    return np.stack([red, np.full_like(red, 0.5), 1 - red], axis=-1).astype(np.float32)


@pytest.fixture(scope="module")
def colon() -> Colon:
    return build_colon(SMOOTH, 3)


@pytest.fixture(scope="module")
def wavy() -> Phantom:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(texture, "_paint", painted)
        return Phantom(CONFIG, threads=1)


def on_faces(colon: Colon, seed: int = 0, near_seam: bool = False) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Random triangles (1,N), weights (1,N,2) on them, and those points in space (1,N,3), by the mesh alone."""
    rng = np.random.default_rng(seed)
    faces = np.arange(len(colon.triangles))
    rows, columns = colon.points.shape[:2]
    inner = (faces // (2 * columns) > 2) & (faces // (2 * columns) < rows - 4)
    column = faces // 2 % columns
    faces = faces[inner & (((column < 1) | (column >= columns - 1)) | (not near_seam))]
    chosen = rng.choice(faces, (1, 4000)).astype(np.uint32)
    weight = rng.dirichlet(np.ones(3), (1, 4000))
    corners = colon.vertices[colon.triangles[chosen]].astype(float)
    return chosen, weight[..., 1:].astype(np.float32), np.einsum("hnkc,hnk->hnc", corners, weight)


@pytest.mark.parametrize("near_seam", [False, True])
@pytest.mark.parametrize(("level", "allowed"), [(0, 0.02), (1, 0.04), (2, 0.13)])
def test_paint_is_found_where_it_was_put(wavy: Phantom, level: int, allowed: float, near_seam: bool) -> None:
    faces, bary, points = on_faces(wavy.colon, near_seam=near_seam)
    footprint = np.full(faces.shape, 0.5 * 2.0**level, np.float32)
    albedo, gloss, _ = wavy.texture.sample(*wavy.colon.grid_position(faces, bary), footprint)
    wanted = waves(points)
    np.testing.assert_allclose(albedo[..., 0], wanted, atol=allowed)
    np.testing.assert_allclose(albedo[..., 2], 1 - wanted, atol=allowed)
    np.testing.assert_allclose(gloss, 1.0, atol=1e-6)
    row, column = (part.astype(int) for part in wavy.colon.grid_position(faces, bary))
    for axis in (0, 1):  # and no systematic shift along or around: a tenth of a texel would show
        step = (np.roll(wavy.colon.points.astype(float), -1, axis) - wavy.colon.points)[row, column]
        slope = np.cos(2 * np.pi / WAVE_MM * (points @ WAY)) * (step @ WAY) * 0.4 * 2 * np.pi / WAVE_MM
        shift = np.sum((albedo[..., 0] - wanted) * slope) / np.sum(slope**2)  # in mesh edges
        assert abs(shift) * np.linalg.norm(step, axis=-1).mean() < 0.05


def test_the_seam_cannot_be_seen(wavy: Phantom) -> None:
    rows, columns = wavy.colon.points.shape[:2]
    row = np.tile(np.linspace(3, rows - 4, 200, dtype=np.float32)[:, None], (1, 2))
    column = np.tile(np.array([columns - 1e-3, 0.0], np.float32), (200, 1))
    for footprint in (0.1, 1.0, 4.0):
        albedo, _, normal = wavy.texture.sample(row, column, np.full(row.shape, footprint, np.float32))
        np.testing.assert_allclose(albedo[:, 0], albedo[:, 1], atol=2e-3)
        np.testing.assert_allclose(normal[:, 0], normal[:, 1], atol=2e-3)


def axial_pose(colon: Colon, arc: float, aside: float = 0.0, turn: float = 0.0) -> np.ndarray:
    centre, axes = colon.line.at(np.array(arc))
    c, s = np.cos(turn), np.sin(turn)
    world_from_camera = np.eye(4)
    world_from_camera[:3, :3] = axes @ np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]])
    world_from_camera[:3, 3] = centre + aside * axes[:, 0]
    return world_from_camera


def test_paint_sticks_to_the_wall_seen_from_anywhere(wavy: Phantom) -> None:
    """Red over green tells the paint whatever the light does; depth and pose tell the point in space."""
    x, y = np.meshgrid(np.arange(64) + 0.5, np.arange(64) + 0.5)
    fx, fy, cx, cy = wavy.camera.params
    for world_from_camera in (
        axial_pose(wavy.colon, 20.0),
        axial_pose(wavy.colon, 32.0, 5.0, 0.5),
        axial_pose(wavy.colon, 60, -4, 2.8),
    ):
        look = wavy.look(world_from_camera, world_from_camera)
        rays = np.stack([(x - cx) / fx, (y - cy) / fy, np.ones_like(x)], axis=-1)
        points = (look.wall[..., None] * rays) @ world_from_camera[:3, :3].T + world_from_camera[:3, 3]
        near = (look.wall > 0) & (look.wall < 22) & (look.radiance[..., 1] > 0.01)
        assert near.sum() > 400
        paint = 0.5 * look.radiance[..., 0] / np.maximum(look.radiance[..., 1], 1e-9)
        assert np.median(np.abs(paint - waves(points))[near]) < 0.015
        assert np.quantile(np.abs(paint - waves(points))[near], 0.99) < 0.08  # far pixels cover several texels


def test_distance_averages_what_a_pixel_cannot_resolve(colon: Colon) -> None:
    appearance = replace(COLOURLESS, grain=0.5)
    fine = SurfaceTexture(colon, appearance, 3)
    faces, bary, _ = on_faces(colon)
    spread = []
    for texels in (0.5, 1.0, 4.0, 8.0, 100.0):
        albedo, _, _ = fine.sample(*colon.grid_position(faces, bary), np.full(faces.shape, texels * 0.5, np.float32))
        spread.append(albedo[..., 1].std())
    assert spread[0] == pytest.approx(spread[1], rel=1e-6)
    assert spread[1] > 2 * spread[2] > 2 * spread[3]
    assert spread[3] == pytest.approx(spread[4], rel=1e-6)


@pytest.mark.parametrize("kind", ["polygon_network", "vessel_trees"])
def test_vessels_darken_the_wall_where_they_are_drawn(colon: Colon, monkeypatch: pytest.MonkeyPatch, kind: str) -> None:
    """A known pattern instead of the drawn one; opaque where the waves are high. The network varies by up to 0.7."""
    monkeypatch.setattr(texture, kind, lambda points, *rest: (waves(points) > 0.5).astype(np.float32))
    ink = (0.2, 0.5, 0.9)
    looks = replace(COLOURLESS, vessel_colour=ink)
    looks = replace(looks, mesh_vessels=0.6) if kind == "polygon_network" else replace(looks, tree_vessels=0.6)
    drawn = SurfaceTexture(colon, looks, 3)
    faces, bary, points = on_faces(colon)
    albedo, _, _ = drawn.sample(*colon.grid_position(faces, bary), np.full(faces.shape, 0.1, np.float32))
    left = albedo / np.array(COLOURLESS.tissue)
    on, off = waves(points) > 0.83, waves(points) < 0.17  # a texel and a half from the pattern's edge
    np.testing.assert_allclose(left[off], 1.0, atol=0.01)
    opacity = (1 - left[on]) / (1 - np.array(ink))
    np.testing.assert_allclose(opacity, opacity[:, :1] * np.ones(3), atol=1e-4)
    if kind == "vessel_trees":
        np.testing.assert_allclose(opacity, 0.6, atol=1e-4)
    else:  # it comes and goes
        assert 0.0 <= opacity.min() < opacity.max() <= 0.6 + 1e-4
        assert opacity.mean() == pytest.approx(0.6 * 0.65, rel=0.25)


def flat_sheet(side_mm: float, texel_mm: float) -> np.ndarray:
    at = np.arange(0, side_mm, texel_mm, dtype=np.float32)
    return np.stack([*np.meshgrid(at, at), np.zeros((len(at), len(at)), np.float32)], axis=-1)


def test_the_network_encloses_cells_of_the_stated_size_with_lines_of_the_stated_width() -> None:
    sheet, cells, lines = flat_sheet(90.0, 0.25), {}, {}
    for cell, width in ((7.0, 0.4), (14.0, 0.4), (14.0, 0.8)):
        opacity = polygon_network(sheet, cell, width, np.random.default_rng(0))
        areas = np.bincount(label(opacity < 0.1)[0].ravel())[1:] * 0.25**2
        cells[cell, width] = np.count_nonzero(areas > 0.1 * cell**2)
        lines[cell, width] = (opacity > 0.15).mean()
        assert 0.4 < 90**2 / cells[cell, width] / cell**2 < 1.2  # a plane cuts most cells beside their middle
    assert cells[7.0, 0.4] / cells[14.0, 0.4] == pytest.approx(4, rel=0.3)
    assert lines[14.0, 0.8] / lines[14.0, 0.4] == pytest.approx(2, rel=0.15)


def test_trees_are_as_many_and_as_wide_as_asked() -> None:
    inked = {}
    for per_cm2, width in ((0.1, 0.8), (0.3, 0.8), (0.1, 1.6)):
        sheets = [vessel_trees(flat_sheet(100.0, 0.2), per_cm2, width, np.random.default_rng(k)) for k in range(6)]
        inked[per_cm2, width] = np.mean([sheet.mean() for sheet in sheets])
    assert inked[0.3, 0.8] / inked[0.1, 0.8] == pytest.approx(3.0, rel=0.35)  # less where trees cross
    assert inked[0.1, 1.6] > 2.0 * inked[0.1, 0.8]  # wider, and longer until they have thinned away


def contracted(colon: Colon) -> MovedWall:
    camera = np.tile(colon.line.at(np.array(5.0))[0], (21, 1))
    wall = Peristalsis(
        colon, EventsConfig(peristalsis=1, contraction=0.5), [Slot("peristalsis", 0, 20, 0)], camera
    ).wall(12)
    assert wall is not None
    return wall


def own_normals(vertices: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    """Unit normal (V,3) of every vertex: the area-weighted mean of its triangles'."""
    corners = vertices[triangles].astype(float)
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    total = np.zeros((len(vertices), 3))
    for k in range(3):
        np.add.at(total, triangles[:, k], normal)
    return total / np.linalg.norm(total, axis=1, keepdims=True)


def apart_deg(one: np.ndarray, other: np.ndarray) -> np.ndarray:
    cosine = np.sum(one * other, axis=-1) / np.linalg.norm(one, axis=-1) / np.linalg.norm(other, axis=-1)
    return np.degrees(np.arccos(np.clip(cosine, -1, 1)))


def test_a_contracting_walls_normals_are_those_of_its_triangles(colon: Colon) -> None:
    wall, edge = contracted(colon), 3 * colon.points.shape[1]
    rest = colon.normals.reshape(-1, 3)
    own = own_normals(wall.vertices, colon.triangles)[edge:-edge]
    turned = apart_deg(rest[edge:-edge], own)
    left = apart_deg((rest + wall.normal_change)[edge:-edge], own)
    assert np.quantile(turned, 0.9) > 15  # the contraction tilts the wall
    assert left.max() < 3.0


def test_a_contracting_wall_is_shaded_as_it_lies(colon: Colon) -> None:
    phantom, world_from_camera = Phantom(CONFIG, threads=1), axial_pose(colon, 12.0)
    wall = contracted(phantom.colon)
    look = phantom.look(world_from_camera, world_from_camera, wall)
    own, rest = (
        own_normals(vertices, phantom.colon.triangles)[phantom.colon.triangles].mean(axis=1)
        for vertices in (wall.vertices, phantom.colon.vertices)
    )
    turned = (look.triangle >= 0) & (apart_deg(own, rest)[look.triangle] > 15)
    x, y = np.meshgrid(np.arange(64) + 0.5, np.arange(64) + 0.5)
    fx, fy, cx, cy = phantom.camera.params
    at = np.stack([(x - cx) / fx, (y - cy) / fy, np.ones_like(x)], axis=-1) * look.wall[..., None]
    r = np.maximum(np.linalg.norm(at, axis=-1), 1e-9)
    errors = []
    for normals in (own, rest):
        cosine = np.maximum(-np.sum((normals[look.triangle] @ world_from_camera[:3, :3]) * at, axis=-1) / r, 0)
        wanted = COLOURLESS.tissue[0] * (25 / r) ** 2 * cosine
        errors.append(np.median(np.abs(look.radiance[..., 0] - wanted)[turned] / look.radiance[..., 0][turned]))
    assert turned.sum() > 100
    assert errors[0] < 0.04
    assert errors[1] > 4 * errors[0]


class Counting(RayCaster):
    """Counts how many whole views were looked through."""

    views = 0

    def cast(self, origins: np.ndarray, directions: np.ndarray) -> Hits:
        self.views += len(directions) > 100
        return super().cast(origins, directions)


BLIND = replace(SMOOTH, length_mm=120.0, closed_start=True, closed_end=True, radius_mm=14.0, edge_mm=2.0)


@pytest.mark.parametrize(("tilts", "distances"), [((30.0, 40.0), (4.0, 7.0)), ((0.0, 5.0), (8.0, 100.0))])
def test_views_keep_their_tilt_and_distance_and_the_first_good_one_is_taken(
    monkeypatch: pytest.MonkeyPatch, tilts: tuple[float, float], distances: tuple[float, float]
) -> None:
    monkeypatch.setattr(viewpoints, "KINDS", {"only": (1.0, tilts, distances)})
    colon = build_colon(BLIND, 1)
    caster = Counting(colon.vertices, colon.triangles, threads=1)
    rays = make_camera(CameraConfig(width=32, height=32)).rays()
    corners = colon.vertices[colon.triangles].astype(float)
    weights = np.array([[i, j, 8 - i - j] for i in range(9) for j in range(9 - i)]) / 8
    dense = cKDTree(np.einsum("kc,fcx->fkx", weights, corners).reshape(-1, 3))  # at most 0.15 mm apart
    for seed in range(25):
        caster.views = 0
        world_from_camera = viewpoints.random_viewpoint(colon, caster, rays, np.random.default_rng(seed))
        away = dense.query(world_from_camera[:3, 3])[0]
        assert distances[0] - 0.02 < away < distances[1] + 0.02
        tangent = colon.line.frames[cKDTree(colon.line.points).query(world_from_camera[:3, 3])[1]][:, 2]
        tilt = np.degrees(np.arccos(abs(world_from_camera[:3, 2] @ tangent)))
        assert tilts[0] - 1.5 < tilt < tilts[1] + 1.5
        np.testing.assert_allclose(world_from_camera[:3, :3] @ world_from_camera[:3, :3].T, np.eye(3), atol=1e-6)
        assert caster.views == 1  # in a blind gut every view sees wall everywhere


def test_views_out_of_the_open_ends_are_turned_down() -> None:
    colon = build_colon(replace(SMOOTH, pinch_mm=1.0), 1)
    caster = Counting(colon.vertices, colon.triangles, threads=1)
    rays = make_camera(CameraConfig(width=24, height=24)).rays()
    views = []
    for seed in range(12):
        caster.views = 0
        world_from_camera = viewpoints.random_viewpoint(colon, caster, rays, np.random.default_rng(seed))
        views.append(caster.views)
        missed = ~caster.cast(world_from_camera[:3, 3], rays.reshape(-1, 3) @ world_from_camera[:3, :3].T).valid
        assert missed.mean() <= 0.006, seed
    assert max(views) > 1
