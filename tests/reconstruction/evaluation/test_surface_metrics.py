"""Surface errors against brute force and shapes whose distance is known; reference surface against the formula."""

import json

import cv2
import numpy as np
import pytest
import trimesh
from scipy.spatial.distance import cdist

from haustra.core.errors import ReconstructionError
from reconstruction.evaluation.reference_surface import (
    ReferenceSurface,
    read_reference_surface,
    reference_from_mesh,
    thin,
)
from reconstruction.evaluation.surface_metrics import point_errors, sample_surface, surface_errors
from reconstruction.evaluation.trajectory_io import read_tum, write_tum
from reconstruction.fusion.tsdf import SurfaceFusion, TsdfSettings
from reconstruction.mesh.surface_mesh import SurfaceMesh, drop_small_components
from tests.helpers.real_data import shared


def sphere(radius):
    made = trimesh.creation.icosphere(subdivisions=5, radius=radius)
    return SurfaceMesh.from_triangles(made.vertices, made.faces)


def test_point_errors_equal_brute_force():
    rng = np.random.default_rng(0)
    built, seen = rng.uniform(0, 10, (300, 3)), rng.uniform(0, 10, (400, 3))
    required = seen[:150]
    errors = point_errors(built, seen, required, tau=0.8)
    there, back = cdist(built, seen).min(axis=1), cdist(required, built).min(axis=1)
    assert errors.accuracy_mean == pytest.approx(there.mean())
    assert errors.accuracy_median == pytest.approx(np.median(there))
    assert errors.completeness_mean == pytest.approx(back.mean())
    assert errors.completeness_median == pytest.approx(np.median(back))
    assert errors.chamfer == pytest.approx((there.mean() + back.mean()) / 2)
    precision, recall = np.mean(there < 0.8), np.mean(back < 0.8)
    assert (errors.precision, errors.recall) == pytest.approx((precision, recall))
    assert errors.f_score == pytest.approx(2 * precision * recall / (precision + recall))
    assert (errors.reconstructed_points, errors.seen_points, errors.required_points) == (300, 400, 150)


@pytest.mark.parametrize(("grown", "score"), [(0.4, 1.0), (0.6, 0.0)])
def test_a_sphere_grown_by_a_known_length(grown, score):
    rng = np.random.default_rng(0)
    true = sphere(10)
    points = sample_surface(true.vertices, true.faces, 150_000, rng)
    errors = surface_errors(sphere(10 + grown), ReferenceSurface(points, points), tau=0.5, generator=rng)
    assert errors.accuracy_mean == pytest.approx(grown, abs=0.02)
    assert errors.completeness_mean == pytest.approx(grown, abs=0.02)
    assert errors.f_score == pytest.approx(score, abs=0.01)
    assert f"{100 * errors.f_score:.2f} % at 0.5 mm" in str(errors)


def test_half_a_sphere_is_accurate_and_half_complete():
    rng = np.random.default_rng(0)
    true = sphere(10)
    points = sample_surface(true.vertices, true.faces, 20_000, rng)
    half = true.with_faces((true.vertices[true.faces][..., 2] > 0).all(axis=1))
    errors = surface_errors(half, ReferenceSurface(points, points), tau=0.6, generator=rng)
    assert errors.precision > 0.999
    assert errors.recall == pytest.approx(0.5, abs=0.03)


def test_samples_are_uniform_by_area_and_repeatable():
    """One triangle has nine times the area of the other, though both are one face."""
    vertices = np.array([[0, 0, 0], [3, 0, 0], [0, 3, 0], [10, 0, 0], [11, 0, 0], [10, 1, 0]], float)
    faces = np.array([[0, 1, 2], [3, 4, 5]])
    points = sample_surface(vertices, faces, 40_000, np.random.default_rng(0))
    assert np.mean(points[:, 0] < 5) == pytest.approx(0.9, abs=0.01)
    np.testing.assert_allclose(points[points[:, 0] < 5].mean(axis=0), [1, 1, 0], atol=0.02)
    np.testing.assert_array_equal(points, sample_surface(vertices, faces, 40_000, np.random.default_rng(0)))
    with pytest.raises(ReconstructionError, match="no area"):
        sample_surface(np.zeros((3, 3)), np.array([[0, 1, 2]]), 10, np.random.default_rng(0))


