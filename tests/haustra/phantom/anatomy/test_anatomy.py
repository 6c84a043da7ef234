"""Lesions, blind ends and collapse against trimesh, Open3D and plain ray-triangle algebra."""

from __future__ import annotations

from dataclasses import asdict, replace
from pathlib import Path

import numpy as np
import pytest
import trimesh
from hypothesis import given, reject, settings
from hypothesis import strategies as st
from scipy.spatial import cKDTree

from haustra.phantom.anatomy.colon import Colon, build_colon
from haustra.phantom.config import AnatomyConfig
from haustra.phantom.dataset.demo import DEMO
from haustra.phantom.raycaster import RayCaster, _open3d

DEMO_FOLDER = Path(__file__).parents[4] / "pipeline" / "demo"
COARSE = AnatomyConfig(length_mm=130.0, radius_mm=18.0, fold_depth_mm=4.0, edge_mm=1.6, polyps=0, flexures=0)
SMOOTH = replace(COARSE, fold_depth_mm=0.0, taenia_depth_mm=0.0, sacculation_mm=0.0, relief_mm=0.0, bend=0.1)


@pytest.fixture(scope="module")
def stalked() -> Colon:
    return build_colon(replace(COARSE, pedunculated=2), 3)


@pytest.fixture(scope="module")
def pouched() -> Colon:
    return build_colon(replace(COARSE, diverticula=2), 4)


def mesh_of(colon: Colon) -> trimesh.Trimesh:
    return trimesh.Trimesh(colon.vertices, colon.triangles, process=False)


def crossings(mesh: trimesh.Trimesh, origin: np.ndarray, direction: np.ndarray) -> np.ndarray:
    """Sorted lengths at which a ray pierces the mesh (Moeller-Trumbore against every triangle)."""
    a, b, c = np.moveaxis(np.asarray(mesh.triangles, float), 1, 0)
    p, s = np.cross(direction, c - a), origin - a
    with np.errstate(divide="ignore", invalid="ignore"):
        inverse = 1 / np.sum((b - a) * p, axis=1)
        q = np.cross(s, b - a)
        u, v, t = np.sum(s * p, axis=1) * inverse, q @ direction * inverse, np.sum((c - a) * q, axis=1) * inverse
        return np.sort(t[(u >= 0) & (v >= 0) & (u + v <= 1) & (t > 1e-3)])


def wall_around(colon: Colon, arc_mm: float) -> tuple[np.ndarray, np.ndarray]:
    """Centre and axes (columns N1 N2 T) of the cross-section at an arc length."""
    return colon.line.at(np.array(arc_mm))


def outward_at(colon: Colon, arc_mm: float, angle_rad: float) -> tuple[np.ndarray, np.ndarray]:
    centre, axes = wall_around(colon, arc_mm)
    return centre, np.cos(angle_rad) * axes[:, 0] + np.sin(angle_rad) * axes[:, 1]


def self_intersections(mesh: trimesh.Trimesh, centre: np.ndarray, reach_mm: float) -> int:
    """Open3D's count of pairs of triangles that pass through each other near a place."""
    near = np.linalg.norm(mesh.triangles_center - centre, axis=1) < reach_mm
    geometry, utility = _open3d().geometry, _open3d().utility
    part = geometry.TriangleMesh(
        utility.Vector3dVector(np.asarray(mesh.vertices, float)), utility.Vector3iVector(mesh.faces[near])
    )
    part.remove_unreferenced_vertices()
    return len(np.asarray(part.get_self_intersecting_triangles()))


def test_the_intersection_oracle_sees_crossing_sheets() -> None:
    sheets = trimesh.util.concatenate(
        [trimesh.creation.box((4, 4, 0.1)), trimesh.creation.box((0.1, 4, 4))]  # two plates through each other
    )
    assert self_intersections(sheets, np.zeros(3), 10.0) > 0


