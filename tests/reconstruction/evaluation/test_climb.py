"""CLiMB's figures against evo's, computed submap by submap."""

from __future__ import annotations

import numpy as np
import pytest
from evo.core import metrics
from evo.core.trajectory import PoseTrajectory3D
from scipy.spatial.transform import Rotation

from haustra.core.errors import ReconstructionError
from reconstruction.evaluation.climb import FAILED_SCORE, INTERVALS, climb_errors

FPS = 50.0


def walk(count: int, seed: int) -> np.ndarray:
    """Smooth poses (N,4,4), mm."""
    rng = np.random.default_rng(seed)
    poses = np.tile(np.eye(4), (count, 1, 1))
    poses[:, :3, 3] = np.cumsum(rng.normal([0, 0, 0.5], 0.4, (count, 3)), axis=0)
    poses[:, :3, :3] = Rotation.from_rotvec(np.cumsum(rng.normal(0, 0.01, (count, 3)), axis=0)).as_matrix()
    return poses


def disturbed(poses: np.ndarray, seed: int, noise_mm: float = 0.8) -> np.ndarray:
    """In another frame and unit, with noise."""
    rng = np.random.default_rng(seed)
    other = np.eye(4)
    other[:3, :3] = Rotation.random(random_state=seed).as_matrix()
    other[:3, 3] = rng.normal(0, 30, 3)
    noisy = poses.copy()
    noisy[:, :3, 3] += rng.normal(0, noise_mm, (len(poses), 3))
    noisy[:, :3, :3] = noisy[:, :3, :3] @ Rotation.from_rotvec(rng.normal(0, 0.02, (len(poses), 3))).as_matrix()
    moved = other @ noisy
    moved[:, :3, 3] *= 0.13
    return moved


def evo_figures(poses: np.ndarray, truth: np.ndarray) -> tuple[np.ndarray, dict[int, tuple[float, float, int]]]:
    """Distances after evo's Sim(3), and mean relative errors by interval, from evo alone."""
    stamps = np.arange(len(poses), dtype=float)
    estimated, true = (PoseTrajectory3D(poses_se3=list(p), timestamps=stamps) for p in (poses, truth))
    estimated.align(true, correct_scale=True)
    absolute = metrics.APE(metrics.PoseRelation.translation_part)
    absolute.process_data((true, estimated))
    relative = {}
    for interval in INTERVALS:
        kinds = (metrics.PoseRelation.translation_part, metrics.PoseRelation.rotation_angle_deg)
        found = []
        for kind in kinds:
            error = metrics.RPE(kind, delta=interval, delta_unit=metrics.Unit.frames, all_pairs=True)
            error.process_data((true, estimated))
            found.append(error.error)
        relative[interval] = (float(found[0].mean()), float(found[1].mean()), len(found[0]))
    return absolute.error, relative


def test_two_submaps_agree_with_evo_on_each() -> None:
    truth = walk(420, 0)
    parts = [(np.arange(0, 150), 1), (np.arange(160, 400), 2)]
    submaps = [(frames + 1, disturbed(truth[frames], seed)) for frames, seed in parts]
    found = climb_errors(submaps, (np.arange(420) + 1, truth), FPS, seconds_per_frame=0.03)
    expected = [evo_figures(poses, truth[frames - 1]) for frames, poses in submaps]
    weights = np.array([150, 240]) / 390
    assert found.ate_mean_mm == pytest.approx(weights @ [d.mean() for d, _ in expected], rel=1e-9)
    assert found.measured_ate_median_mm == pytest.approx(weights @ [np.median(d) for d, _ in expected], rel=1e-9)
    for relative in found.relative:
        ours = (relative.translation_mm, relative.rotation_deg)
        for which in (0, 1):
            assert ours[which] == pytest.approx(weights @ [by[relative.frames][which] for _, by in expected], rel=1e-6)
        assert relative.count == sum(by[relative.frames][2] for _, by in expected)
    assert (found.matched, found.reference, found.submaps) == (390, 420, 2)
    tracked = 390 / 420
    assert found.time_factor == pytest.approx(1.25)  # 0.03 s a frame at 50 frames a second: half a frame too slow
    assert found.score == pytest.approx(found.ate_mean_mm * (1 + 0.5 * (1 - tracked)) * 1.25)


def test_pairs_across_a_gap_are_none() -> None:
    truth = walk(300, 3)
    frames = np.r_[0:120, 125:260]
    found = climb_errors([(frames, disturbed(truth[frames], 4))], (np.arange(300), truth), FPS)
    assert found.relative[0].count == 119 + 134
    assert found.relative[1].count == sum(frame + 10 in set(frames) for frame in frames)
    assert found.score is None