def test_thinning_leaves_the_mean_of_every_cube():
    points = np.array([[0.1, 0.1, 0.1], [0.3, 0.1, 0.1], [0.7, 0, 0], [-0.1, 0, 0]])
    np.testing.assert_allclose(
        sorted(thin(points, 0.5).tolist()), [[-0.1, 0, 0], [0.2, 0.1, 0.1], [0.7, 0, 0]], atol=1e-12
    )


def write_folder(folder, model="PINHOLE", distortion=(), frames=2):
    """A camera that steps 1 mm sideways before a wall at z = 20 (upper half of the picture) and 80 (lower)."""
    (folder / "depth").mkdir(parents=True)
    params = [50.0, 50.0, 40.0, 30.0, *distortion]
    camera = {"model": model, "width": 80, "height": 60, "params": params, "fps": 30, "depth_unit_mm": 0.01}
    (folder / "camera.json").write_text(json.dumps(camera))
    world_from_camera = np.tile(np.eye(4), (frames, 1, 1))
    world_from_camera[:, 0, 3] = np.arange(frames)
    write_tum(folder / "trajectory.txt", np.arange(frames) / 30, world_from_camera)
    depth = np.repeat(np.array([2000, 8000], np.uint16), 30)[:, None] * np.ones((1, 80), np.uint16)
    for number in range(frames):
        cv2.imwrite(str(folder / "depth" / f"{number:05d}.png"), depth)
    return folder


def test_observed_truth_is_the_back_projected_depth(tmp_path):
    truth = read_reference_surface(write_folder(tmp_path), spacing_mm=0.01)
    near = truth.required
    np.testing.assert_allclose(near[:, 2], 20, atol=1e-9)
    assert near[:, 0].min() == pytest.approx((0.5 - 40) / 50 * 20)  # the left pixel's centre
    assert near[:, 0].max() == pytest.approx((79.5 - 40) / 50 * 20 + 1)  # the right one's, of the second pose
    assert near[:, 1].min() == pytest.approx((0.5 - 30) / 50 * 20)
    assert np.isclose(truth.seen[:, 2], 80).any()


def test_observed_truth_of_a_fisheye_equals_opencvs_projection(tmp_path):
    distortion = (-0.05, 0.01, -0.002, 0.0004)
    folder = write_folder(tmp_path, "OPENCV_FISHEYE", distortion, frames=1)
    points = read_reference_surface(folder, spacing_mm=0.001).seen
    matrix = np.array([[50.0, 0, 40], [0, 50.0, 30], [0, 0, 1]])
    pixels, _ = cv2.fisheye.projectPoints(points[:, None], np.zeros(3), np.zeros(3), matrix, np.array(distortion))
    np.testing.assert_allclose(np.abs(pixels % 1 - 0.5), 0, atol=1e-4)


def test_long_sequences_are_thinned_on_the_way(tmp_path):
    """More frames than are held at once, all of the same wall: the cubes stay as many as the wall has."""
    folder = write_folder(tmp_path, frames=40)
    (folder / "trajectory.txt").write_text("".join(f"{k} 0 0 0 0 0 0 1\n" for k in range(40)))
    assert len(read_reference_surface(folder).seen) == len(read_reference_surface(folder, every=40).seen)


