"""Submaps, their evidence and their sparse depth, on a made-up tube whose truth is known."""

from dataclasses import replace
from pathlib import Path

import cv2  # noqa: F401 - before pycolmap: see pipeline/frontend/colmap/worker.py
import numpy as np
import pycolmap
import pytest
from scipy.spatial.transform import Rotation

from haustra.core.camera import Camera
from pipeline.depth.keyframe_selection import choose_keyframes
from pipeline.depth.sparse_depth import SparseDepthMaker, is_outlier, reliable_points
from pipeline.frontend.base import disjoint
from pipeline.frontend.colmap import worker
from pipeline.frontend.colmap.pairs import sequential_pairs
from pipeline.frontend.colmap.worker import camera_of, share_lens
from pipeline.frontend.scoring import Candidate, score
from pipeline.mapping.colmap_io import write_model
from pipeline.mapping.lighting_check import LightingCheck, best_stretch, check_lighting
from pipeline.mapping.submap import Submap, read_submap
from pipeline.matching.place_recognition import loop_pairs

CAMERA = Camera("PINHOLE", 320, 320, (160.0, 160.0, 160.0, 160.0))
RADIUS = 20.0


def tube_submap(frames=12, points=600, seed=0, noise_px=0.0):
    """A camera that moves down the axis of a tube of radius 20; every frame sees what projects into it."""
    rng = np.random.default_rng(seed)
    angle, height = rng.uniform(0, 2 * np.pi, points), rng.uniform(5, 90, points)
    world = np.stack([RADIUS * np.cos(angle), RADIUS * np.sin(angle), height], axis=1)
    poses = np.tile(np.eye(4), (frames, 1, 1))
    poses[:, :3, :3] = Rotation.from_euler("xy", rng.normal(0, 4, (frames, 2)), degrees=True).as_matrix()
    poses[:, :3, 3] = np.stack([rng.normal(0, 2, frames), rng.normal(0, 2, frames), np.arange(frames)], axis=1)
    observations, pixels = [], []
    for row, world_from_camera in enumerate(poses):
        local = (world - world_from_camera[:3, 3]) @ world_from_camera[:3, :3]
        uv = CAMERA.project(local)
        seen = np.flatnonzero((local[:, 2] > 3) & (uv > 0).all(1) & (uv < 320).all(1))
        observations += [(row, point) for point in seen]
        pixels.append(uv[seen] + rng.normal(0, noise_px, (len(seen), 2)) if noise_px else uv[seen])
    return Submap(
        np.arange(frames) * 2,
        poses,
        world,
        np.full(points, 0.4),
        np.array(observations),
        np.concatenate(pixels),
        CAMERA.params,
    )


@pytest.fixture(scope="module")
def tube():
    return tube_submap()


def test_depth_is_the_third_coordinate_in_the_camera(tube):
    depths = tube.depths()
    for k in range(0, len(depths), 97):
        frame, point = tube.observations[k]
        camera_from_world = np.linalg.inv(tube.world_from_camera[frame])
        expected = (camera_from_world @ np.append(tube.points[point], 1))[2]
        assert depths[k] == pytest.approx(expected)
        assert tube.points_in_camera(frame, tube.points[[point]])[0, 2] == pytest.approx(expected)


def test_triangulation_angle_is_the_widest_of_all_pairs(tube):
    angles = tube.triangulation_angles()
    frame, point = tube.observations.T
    for p in range(0, len(tube.points), 41):
        centres = tube.centres[frame[point == p]]
        rays = tube.points[p] - centres
        rays /= np.linalg.norm(rays, axis=1, keepdims=True)
        widest = np.degrees(np.arccos(np.clip((rays @ rays.T).min(), -1, 1))) if len(rays) else 0.0
        assert widest / 1.2 <= angles[p] + 1e-6 <= widest + 1e-5