def test_a_gut_with_two_blind_ends_is_a_closed_surface_of_the_right_volume() -> None:
    colon = build_colon(replace(SMOOTH, closed_start=True, closed_end=True, radius_variation=0.0, edge_mm=1.2), 1)
    mesh = trimesh.Trimesh(colon.vertices, colon.triangles, process=True, merge_norm=True)
    mesh.update_faces(mesh.nondegenerate_faces())
    assert mesh.is_watertight
    assert mesh.is_winding_consistent
    assert mesh.euler_number == 2
    radius, length = SMOOTH.radius_mm, SMOOTH.length_mm
    capsule = np.pi * radius**2 * (length - 2 * radius) + 4 / 3 * np.pi * radius**3  # Pappus: the bend does not matter
    assert -mesh.volume == pytest.approx(capsule, rel=0.01)  # normals point into the lumen: the volume is negative


@pytest.mark.parametrize("end", [0, -1])
def test_the_pole_of_a_blind_end_is_round(end: int) -> None:
    colon = build_colon(replace(SMOOTH, closed_start=True, closed_end=True, radius_variation=0.0), 1)
    assert np.ptp(colon.points[end], axis=0).max() == 0
    _, axes = wall_around(colon, colon.arc[end])
    np.testing.assert_allclose(colon.normals[end] @ axes[:, 2], 1.0 if end == 0 else -1.0, atol=1e-3)
    rows = colon.points[:8] if end == 0 else colon.points[:-9:-1]
    steps = np.linalg.norm(np.diff(rows, axis=0), axis=-1)
    np.testing.assert_allclose(steps, steps.mean(), rtol=0.03)  # rows are spaced by wall length up to the pole
    bottom, inside = rows[0, 0], 1.0 if end == 0 else -1.0
    ball = bottom + inside * SMOOTH.radius_mm * axes[:, 2]
    np.testing.assert_allclose(np.linalg.norm(rows - ball, axis=-1), SMOOTH.radius_mm, rtol=0.02)


def test_one_end_can_stay_open() -> None:
    colon = build_colon(replace(COARSE, closed_end=True), 2)
    assert np.ptp(colon.points[-1], axis=0).max() == 0
    assert np.ptp(colon.points[0], axis=0).max() > 0.1
    assert np.isfinite(colon.normals).all()


def test_heads_overhang(stalked: Colon) -> None:
    """From inside the head's edge outwards: through its underside, over a gap, and only then into the wall."""
    mesh = mesh_of(stalked)
    assert stalked.polyps
    for polyp in stalked.polyps:
        assert polyp.kind == "pedunculated"
        near = np.linalg.norm(stalked.vertices - polyp.apex, axis=1) < 2.2 * polyp.radius_mm
        head = stalked.vertices[near & (stalked.polyp_cover.ravel() > 0.99)].astype(float)
        middle = (head.min(axis=0) + head.max(axis=0)) / 2
        _, outward = outward_at(stalked, polyp.arc_mm, polyp.angle_rad)
        across = trimesh.geometry.plane_transform(np.zeros(3), outward)[:2, :3]
        gaps = []
        for turn in np.linspace(0, 2 * np.pi, 12, endpoint=False):
            edge = middle + 0.75 * polyp.radius_mm * (np.cos(turn) * across[0] + np.sin(turn) * across[1])
            hits = crossings(mesh, edge, outward)
            gaps += [hits[1] - hits[0]] if len(hits) == 2 else []
        assert len(gaps) >= 6  # elsewhere the ray meets the leaning stalk
        assert np.median(gaps) > 2.0


def test_pouches_are_wider_than_their_mouths(pouched: Colon) -> None:
    mesh = mesh_of(pouched)
    for pouch in pouched.diverticula:
        centre = np.array(pouch.centre)
        axis, outward = outward_at(pouched, pouch.arc_mm, pouch.angle_rad)
        depth = crossings(mesh, axis, (centre - axis) / np.linalg.norm(centre - axis))[0]
        assert depth - np.linalg.norm(centre - axis) == pytest.approx(pouch.depth_mm, abs=1.5)
        along = wall_around(pouched, pouch.arc_mm)[1][:, 2]
        inside = centre + 0.6 * pouch.depth_mm * outward
        widths = [crossings(mesh, inside, sign * along)[0] for sign in (1.0, -1.0)]
        assert sum(widths) > 2 * pouch.mouth_radius_mm
        assert 4.0 <= pouch.depth_mm <= 9.0
    assert not pouched.polyp_cover.any()