def test_pictures_without_leading_zeros_have_their_own_poses(tmp_path):
    folder = write_folder(tmp_path, frames=12)
    expected = read_reference_surface(folder).seen
    for number in range(12):
        depth = cv2.imread(str(folder / "depth" / f"{number:05d}.png"), cv2.IMREAD_UNCHANGED)
        depth[:] = 1000 + 100 * number
        (folder / "depth" / f"{number:05d}.png").unlink()
        cv2.imwrite(str(folder / "depth" / f"{number}.png"), depth)
    points = read_reference_surface(folder, spacing_mm=0.01).seen
    assert len(expected)
    for number in range(12):  # a wall at its own distance, and as wide as it is from its own camera
        x = points[np.isclose(points[:, 2], 10 + number), 0]
        half = 39.5 / 50 * (10 + number)
        assert (x.min(), x.max()) == pytest.approx((number - half, number + half), abs=0.01)


def test_truth_without_depth_is_the_mesh_or_what_was_seen_of_it(tmp_path):
    whole = trimesh.creation.icosphere(subdivisions=3, radius=10)
    whole.export(tmp_path / "mesh.ply")
    points = read_reference_surface(tmp_path).seen
    np.testing.assert_allclose(np.linalg.norm(points, axis=1), 10, atol=0.15)
    whole.face_attributes["seen"] = (whole.triangles_center[:, 2] > 0).astype(np.uint8)
    whole.export(tmp_path / "mesh.ply")
    half = reference_from_mesh(tmp_path / "mesh.ply").required
    assert half[:, 2].min() > -2
    assert len(half) == pytest.approx(len(points) / 2, rel=0.1)


def test_truth_of_a_wall_that_contracts_is_the_wall_at_rest(tmp_path):
    folder = write_folder(tmp_path / "film")
    trimesh.creation.icosphere(subdivisions=3, radius=10).export(folder / "mesh.ply")
    contraction = {"frame": 1, "centre_mm": 50.0, "strength": 0.3, "width_mm": 9.0}
    for contractions, of_mesh in (([], False), ([contraction], True)):
        (folder / "events.json").write_text(json.dumps({"slots": [], "contractions": contractions}))
        distance = np.linalg.norm(read_reference_surface(folder).seen, axis=1)
        assert np.allclose(distance, 10, atol=0.15) == of_mesh


def test_truth_that_cannot_be_read_is_named(tmp_path):
    folder = write_folder(tmp_path / "a", "EQUIRECTANGULAR")
    with pytest.raises(ReconstructionError, match="EQUIRECTANGULAR"):
        read_reference_surface(folder)
    folder = write_folder(tmp_path / "b")
    (folder / "depth" / "00001.png").unlink()
    with pytest.raises(ReconstructionError, match="1 depth images for 2 poses"):
        read_reference_surface(folder)
    (folder / "camera.json").write_text("{}")
    with pytest.raises(ReconstructionError, match="not a camera file"):
        read_reference_surface(folder)


def test_true_depth_of_a_colon_fuses_to_its_surface():
    folder = shared("ctcolon")
    camera = json.loads((folder / "camera.json").read_text())
    fx, fy, cx, cy = camera["params"]
    _, world_from_camera = read_tum(folder / "trajectory.txt")
    fusion = SurfaceFusion(TsdfSettings(voxel_size=0.7))
    for number in range(0, 80, 4):
        rgb = cv2.cvtColor(cv2.imread(str(folder / "rgb" / f"{number:05d}.png")), cv2.COLOR_BGR2RGB)
        depth = cv2.imread(str(folder / "depth" / f"{number:05d}.png"), cv2.IMREAD_UNCHANGED).astype(np.float32) / 100
        fusion.integrate(rgb, depth, None, np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]]), world_from_camera[number])
    mesh, _ = drop_small_components(fusion.extract(), min_fraction=0.01)
    errors = surface_errors(mesh, read_reference_surface(folder, every=4), 1.0, np.random.default_rng(0))
    assert errors.f_score > 0.97
    assert errors.precision > 0.99
    assert errors.accuracy_mean < 0.25