def lit_image(submap, row, exponent=-2.0):
    """Brightness falls with the distance of the nearest point of the tube along each pixel's ray (by interpolation)."""
    from scipy.interpolate import NearestNDInterpolator

    mine = submap.observations[:, 0] == row
    distance = np.linalg.norm(submap.points[submap.observations[mine, 1]] - submap.centres[row], axis=1)
    rows, columns = np.mgrid[:320, :320] + 0.5
    field = NearestNDInterpolator(submap.pixels[mine], distance)(columns, rows)
    value = np.clip(200 * (field / field.min()) ** exponent, 0, 255)
    return np.repeat(value[..., None], 3, axis=2).astype(np.uint8)


def test_light_agrees_with_a_true_model_and_contradicts_a_mirrored_depth(tube):
    rows = {int(index): row for row, index in enumerate(tube.frames)}
    true = check_lighting(tube, lambda index: lit_image(tube, rows[index]))
    assert true.inconsistent_share == 0
    assert true.spearman < -0.8
    false = check_lighting(tube, lambda index: lit_image(tube, rows[index], exponent=1.0))
    assert false.inconsistent_share > 0.9
    assert (
        score([Candidate(tube, true, Path(), "global")], 12) > score([Candidate(tube, false, Path(), "global")], 12) + 1
    )


def test_a_mapper_that_leaves_frames_out_needs_clearly_better_light_to_win(tube):
    whole = LightingCheck(12, 600, 0.5, 5.0, -0.9, 0.0, 12)
    half = LightingCheck(6, 300, 0.4, 5.0, -0.95, 0.0, 6)
    wrong = LightingCheck(12, 600, 0.3, 5.0, -0.86, 0.17, 12)
    scores = [score([Candidate(tube, evidence, Path(), "global")], 12) for evidence in (whole, half, wrong)]
    assert scores[0] > scores[1] > scores[2]
    two_halves = [Candidate(tube, half, Path(), "global"), Candidate(tube, half, Path(), "global")]
    assert scores[2] < score(two_halves, 12) < scores[0]


def test_one_bad_frame_shows_although_the_median_does_not(tube):
    rows = {int(index): row for row, index in enumerate(tube.frames)}
    evidence = check_lighting(tube, lambda i: lit_image(tube, rows[i], 1.0 if rows[i] in (3, 4) else -2.0))
    assert evidence.spearman < -0.8
    assert evidence.inconsistent_share == pytest.approx(2 / 12)


def test_sparse_depth_is_exact_on_an_exact_model(tube):
    maker = SparseDepthMaker(tube, CAMERA)
    sparse = maker.sparse_depth(5)
    local = tube.points_in_camera(5, tube.points)
    pixels = CAMERA.project(local)
    assert len(sparse.depth) > 100
    for pixel, depth in zip(sparse.pixels, sparse.depth, strict=True):
        nearest = np.linalg.norm(pixels - pixel, axis=1).argmin()
        assert depth == pytest.approx(local[nearest, 2])
    depth_map, error_map = sparse.maps(320, 320)
    assert ((depth_map > 0) == (error_map > 0)).all()


def test_predicted_error_follows_from_noise():
    """Triangulating with noisy pixels (linear least squares, an oracle of its own) errs as the formula says."""
    noise = 0.5
    exact = tube_submap(frames=10, points=400)
    noisy = tube_submap(frames=10, points=400, noise_px=noise)
    good, predicted = reliable_points(exact, exact.triangulation_angles(), 160.0, noise)
    ratios = []
    for p in np.flatnonzero(good):
        frame = exact.observations[exact.observations[:, 1] == p, 0]
        uv = noisy.pixels[noisy.observations[:, 1] == p]
        if len(uv) != len(frame):
            continue
        a, b = np.zeros((3, 3)), np.zeros(3)
        for f, (u, v) in zip(frame, uv, strict=True):
            ray = exact.world_from_camera[f, :3, :3] @ np.array([(u - 160) / 160, (v - 160) / 160, 1])
            ray /= np.linalg.norm(ray)
            square = np.eye(3) - np.outer(ray, ray)
            a, b = a + square, b + square @ exact.centres[f]
        to_point = exact.points[p] - exact.centres[frame].mean(0)
        distance = np.linalg.norm(to_point)
        off = np.linalg.solve(a, b) - exact.points[p]
        ratios.append(abs(off @ to_point) / distance**2 / predicted[p])
    assert len(ratios) > 50
    # The median of |N(0,1)| is 0.67.
    assert 0.5 < np.median(ratios) < 0.9


