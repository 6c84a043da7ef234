"""The lens from the map: a focal length that is a sixth off is found where the motion determines it, and only there."""

import json
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from haustra.core.camera import Camera
from haustra.core.progress import SilentProgress
from haustra.core.ray_table import RayTable
from pipeline.frontend.base import MAX_FOCAL_SIGMA
from pipeline.frontend.odometry import self_calibration
from pipeline.frontend.odometry.self_calibration import (
    MIN_VIEWS,
    Lens,
    doubt_of_lens,
    refine_lens,
    thinned,
)
from pipeline.input.endomapper_scopes import colonoscope_across
from pipeline.mapping.local_map import LocalMap
from pipeline.mapping.submap import Submap

TRUE = Camera("SIMPLE_RADIAL", 320, 320, (160.0, 160.0, 160.0, -0.05))
GUESS = Camera("SIMPLE_RADIAL", 320, 320, (134.0, 160.0, 160.0, 0.0), trusted=False)


def filmed(centres, turns_deg, noise_px=0.2, points=300):
    """Points of a bent wall seen through the true lens, given with the poses and points of the truth."""
    rng = np.random.default_rng(0)
    wall = np.stack([rng.uniform(-2, 2, points), rng.uniform(-2, 2, points), np.zeros(points)], axis=1)
    wall[:, 2] = 3 + 0.5 * np.sin(2 * wall[:, 0]) + 0.4 * np.cos(3 * wall[:, 1])
    poses, observations, pixels = [], [], []
    for row, (centre, turn) in enumerate(zip(centres, turns_deg, strict=True)):
        world_from_camera = np.eye(4)
        world_from_camera[:3, :3], world_from_camera[:3, 3] = (
            Rotation.from_euler("xyz", turn, degrees=True).as_matrix(),
            centre,
        )
        seen = TRUE.project((wall - world_from_camera[:3, 3]) @ world_from_camera[:3, :3])
        inside = np.flatnonzero(((seen > 0) & (seen < 320)).all(axis=1))
        poses.append(world_from_camera)
        observations.append(np.stack([np.full(len(inside), row), inside], axis=1))
        pixels.append(seen[inside] + rng.normal(0, noise_px, (len(inside), 2)))
    error = np.full(points, 0.3)
    return Submap(
        np.arange(len(poses)),
        np.stack(poses),
        wall,
        error,
        np.concatenate(observations),
        np.concatenate(pixels),
        GUESS.params,
    )


def wandering(count=14):
    """A camera that moves and turns about both axes, as an endoscope in search does."""
    t = np.linspace(0, 1, count)
    centres = np.stack([np.sin(4 * t), 0.7 * np.cos(5 * t), 0.8 * t], axis=1)
    return centres, np.stack([15 * np.sin(5 * t), 20 * np.cos(4 * t), 25 * t], axis=1)


def test_focal_length_and_radial_term_are_found(tmp_path):
    lens = refine_lens(filmed(*wandering()), GUESS, 0, tmp_path, SilentProgress())
    assert lens.determined
    focal, k1 = lens.camera.params[0], lens.camera.params[3]
    # sigma is for one pixel of noise, and 0.2 px were added: four sigmas of that.
    assert abs(focal - 160) < max(4 * 0.2 * lens.sigma[0], 0.05)
    assert abs(k1 + 0.05) < 0.01
    assert lens.sigma[0] < MAX_FOCAL_SIGMA * focal
    again = refine_lens(filmed(*wandering()), GUESS, 0, tmp_path, SilentProgress())
    assert again == lens


def test_a_motion_that_does_not_determine_the_lens_leaves_the_guess(tmp_path):
    count = 8
    centres = np.stack([np.linspace(0, 0.01, count), np.zeros(count), np.zeros(count)], axis=1)
    lens = refine_lens(filmed(centres, np.zeros((count, 3)), points=12), GUESS, 0, tmp_path, SilentProgress())
    assert not lens.determined
    assert lens.camera == GUESS


def test_a_failing_adjustment_is_a_sentence(tmp_path, monkeypatch):
    monkeypatch.setattr(
        "pipeline.frontend.odometry.self_calibration.write_model", lambda *_: (tmp_path / "lens").mkdir()
    )
    said = []

    class Listening(SilentProgress):
        def log(self, sentence):
            said.append(sentence)

    lens = refine_lens(filmed(*wandering()), GUESS, 0, tmp_path, Listening())
    assert not lens.determined
    assert "the guessed lens stays" in said[0]


