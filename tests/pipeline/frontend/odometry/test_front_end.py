"""The streaming front end on rendered views of a textured tube: tracking, loss, submaps, joining, what it writes."""

import cv2
import numpy as np
import pytest
from scipy.spatial.distance import cdist

from haustra.core.errors import HaustraError
from haustra.core.progress import SilentProgress
from pipeline.config import Config
from pipeline.frontend.odometry import klt
from pipeline.frontend.odometry.corner_tracks import CELLS, CornerTracks
from pipeline.frontend.odometry.frame_io import frame_features
from pipeline.frontend.odometry.klt import detect, track_klt, tracker_image
from pipeline.frontend.structure_stage import solve_structure
from pipeline.mapping.colmap_io import write_model
from pipeline.mapping.submap_of_map import to_submap
from pipeline.matching.descriptor_matching import match_descriptors
from reconstruction.evaluation.trajectory_metrics import trajectory_errors
from tests.helpers.tubes.textured_tube import CAMERA, MASK, RADIUS, SIZE, camera_at, polished, render, run, stored


@pytest.fixture(scope="module")
def clip():
    """40 frames and their true poses."""
    poses = [camera_at(k) for k in range(40)]
    return [render(world_from_camera) for world_from_camera in poses], np.stack(poses)


@pytest.fixture(scope="module")
def whole(clip):
    maps, _ = run(clip[0])
    return [to_submap(m, CAMERA.params) for m in polished(maps)]


def test_a_clip_is_posed_whole_and_right(clip, whole):
    (submap,) = whole
    assert len(submap.frames) >= 38
    errors = trajectory_errors(submap.world_from_camera, clip[1][submap.frames])
    path = np.linalg.norm(np.diff(clip[1][:, :3, 3], axis=0), axis=1).sum()
    assert errors.ate_rmse < 0.01 * path
    assert errors.rotation_median_deg < 1.0


def test_points_lie_on_the_wall_and_project_to_what_was_seen(clip, whole):
    (submap,) = whole
    truth = clip[1][submap.frames]
    errors = trajectory_errors(submap.world_from_camera, truth)
    depth = submap.depths()
    frame, point = submap.observations.T
    local = np.einsum(
        "mji,mj->mi", submap.world_from_camera[frame, :3, :3], submap.points[point] - submap.centres[frame]
    )
    off = np.linalg.norm(CAMERA.project(local) - submap.pixels, axis=1)
    assert (depth > 0).all()
    assert off.max() < 2.1
    summed = np.bincount(point, off) / np.bincount(point)
    np.testing.assert_allclose(summed, submap.error_px, atol=1e-6)
    world = truth[frame, :3, 3] + np.einsum("mij,mj->mi", truth[frame, :3, :3], local * errors.scale)
    assert np.median(np.abs(np.hypot(world[:, 0], world[:, 1]) - RADIUS)) < 0.05 * RADIUS


def test_the_same_seed_gives_the_same_result(clip):
    first, second = (run(clip[0][:22], seed=3)[0] for _ in range(2))
    assert len(first) == len(second) == 1
    one, other = (to_submap(maps[0], CAMERA.params) for maps in (first, second))
    np.testing.assert_array_equal(one.world_from_camera, other.world_from_camera)
    np.testing.assert_array_equal(one.points, other.points)


@pytest.mark.parametrize("kind", ["black", "white", "frozen", "noise", "masked"])
def test_useless_video_gives_no_map_and_no_crash(clip, kind):
    rng = np.random.default_rng(0)
    images = {
        "black": [np.zeros((SIZE, SIZE, 3), np.uint8)] * 12,
        "white": [np.full((SIZE, SIZE, 3), 255, np.uint8)] * 12,
        "frozen": [clip[0][0]] * 12,
        "noise": [rng.integers(0, 255, (SIZE, SIZE, 3), dtype=np.uint8) for _ in range(12)],
        "masked": clip[0][:12],
    }[kind]
    maps, states = run(images, mask=np.zeros_like(MASK) if kind == "masked" else MASK)
    assert maps == []
    assert set(states) == {"starting"}


def test_a_pause_and_a_jump_do_not_end_the_map(clip):
    """The camera rests for ten frames; later three frames are dropped."""
    images = clip[0][:20] + [clip[0][19]] * 10 + clip[0][20:24] + clip[0][27:34]
    maps, _ = run(images)
    assert len(maps) == 1
    assert to_submap(maps[0], CAMERA.params).frames[-1] == len(images) - 1


def test_images_without_the_lamp_survive_a_change_of_light(clip):
    """Half the light and another gamma: tracks must not move by more than a tenth of a pixel."""
    darker = (255 * (clip[0][0] / 255.0 * 0.5) ** 0.8).astype(np.uint8)
    first, second = tracker_image(clip[0][0], MASK), tracker_image(darker, MASK)
    reference_pixels = detect(first, np.zeros((0, 2), np.float32), 12)
    now, found = track_klt(first, second, reference_pixels, reference_pixels)
    assert len(reference_pixels) > 100
    assert found.mean() > 0.9
    assert np.median(np.abs(now - reference_pixels)[found]) < 0.1