def test_gross_outliers_are_found_and_fold_edges_are_not():
    rng = np.random.default_rng(0)
    pixels = rng.uniform(0, 320, (500, 2))
    depth = np.where(pixels[:, 0] < 160, 20.0, 60.0) * rng.normal(1, 0.02, 500)
    wrong = rng.choice(500, 10, replace=False)
    spoilt = depth.copy()
    spoilt[wrong] *= 2.5
    found = is_outlier(pixels, spoilt, 0.25)
    near_edge = np.abs(pixels[:, 0] - 160) < 25
    assert found[wrong[~near_edge[wrong]]].all()
    assert found.sum() - found[wrong].sum() < 0.03 * 500


def test_points_hidden_behind_a_nearer_surface_are_not_lent():
    """Two frames; the second sees a far wall that a near wall hides from the first."""
    near = np.stack([np.linspace(-3, 3, 60), np.zeros(60), np.full(60, 10.0)], axis=1)
    far = np.stack([np.linspace(-1, 1, 20), np.zeros(20), np.full(20, 40.0)], axis=1)
    poses = np.tile(np.eye(4), (2, 1, 1))
    observations = [(0, i) for i in range(60)] + [(1, i) for i in range(60, 80)]
    submap = Submap(
        np.arange(2), poses, np.concatenate([near, far]), np.zeros(80), np.array(observations),
        np.zeros((80, 2)), CAMERA.params,
    )  # fmt: skip
    maker = SparseDepthMaker(submap, CAMERA)
    maker.good[:] = True
    maker.error[:] = 0.01
    sparse = SparseDepthMaker.sparse_depth(maker, 0)
    assert (sparse.depth == 10).all()
    assert len(sparse.depth) == 60


def test_a_frame_belongs_to_one_submap_only(tube):
    first, second = tube.without_frames({16, 18, 20, 22}), tube.without_frames({0, 2, 4})
    parts = disjoint([first, second])
    assert parts[0].frames.tolist() == list(range(0, 16, 2))
    assert parts[1].frames.tolist() == [16, 18, 20, 22]
    pixels = CAMERA.project(parts[1].points_in_camera(2, parts[1].points))
    mine = parts[1].observations[:, 0] == 2
    np.testing.assert_allclose(parts[1].pixels[mine], pixels[parts[1].observations[mine, 1]], atol=1e-6)


def test_a_still_camera_has_one_keyframe_and_a_moving_one_several(tube):
    still = tube.__class__(
        tube.frames,
        np.repeat(tube.world_from_camera[:1], len(tube.frames), axis=0),
        tube.points,
        tube.error_px,
        np.array([(f, p) for f in range(len(tube.frames)) for p in range(50)]),
        np.tile(np.random.default_rng(0).uniform(0, 320, (50, 2)), (len(tube.frames), 1)),
        tube.camera_params,
    )
    assert choose_keyframes(still, 320, 0.02).tolist() == [0]
    assert 3 <= len(choose_keyframes(tube, 320, 0.02)) <= len(tube.frames)


def test_sequential_pairs_are_unique_and_in_reach():
    pairs = sequential_pairs([f"{i:02d}" for i in range(50)], 8)
    assert len(pairs) == len(set(pairs))
    offsets = {int(b) - int(a) for a, b in pairs}
    assert offsets == {*range(1, 9), 16, 32}
    order = list(dict.fromkeys(int(b) - int(a) for a, b in pairs))
    assert order == [1, 2, 4, 8, 16, 3, 5, 6, 7, 32]  # matching may have to end before the last


def test_loop_pairs_find_the_place_seen_before():
    rng = np.random.default_rng(0)
    places = [rng.normal(0, 60, (80, 128)) for _ in range(60)]
    places[55] = places[5] + rng.normal(0, 4, (80, 128))
    pairs = loop_pairs(places, stride=5, neighbours=1, min_gap=20, seed=0)
    assert (5, 55) in pairs
    assert all(b - a >= 20 for a, b in pairs)
    assert pairs == loop_pairs(places, stride=5, neighbours=1, min_gap=20, seed=0)