@pytest.mark.parametrize("kind", ["stalked", "pouched"])
def test_walls_do_not_pass_through_themselves(kind: str, request: pytest.FixtureRequest) -> None:
    colon: Colon = request.getfixturevalue(kind)
    mesh = mesh_of(colon)
    assert mesh.is_winding_consistent
    assert mesh.euler_number == 0
    for lesion in [*(p.apex for p in colon.polyps), *(d.centre for d in colon.diverticula)]:
        assert self_intersections(mesh, np.array(lesion), 16.0) == 0


def test_smooth_normals_agree_with_the_triangles_on_a_head(stalked: Colon) -> None:
    mesh = mesh_of(stalked)
    on_head = (stalked.polyp_cover.ravel() > 0.9)[stalked.triangles].all(axis=1)
    smooth = stalked.normals.reshape(-1, 3)[stalked.triangles[on_head]].mean(axis=1)
    cosine = np.sum(smooth * mesh.face_normals[on_head], axis=1) / np.linalg.norm(smooth, axis=1)
    assert on_head.sum() > 50
    assert np.percentile(cosine, 2) > 0.8


def test_a_head_has_vertices_enough() -> None:
    colon = build_colon(AnatomyConfig(length_mm=130.0, polyps=0, pedunculated=1, flexures=0), 0)
    on_head = (colon.polyp_cover.ravel() > 0.9)[colon.triangles].all(axis=1)
    edges = mesh_of(colon).triangles[on_head]
    lengths = np.linalg.norm(edges - np.roll(edges, 1, axis=1), axis=-1)
    assert np.percentile(lengths, 99) < 2 * colon.anatomy.edge_mm


def test_flat_polyps_are_wide_and_low() -> None:
    plain, raised = (build_colon(replace(SMOOTH, flat=flat), 5) for flat in (0, 2))
    caster = RayCaster(plain.vertices, plain.triangles, threads=1)
    assert len(raised.polyps) == 2
    for polyp in raised.polyps:
        assert polyp.kind == "flat"
        assert 1.5 <= polyp.radius_mm / SMOOTH.polyp_radius_mm <= 2.5
        height = np.linalg.norm(caster.nearest(np.array([polyp.apex], np.float32))[0] - np.array(polyp.apex))
        assert height == pytest.approx(polyp.height_mm, rel=0.15)
        assert 0.4 <= height <= 1.3


@pytest.mark.parametrize("collapse", [0.5, 0.8])
def test_the_worst_place_is_pressed_to_the_asked_part_of_the_radius(collapse: float) -> None:
    still = replace(SMOOTH, length_mm=200.0, radius_variation=0.0)
    colon = build_colon(replace(still, collapse=collapse), 6)
    caster = RayCaster(colon.vertices, colon.triangles, threads=1)
    arc = np.arange(40.0, 160.0, 2.0)
    centre, axes = colon.line.at(arc)
    turn = np.arange(0, np.pi, np.pi / 60)[:, None, None]
    across = np.cos(turn) * axes[..., 0] + np.sin(turn) * axes[..., 1]
    reach = caster.cast(centre.astype(np.float32), across.astype(np.float32)).length
    short, long = reach.min(axis=0), reach.max(axis=0)
    assert short.min() == pytest.approx((1 - collapse) * still.radius_mm, rel=0.06)
    assert long[short.argmin()] > 1.15 * still.radius_mm
    assert np.mean(short > 0.97 * still.radius_mm) > 0.2  # elsewhere the lumen is open


def test_villi_ripple_the_wall_at_their_height() -> None:
    flat, velvet = (
        build_colon(replace(SMOOTH, villi_mm=villi, edge_mm=0.7, length_mm=60.0, pinch_mm=3.0), 7) for villi in (0, 0.6)
    )
    moved = np.linalg.norm(velvet.points.astype(float) - flat.points, axis=-1)[30:-30]
    assert np.sqrt(np.mean(moved**2)) == pytest.approx(0.6 / np.sqrt(8), rel=0.25)  # of a wave from trough to crest