@pytest.mark.parametrize("most", [3, 5, 100])
def test_thinning_keeps_frames_apart_and_points_seen_often_enough(most):
    whole = filmed(*wandering())
    thin = thinned(whole, most)
    assert len(thin.frames) == min(most, len(whole.frames))
    assert {int(thin.frames[0]), int(thin.frames[-1])} == {0, len(whole.frames) - 1}
    assert len(thin.points) == 0 or thin.track_lengths().min() >= MIN_VIEWS
    row, point = thin.observations.T
    originals = {tuple(p) for p in whole.pixels}
    assert all(tuple(p) in originals for p in thin.pixels)
    seen = TRUE.project(
        np.einsum("mij,mi->mj", thin.world_from_camera[row, :3, :3], thin.points[point] - thin.centres[row])
    )
    assert np.abs(seen - thin.pixels).max() < 2  # each pixel still belongs to its point and frame


def test_a_long_submap_is_thinned_to_the_stretch_that_turns_most():
    """Every point is seen by 12 frames in a row: spread over all, no two frames would share one."""
    frames, span = 400, 12
    poses = np.tile(np.eye(4), (frames, 1, 1))
    turn = np.zeros(frames)
    turn[250:300] = np.radians(2)
    poses[:, :3, :3] = Rotation.from_rotvec(np.cumsum(turn)[:, None] * [0, 1, 0]).as_matrix()
    point, offset = np.divmod(np.arange((frames - span) * span), span)
    long = Submap(
        np.arange(frames),
        poses,
        np.zeros((frames - span, 3)),
        np.zeros(frames - span),
        np.stack([point + offset, point], axis=1),
        np.zeros((len(point), 2)),
        GUESS.params,
    )
    few = thinned(long, 20, widest_step=4)
    assert len(few.frames) == 20
    assert np.diff(few.frames).max() <= 5
    assert few.frames[0] <= 250
    assert few.frames[-1] >= 290
    assert len(few.points) > 40


def test_recalibration_moves_rays_and_not_pixels():
    first, second = RayTable(GUESS), RayTable(TRUE)
    local_map = LocalMap(first)
    pixels = np.random.default_rng(1).uniform(40, 280, (30, 2))
    local_map.add_keyframe(0, np.eye(4), np.arange(30), pixels)
    local_map.recalibrate(second)
    np.testing.assert_array_equal(local_map.keyframes[0].pixels, pixels)
    back = TRUE.project(np.concatenate([local_map.keyframes[0].xy, np.ones((30, 1))], axis=1))
    assert np.abs(back - pixels).max() < 0.05


def test_job_and_log_stay_in_the_run_folder(tmp_path):
    refine_lens(filmed(*wandering()), GUESS, 0, tmp_path, SilentProgress())
    assert {p.name for p in tmp_path.iterdir()} == {"lens", "lens.log", "lens.job.json"}
    assert set(json.loads((tmp_path / "lens" / "lens.json").read_text())) == {"params", "sigma"}


@pytest.mark.parametrize(
    ("focals", "asked", "last"),
    [
        ((157.0, 159.5, 159.6), 3, 159.5),
        ((134.05,), 1, 134.0),
        ((150.0, 155.0, 158.0, 160.0), 3, 158.0),
        ((None,), 1, 134),
    ],
)
def test_a_lens_that_moved_far_is_asked_again_of_the_map_adjusted_with_it(monkeypatch, focals, asked, last):
    """Lenses come in this order; None is one that the motion does not determine."""
    whole, seen, maps = filmed(*wandering()), [], [SimpleNamespace(tracked_frames=[], keyframes=[])]
    given = iter(focals)

    def refine(submap, camera, *rest):
        seen.append((submap.camera_params[0], camera.params[0]))
        focal = next(given)
        if focal is None:
            return Lens(camera, (9.0,), False)
        return Lens(replace(camera, params=(focal, *camera.params[1:])), (0.1 * len(seen),), True)

    monkeypatch.setattr(self_calibration, "refine_lens", refine)
    monkeypatch.setattr(self_calibration, "adjust_maps", lambda maps, *_: [GUESS.params[0]] * len(maps))
    monkeypatch.setattr(
        self_calibration, "_with_lens", lambda maps, numbers, camera, *_: dict.fromkeys(numbers, camera.params[0])
    )
    monkeypatch.setattr(
        self_calibration, "submaps_of", lambda maps, params, kind=None: [replace(whole, camera_params=params)]
    )
    workspace = SimpleNamespace(log=None)
    camera, sigma, held = self_calibration.refine_intrinsics(maps, GUESS, 0, None, workspace, SilentProgress())
    assert len(seen) == asked
    assert all(of_map == of_camera for of_map, of_camera in seen)
    assert camera.params[0] == last == held[0]
    # A later round that determines nothing leaves the lens that was found, and its sigma.
    assert sigma[0] == pytest.approx(9.0 if focals[0] is None else 0.1 * (asked - (focals[-1] is None)))