def test_tracks_are_the_same_by_one_thread_and_by_two(clip, monkeypatch):
    first, second = (tracker_image(clip[0][k], MASK) for k in (0, 4))
    corners = detect(first, np.zeros((0, 2), np.float32), 12)
    assert len(corners) > klt.MANY
    both = []
    for many in (len(corners) + 1, len(corners)):
        monkeypatch.setattr(klt, "MANY", many)
        both.append(track_klt(first, second, corners, corners + np.float32(1), near=True))
    assert 0.2 < both[0][1].mean() < 1
    np.testing.assert_array_equal(both[0][0], both[1][0])
    np.testing.assert_array_equal(both[0][1], both[1][1])


def test_tracks_follow_a_known_shift(clip):
    image = clip[0][0]
    cuts = image[:160, :160], image[3:163, 5:165]
    first, second = (tracker_image(np.ascontiguousarray(cut), MASK[:160, :160]) for cut in cuts)
    reference_pixels = detect(first, np.zeros((0, 2), np.float32), 12)
    now, found = track_klt(first, second, reference_pixels, reference_pixels)
    assert found.mean() > 0.6
    np.testing.assert_allclose(np.median((now - reference_pixels)[found], axis=0), [-5, -3], atol=0.05)


@pytest.mark.parametrize("shape", [(320, 320), (240, 320), (480, 640), (200, 420)])
@pytest.mark.parametrize("cut", [0.0, 0.3])
def test_a_wide_or_cut_picture_is_tracked_by_as_many_corners(shape, cut):
    """Noise has a corner everywhere; `cut` is the share of the height and width that the mask takes from each corner,
    as an octagonal picture does."""
    picture = np.random.default_rng(0).integers(0, 255, (*shape, 3), dtype=np.uint8)
    y, x = (np.minimum(a, a[::-1] if k == 0 else a[:, ::-1]) for k, a in enumerate(np.indices(shape)))
    mask = np.where(y / shape[0] + x / shape[1] < cut, 0, 255).astype(np.uint8)
    tracks = CornerTracks()
    tracks.set_reference(tracker_image(cv2.GaussianBlur(picture, (0, 0), 1.5), mask))
    assert len(tracks.ids) == pytest.approx(CELLS, rel=0.15)


@pytest.mark.parametrize("share", [0.0, 0.3, 0.7])
def test_glare_does_not_crowd_the_corners_beside_it(share):
    """Where a share of the picture shines, as one field or as specks all over, there are no more corners than
    without."""
    picture = cv2.GaussianBlur(np.random.default_rng(0).integers(0, 255, (320, 320, 3), np.uint8), (0, 0), 1.5)
    field, specks = (np.full((320, 320), 255, np.uint8) for _ in range(2))
    field[:, : round(share * 320)] = 0
    for x, y in np.random.default_rng(1).integers(0, 320, (round(150 * share), 2)).tolist():
        cv2.circle(specks, (x, y), 4, 0, -1)
    for mask in (field, specks):
        tracks = CornerTracks()
        tracks.set_reference(tracker_image(picture, mask))
        assert len(tracks.ids) < 1.15 * CELLS


def followed(second, off):
    """Tracks of a picture that moved by (-15, -9), looked for `off` (N,2) from where they are; None: with no guess."""
    tracks = CornerTracks()
    tracks.set_reference(tracker_image(np.ascontiguousarray(second[:150, :150]), MASK[:150, :150]))
    guess = None if off is None else tracks.reference_pixels + np.array([-15, -9]) + off(len(tracks.reference_pixels))
    tracks.follow(tracker_image(np.ascontiguousarray(second[9:159, 15:165]), MASK[:150, :150]), guess)
    right = np.abs(tracks.now - tracks.reference_pixels - [-15, -9]).max(axis=1) < 1
    return tracks.found & right, tracks.found & ~right


@pytest.mark.parametrize("share", [0.4, 1.0])
def test_tracks_whose_guess_is_wrong_are_found_as_without_one(clip, share):
    """A guess 12 px off for some of them or for all, too far to search near it: those are searched in coarse images."""

    def off(count):
        return np.where(np.arange(count) < share * count, 10.0, 0.0)[:, None] * np.array([1.0, -0.7])

    alone, _ = followed(clip[0][0], None)
    good, _ = followed(clip[0][0], lambda count: np.zeros((count, 2)))
    right, wrong = followed(clip[0][0], off)
    assert alone.sum() > 60
    assert good.sum() >= alone.sum()
    assert right.sum() > 0.85 * alone.sum()
    assert wrong.sum() < 0.1 * right.sum()