def test_lesions_that_do_not_fit_are_refused() -> None:
    with pytest.raises(ValueError, match="no room for all diverticula"):
        build_colon(replace(COARSE, diverticula=20, length_mm=70.0), 0)
    with pytest.raises(ValueError, match="no room for 90 flat polyps"):
        build_colon(replace(COARSE, flat=90), 0)
    with pytest.raises(ValueError, match="too short for blind ends"):
        build_colon(replace(COARSE, closed_start=True, closed_end=True, length_mm=30.0), 0)


ANATOMY = st.builds(
    replace,
    st.just(replace(COARSE, edge_mm=2.5)),
    polyps=st.integers(0, 2),
    pedunculated=st.integers(0, 1),
    flat=st.integers(0, 1),
    diverticula=st.integers(0, 2),
    villi_mm=st.floats(0, 0.8),
    collapse=st.floats(0, 0.6),
    closed_start=st.booleans(),
    closed_end=st.booleans(),
    scene=st.sampled_from(["colon", "small_intestine"]),
)


@given(anatomy=ANATOMY, seed=st.integers(0, 10_000))
@settings(max_examples=10, deadline=None)
def test_any_anatomy_is_sound(anatomy: AnatomyConfig, seed: int) -> None:
    try:
        colon = build_colon(anatomy, seed)
    except ValueError as error:
        if "no room" not in str(error):
            raise
        reject()
    assert np.isfinite(colon.points).all()
    np.testing.assert_allclose(np.linalg.norm(colon.normals, axis=-1), 1.0, atol=1e-5)
    assert [polyp.kind for polyp in colon.polyps] == (
        ["sessile"] * anatomy.polyps + ["flat"] * anatomy.flat + ["pedunculated"] * anatomy.pedunculated
    )
    apexes = np.array([polyp.apex for polyp in colon.polyps]).reshape(-1, 3)
    for apex in apexes:
        assert np.abs(colon.vertices - apex).max(axis=1).min() < 1e-4
    bases = [(polyp.arc_mm, polyp.angle_rad, polyp.radius_mm) for polyp in colon.polyps[anatomy.polyps :]]
    bases += [(pouch.arc_mm, pouch.angle_rad, pouch.mouth_radius_mm) for pouch in colon.diverticula]
    for index, (arc, angle, radius) in enumerate(bases):
        for other_arc, other_angle, other_radius in bases[:index]:
            around = np.angle(np.exp(1j * (angle - other_angle))) * anatomy.radius_mm
            assert np.hypot(arc - other_arc, around) > radius + other_radius


def test_a_seed_fixes_everything(stalked: Colon) -> None:
    again, other = (build_colon(stalked.anatomy, seed) for seed in (3, 30))
    np.testing.assert_array_equal(stalked.points, again.points)
    assert [asdict(polyp) for polyp in stalked.polyps] == [asdict(polyp) for polyp in again.polyps]
    assert stalked.polyps != other.polyps


def test_new_lesions_leave_the_old_ones_where_they_were() -> None:
    plain = build_colon(replace(COARSE, polyps=2), 8)
    fuller = build_colon(replace(COARSE, polyps=2, pedunculated=1, flat=1), 8)
    assert (len(plain.polyps), len(fuller.polyps)) == (2, 4)
    for before, after in zip(plain.polyps, fuller.polyps[:2], strict=True):
        assert (before.arc_mm, before.angle_rad, before.height_mm) == (after.arc_mm, after.angle_rad, after.height_mm)
        assert np.linalg.norm(np.subtract(before.apex, after.apex)) < 2 * COARSE.edge_mm


def test_guts_without_the_new_features_are_as_they_were() -> None:
    """The demo clip's mesh was packed before lesions on stalks, blind ends and the rest existed."""
    packed = trimesh.load(DEMO_FOLDER / "mesh.ply", process=False).vertices
    colon = build_colon(DEMO.anatomy, DEMO.seed)
    assert len(packed) > 1000
    assert cKDTree(colon.vertices).query(packed)[0].max() < 1e-4