def test_maps_that_are_not_asked_for_the_lens_are_adjusted_once_and_with_it(monkeypatch):
    """Four maps: the largest, number 2, does not determine the lens, the next, number 0, does, in two rounds."""
    maps = [SimpleNamespace(tracked_frames=[None] * count, keyframes=[]) for count in (30, 10, 40, 20)]
    focals, adjusted = iter([None, 150.0, 150.01]), []

    def lens_of(local_map, camera, *_):
        focal = next(focals)
        if focal is None:
            return Lens(camera, (9.0,), False)
        return Lens(replace(camera, params=(focal, *camera.params[1:])), (0.1,), True)

    def adjust(some, *_):
        adjusted.append(("guess", [maps.index(one) for one in some]))
        return [None] * len(some)

    def with_lens(maps, numbers, camera, far, *_):
        adjusted.append((camera.params[0], numbers, far))
        return dict.fromkeys(numbers, camera.params[0])

    monkeypatch.setattr(self_calibration, "_lens_of", lens_of)
    monkeypatch.setattr(self_calibration, "adjust_maps", adjust)
    monkeypatch.setattr(self_calibration, "_with_lens", with_lens)
    found = self_calibration.refine_intrinsics(maps, GUESS, 0, None, SimpleNamespace(log=None), SilentProgress())
    assert adjusted == [("guess", [2]), ("guess", [0]), (150.0, [0], True), (150.0, [1, 2, 3], True)]
    assert (found[0].params[0], found[1], found[2]) == (150.0, (0.1,), [150.0] * 4)


@pytest.mark.parametrize(
    ("doubts", "asked", "focal"),
    [((0.1, 0.1), 3, 141.0), ((0.4, 0.1), 3, 141.0), ((0.1, 0.3), 3, 160.0), ((0.6, 0.1), 1, 160.0)],
)
def test_the_mean_colonoscope_stays_where_the_map_that_determines_another_is_in_doubt(
    monkeypatch, doubts, asked, focal
):
    mean, by_guess = colonoscope_across(305, 228, (0, 0, 305, 228)), SimpleNamespace(by="the guess")
    mean = replace(mean, params=(160.0, *mean.params[1:]))
    adjusted = SimpleNamespace(tracked_frames=[1], keyframes=[], copied=lambda: by_guess)
    maps = [adjusted]
    focals, doubts, seen = iter([150.0, 141.0, 141.0]), iter(doubts), []

    def lens_of(local_map, camera, *_):
        seen.append(camera.params[0])
        return Lens(replace(camera, params=(next(focals), *camera.params[1:])), (0.1,), True)

    def with_lens(maps, numbers, camera, *_):
        return dict.fromkeys(numbers, camera.params[0])

    monkeypatch.setattr(self_calibration, "_lens_of", lens_of)
    monkeypatch.setattr(self_calibration, "_doubt_of", lambda *_: next(doubts))
    monkeypatch.setattr(self_calibration, "_with_lens", with_lens)
    monkeypatch.setattr(self_calibration, "adjust_maps", lambda some, *_: [160.0] * len(some))
    camera, sigma, held = self_calibration.refine_intrinsics(
        maps, mean, 0, None, SimpleNamespace(log=None), SilentProgress()
    )
    assert len(seen) == asked
    assert camera.params[0] == held[0] == focal
    assert maps == [by_guess if focal == mean.params[0] else adjusted]
    assert np.isnan(sigma[0]) == (focal == mean.params[0])


@pytest.mark.parametrize(
    "camera",
    [
        GUESS,
        Camera("SIMPLE_RADIAL", 320, 320, (150.0, 160.0, 160.0, -0.3)),
        Camera("OPENCV_FISHEYE", 320, 320, (100.0, 100.0, 160.0, 160.0, 0.0, 0.0, 0.0, 0.0)),
    ],
)
def test_a_lens_shifts_nothing_against_itself_and_pixels_by_its_focal_length_against_another(camera):
    assert self_calibration.lens_shift(camera, camera) < 2e-4
    longer = replace(camera, params=(1.01 * camera.params[0], *camera.params[1:]))
    # A pixel at radius r moves by r / 100, or by less where the lens compresses; the whole picture's RMS radius is 0.41
    # widths, and that of what has a ray is less.
    assert 0.0015 < self_calibration.lens_shift(camera, longer) < 0.0042


def test_a_lens_of_another_endoscope_is_doubted(tmp_path):
    other = Camera("SIMPLE_RADIAL", 320, 320, (140.0, 160.0, 160.0, 0.0))
    said = doubt_of_lens(replace(filmed(*wandering()), camera_params=other.params), other, 0, tmp_path)
    assert "focal length is 140 px" in said
    assert "motion says 16" in said


@pytest.mark.parametrize(
    ("focal", "sigma", "determined"), [(160.5, 0.3, True), (170.0, 4.0, True), (190.0, 0.3, False)]
)
def test_a_lens_is_not_doubted_for_little(monkeypatch, tmp_path, focal, sigma, determined):
    found = Lens(replace(TRUE, params=(focal, *TRUE.params[1:])), (sigma,), determined)
    monkeypatch.setattr(self_calibration, "refine_lens", lambda *_: found)
    assert doubt_of_lens(filmed(*wandering()), TRUE, 0, tmp_path) == ""