@pytest.mark.parametrize("near", [True, False])
def test_what_is_not_in_the_picture_is_not_found(clip, near):
    """Another part of the wall: the way back does not end where the way there began."""
    first, second = tracker_image(clip[0][0], MASK), tracker_image(np.ascontiguousarray(clip[0][0][::-1, ::-1]), MASK)
    reference_pixels = detect(first, np.zeros((0, 2), np.float32), 12)
    _, found = track_klt(first, second, reference_pixels, reference_pixels, near)
    assert found.mean() < 0.15


def test_new_corners_keep_away_from_old_ones(clip):
    view = tracker_image(clip[0][0], MASK)
    reference_pixels = detect(view, np.zeros((0, 2), np.float32), 12)
    assert len(detect(view, reference_pixels, 12)) < 0.1 * len(reference_pixels)
    cells = np.unique(np.floor(reference_pixels / 12), axis=0)
    assert len(cells) == len(reference_pixels)


def unit(descriptors):
    return (descriptors / np.linalg.norm(descriptors, axis=1, keepdims=True)).astype(np.float32)


def test_matches_are_mutual_and_clear():
    rng = np.random.default_rng(0)
    descriptors = unit(rng.normal(size=(40, 128)))
    shuffled = rng.permutation(40)
    noisy = unit(descriptors[shuffled] + 0.005 * rng.normal(size=(40, 128)))
    pairs = match_descriptors(descriptors, noisy)
    assert len(pairs) == 40
    assert (shuffled[pairs[:, 1]] == pairs[:, 0]).all()
    assert len(match_descriptors(descriptors, np.concatenate([noisy, noisy]))) == 0
    twins = match_descriptors(np.concatenate([descriptors, descriptors]), noisy)
    one_each = {(int(i) % 40, int(j)) for i, j in twins}  # which of two twins is rounding's choice
    assert one_each == {tuple(pair) for pair in pairs.tolist()}
    assert len(twins) == 40


@pytest.mark.parametrize("seed", range(5))
def test_matches_are_those_of_a_search_by_distance(seed):
    """Against SciPy's distances: nearest both ways, and nearer than 0.85 of the second nearest."""
    rng = np.random.default_rng(seed)
    first, second = unit(rng.random((90, 16))), unit(rng.random((70, 16)))
    second[:30] = unit(first[20:50] + 0.05 * rng.normal(size=(30, 16)))
    distance = cdist(first.astype(float), second.astype(float))
    expected = [
        (i, int(row.argmin()))
        for i, row in enumerate(distance)
        if distance[:, row.argmin()].argmin() == i and row.min() < 0.85 * np.partition(row, 1)[1]
    ]
    assert len(expected) > 10
    np.testing.assert_array_equal(match_descriptors(first, second), expected)


def test_the_structure_stage_gives_the_same_kind_of_submap_as_colmap(clip, tmp_path):
    workspace, frames = stored(tmp_path, clip[0][:30])
    config = Config(front_end="odometry")
    (submap,) = solve_structure(
        frames, frame_features(workspace), config.front_end, config.front_end_settings, workspace, SilentProgress()
    )
    assert np.median(submap.depths()) == pytest.approx(1.0)
    assert workspace.result("structure")["mapper"] == "odometry"
    again = solve_structure(
        frames, frame_features(workspace), config.front_end, config.front_end_settings, workspace, SilentProgress()
    )
    np.testing.assert_array_equal(again[0].points, submap.points)


def test_the_model_on_disk_is_one_that_colmap_reads(clip, tmp_path):
    import subprocess
    import sys

    workspace, frames = stored(tmp_path, clip[0][:24])
    (submap,) = solve_structure(
        frames, frame_features(workspace), "odometry", Config().front_end_settings, workspace, SilentProgress()
    )
    write_model(submap, frames.camera, tmp_path / "model")
    code = (
        "import cv2, sys, pycolmap; m = pycolmap.Reconstruction(sys.argv[1]); i = m.find_image_with_name('000010.jpg');"
        "print(m.num_reg_images(), m.num_points3D(), m.compute_mean_reprojection_error(), *i.projection_center())"
    )
    done = subprocess.run(
        [sys.executable, "-c", code, str(tmp_path / "model")], capture_output=True, text=True, check=True
    )
    images, points, _, *centre = done.stdout.split()
    assert (int(images), int(points)) == (len(submap.frames), len(submap.points))
    row = np.flatnonzero(submap.frames == 10)[0]
    np.testing.assert_allclose(np.array(centre, float), submap.centres[row], atol=1e-9)


def test_a_camera_that_does_not_move_is_one_sentence(clip, tmp_path):
    workspace, frames = stored(tmp_path, [clip[0][0]] * 5)
    with pytest.raises(
        HaustraError, match=r"too little motion of the camera .*5 frames.*; give .* where the camera moves"
    ):
        solve_structure(
            frames, frame_features(workspace), "odometry", Config().front_end_settings, workspace, SilentProgress()
        )