def test_submaps_of_one_film_share_the_lens_that_is_determined_best(tmp_path):
    """Two maps of one camera, of which one has settled on another focal length, as a short one may."""
    true = Camera("RADIAL", 320, 320, (160.0, 160.0, 160.0, 0.0, 0.0))
    wrong = (230.0, 160.0, 160.0, 0.05, 0.0)
    whole = tube_submap(noise_px=0.2)
    seen = np.flatnonzero(whole.track_lengths() >= 2)
    mine = np.isin(whole.observations[:, 1], seen)
    rows = np.column_stack([whole.observations[mine, 0], np.searchsorted(seen, whole.observations[mine, 1])])
    submap = replace(
        whole, points=whole.points[seen], error_px=whole.error_px[seen], observations=rows, pixels=whole.pixels[mine]
    )
    models = []
    for name, params in (("a", true.params), ("b", wrong)):
        write_model(replace(submap, camera_params=params), replace(true, params=params), tmp_path / name)
        models.append(pycolmap.Reconstruction(tmp_path / name))
    sigmas = [np.array([0.5, 0.001, 0.001]), np.array([9.0, 0.1, 0.1])]
    assert share_lens(models, sigmas, [150.0, 160.0, 160.0, 0.0, 0.0])
    for model in models:
        np.testing.assert_allclose(camera_of(model).params, true.params, atol=1e-9)
        assert model.compute_mean_reprojection_error() < 0.5
    unknown = [np.array([np.nan] * 3)] * 2
    assert share_lens(models, unknown, list(wrong))
    np.testing.assert_allclose([camera_of(model).params for model in models], [wrong, wrong], atol=1e-9)
    assert not share_lens(models[:1], sigmas[:1], list(wrong))


def test_ends_of_a_map_that_mostly_contradict_the_light_are_cut():
    nan = float("nan")
    right, wrong = [-0.8] * 40, [0.3] * 6
    assert best_stretch(np.array(right + wrong)) == (0, 40)
    assert best_stretch(np.array(wrong + right)) == (6, 46)
    assert best_stretch(np.array([*right, 0.1, *right])) == (0, 81)  # one bad frame is no reason to part them
    assert best_stretch(np.array(right + [0.3] * 50 + right)) == (0, 40)
    assert best_stretch(np.array(right + [0.3, -0.2, 0.3] * 5)) == (0, 40)
    assert best_stretch(np.array([nan] * 5 + right)) == (0, 45)
    begin, end = best_stretch(np.array(wrong))
    assert begin == end


def test_a_submap_without_points_keeps_the_others_observations(tube):
    drop = np.arange(len(tube.points)) % 3 == 0
    left = tube.without_points(drop)
    np.testing.assert_array_equal(left.points, tube.points[~drop])
    kept = ~drop[tube.observations[:, 1]]
    np.testing.assert_array_equal(left.pixels, tube.pixels[kept])
    np.testing.assert_array_equal(left.points[left.observations[:, 1]], tube.points[tube.observations[kept, 1]])
    np.testing.assert_array_equal(left.observations[:, 0], tube.observations[kept, 0])


def test_a_model_that_a_worker_was_killed_over_is_not_taken_for_whole(tube, tmp_path, monkeypatch):
    def killed(path, **_):
        path.write_bytes(b"PK")
        raise KeyboardInterrupt

    write_model(tube, CAMERA, tmp_path / "given")
    model = pycolmap.Reconstruction(tmp_path / "given")
    monkeypatch.setattr(worker.np, "savez", killed)
    with pytest.raises(KeyboardInterrupt):
        worker._write(model, tmp_path / "found")
    assert not (tmp_path / "found" / "model.npz").exists()
    monkeypatch.undo()
    worker._write(model, tmp_path / "found")
    assert len(read_submap(tmp_path / "found").points) == len(tube.points)