def test_a_frame_belongs_to_the_first_submap_and_short_submaps_do_not_count() -> None:
    truth = walk(300, 5)
    whole, again, short = np.arange(0, 200), np.arange(150, 300), np.arange(100, 180)
    submaps = [(frames, disturbed(truth[frames], k)) for k, frames in enumerate((short, whole, again))]
    found = climb_errors(submaps, (np.arange(300), truth), FPS)
    assert (found.submaps, found.submaps_left_out, found.matched) == (2, 1, 300)
    assert found.tracked_fraction == 1.0


def test_a_submap_that_does_not_move_is_left_out_and_does_not_end_the_clip() -> None:
    truth = walk(300, 5)
    still = np.tile(np.eye(4), (120, 1, 1))
    submaps = [(np.arange(0, 120), still), (np.arange(120, 300), disturbed(truth[120:], 1))]
    found = climb_errors(submaps, (np.arange(300), truth), FPS)
    assert (found.submaps, found.submaps_left_out, found.matched) == (1, 1, 180)


def test_a_clip_tracked_for_half_of_its_frames_has_failed() -> None:
    truth = walk(300, 6)
    exact = [(np.arange(150), truth[:150])]
    assert climb_errors(exact, (np.arange(300), truth), FPS, 0.0).score == FAILED_SCORE
    assert climb_errors([(np.arange(151), truth[:151])], (np.arange(300), truth), FPS, 0.0).score == pytest.approx(0)
    assert climb_errors([], (np.arange(300), truth), FPS, 0.0).score == FAILED_SCORE


def test_a_failed_clip_counts_as_the_protocol_has_it_and_keeps_what_was_measured_apart() -> None:
    """25 mm, no frame tracked, half again for the coverage and half again for the time: 25 x 1.5 x 1.5."""
    truth = walk(300, 6)
    poses = disturbed(truth[:150], 2)
    expected, _ = evo_figures(poses, truth[:150])
    for seconds, factor in ((0.03, 1.25), (None, None)):
        found = climb_errors([(np.arange(150), poses)], (np.arange(300), truth), FPS, seconds)
        told = found.to_dict()
        counted = [told[name] for name in ("failed", "ate_mean_mm", "tracked_fraction", "time_factor", "score")]
        assert counted == [True, 25.0, 0.0, 1.5, 56.25]
        assert told["measured_ate_mean_mm"] == pytest.approx(expected.mean(), rel=1e-9)
        assert told["measured_ate_median_mm"] == pytest.approx(np.median(expected), rel=1e-9)
        assert (told["measured_tracked_fraction"], told["measured_time_factor"]) == (0.5, factor)
        assert "150 of 300 frames = 50.0 % tracked" in str(found)
        assert "FAILED: no more than half of the frames are tracked" in str(found)
    good = climb_errors([(np.arange(151), truth[:151])], (np.arange(300), truth), FPS)
    assert (good.failed, good.score, good.tracked_fraction) == (False, None, 151 / 300)


def test_interpolated_poses_are_judged_as_the_others_and_counted() -> None:
    truth = walk(300, 8)
    made = np.arange(200) % 2 == 1
    found = climb_errors([(np.arange(200), truth[:200])], (np.arange(20, 300), truth[20:]), FPS, interpolated=[made])
    assert (found.matched, found.interpolated) == (180, 90)
    assert "180 of 280 frames = 64.3 % tracked, 90 of them interpolated" in str(found)


def test_a_clip_of_which_nothing_counts_says_why_and_prints_no_number_that_is_none() -> None:
    truth = walk(300, 7)
    short = climb_errors([(np.arange(53), truth[:53])], (np.arange(300), truth), FPS, 0.0)
    said = str(short)
    assert "1 submap" in said
    assert "--min-common" in said
    assert "FAILED: ATE 25 mm, score 56.25 (lower is better)" in said
    for found in (
        short,
        climb_errors([(np.arange(0, 300, 20), truth[::20])], (np.arange(300), truth), FPS, min_common=3),
    ):
        assert "nan" not in str(found)
    assert "there is no submap with poses" in str(climb_errors([], (np.arange(300), truth), FPS, 0.0))


def test_a_reference_with_a_frame_twice_is_refused() -> None:
    with pytest.raises(ReconstructionError, match="each once"):
        climb_errors([], (np.zeros(5, np.int64), walk(5, 0)), FPS)
