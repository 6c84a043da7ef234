"""Camera paths against evo, SciPy's rotations, and motions whose error is known by construction."""

import copy
from itertools import pairwise

import numpy as np
import pytest
from evo.core import metrics
from evo.core.trajectory import PoseTrajectory3D
from evo.tools import file_interface
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from haustra.core.errors import ReconstructionError
from haustra.core.sim3 import umeyama, umeyama_batch
from reconstruction.evaluation.trajectory_io import read_tum, write_tum
from reconstruction.evaluation.trajectory_metrics import align_poses, associate, simcol3d_errors, trajectory_errors

SEEDS = st.integers(0, 2**31)


def random_path(seed=0, count=40):
    """Poses (N,4,4) of a bent path of about 80 mm."""
    rng = np.random.default_rng(seed)
    world_from_camera = np.tile(np.eye(4), (count, 1, 1))
    turns = np.cumsum(rng.normal(0, 0.1, (count, 3)), axis=0)
    world_from_camera[:, :3, :3] = Rotation.from_rotvec(turns).as_matrix()
    world_from_camera[:, :3, 3] = np.cumsum(world_from_camera[:, :3, 2] * 2 + rng.normal(0, 0.3, (count, 3)), axis=0)
    return world_from_camera


def random_sim3(seed):
    rng = np.random.default_rng(seed)
    sim3 = np.eye(4)
    sim3[:3, :3] = rng.uniform(0.1, 10) * Rotation.random(rng=rng).as_matrix()
    sim3[:3, 3] = rng.normal(0, 100, 3)
    return sim3


def moved(world_from_camera, sim3):
    """Poses after a Sim(3) of the world; rotations stay rotations."""
    result = sim3 @ world_from_camera
    result[:, :3, :3] /= np.cbrt(np.linalg.det(sim3[:3, :3]))
    return result


def noisy(world_from_camera, seed=1, length=0.5, angle=0.02):
    rng = np.random.default_rng(seed)
    result = world_from_camera.copy()
    result[:, :3, 3] += rng.normal(0, length, (len(world_from_camera), 3))
    result[:, :3, :3] = (
        result[:, :3, :3] @ Rotation.from_rotvec(rng.normal(0, angle, (len(world_from_camera), 3))).as_matrix()
    )
    return result


def evo_trajectory(world_from_camera):
    return PoseTrajectory3D(
        poses_se3=list(world_from_camera), timestamps=np.arange(len(world_from_camera), dtype=float)
    )


@given(SEEDS)
@settings(max_examples=50, deadline=None)
def test_umeyama_recovers_any_sim3(seed):
    points = np.random.default_rng(seed).normal(0, 10, (12, 3))
    sim3 = random_sim3(seed)
    found = umeyama(points, points @ sim3[:3, :3].T + sim3[:3, 3], with_scale=True)
    np.testing.assert_allclose(found, sim3, atol=1e-9 * np.abs(sim3).max())


@given(SEEDS)
@settings(max_examples=30, deadline=None)
def test_umeyama_of_a_mirrored_cloud_is_still_a_rotation(seed):
    points = np.random.default_rng(seed).normal(0, 10, (12, 3))
    rotation = umeyama(points, points * [1, 1, -1], with_scale=False)[:3, :3]
    np.testing.assert_allclose(rotation @ rotation.T, np.eye(3), atol=1e-9)
    assert np.linalg.det(rotation) > 0


def test_umeyama_of_a_mirrored_cloud_equals_scipys_kabsch():
    points = np.random.default_rng(4).normal(0, 10, (12, 3))
    target = points * [1, 1, -1]
    best, _ = Rotation.align_vectors(target - target.mean(0), points - points.mean(0))
    np.testing.assert_allclose(umeyama(points, target, False)[:3, :3], best.as_matrix(), atol=1e-9)


def test_umeyama_rejects_what_has_no_answer():
    with pytest.raises(ReconstructionError, match="two or more"):
        umeyama(np.zeros((1, 3)), np.zeros((1, 3)), False)
    with pytest.raises(ReconstructionError, match="does not move"):
        umeyama(np.ones((5, 3)), np.random.default_rng(0).normal(size=(5, 3)), True)


def test_many_alignments_are_those_of_each_alone_and_nan_where_there_is_none():
    rng = np.random.default_rng(8)
    source, target = rng.normal(size=(2, 6, 3, 3))
    source[4] = source[4, :1]  # one place
    found = umeyama_batch(source, target, True)
    assert np.isnan(found[4]).any()
    for k in (0, 1, 2, 3, 5):
        np.testing.assert_allclose(found[k], umeyama(source[k], target[k], True), atol=1e-12)


@pytest.mark.parametrize("alignment", ["sim3", "se3", "none"])
def test_errors_equal_evo(alignment):
    truth = random_path()
    estimated = noisy(truth) if alignment == "none" else moved(noisy(truth), random_sim3(5))
    if alignment == "se3":
        estimated[:, :3, 3] /= np.cbrt(np.linalg.det(random_sim3(5)[:3, :3]))
    ours = trajectory_errors(estimated, truth, alignment)
    reference, theirs = evo_trajectory(truth), copy.deepcopy(evo_trajectory(estimated))
    if alignment != "none":
        theirs.align(reference, correct_scale=alignment == "sim3")
    for relation, names in (
        (metrics.PoseRelation.translation_part, {"rmse": "ate_rmse", "mean": "ate_mean", "median": "ate_median"}),
        (metrics.PoseRelation.rotation_angle_deg, {"median": "rotation_median_deg", "max": "rotation_max_deg"}),
    ):
        ape = metrics.APE(relation)
        ape.process_data((reference, theirs))
        for statistic, name in names.items():
            expected = ape.get_statistic(metrics.StatisticsType[statistic])
            assert getattr(ours, name) == pytest.approx(expected, rel=1e-6), name
    assert (ours.alignment, ours.count, ours.unit) == (alignment, len(truth), "mm")


@given(SEEDS)
@settings(max_examples=30, deadline=None)
def test_a_straight_path_has_no_error_after_alignment(seed):
    """Centres on a line leave the roll free; the orientations must settle it."""
    truth = random_path(seed)
    truth[:, :3, 3] = np.outer(np.arange(len(truth)), [1.0, -2.0, 0.5])
    errors = trajectory_errors(moved(truth, random_sim3(seed)), truth, "sim3")
    assert errors.ate_rmse < 1e-9 * np.ptp(truth[:, :3, 3])
    assert errors.rotation_max_deg < 1e-5


def test_simcol3d_does_not_forgive_a_turned_start():
    """The protocol chains motions from the true first pose: a Sim(3) of the whole path changes nothing."""
    truth = random_path()
    errors = simcol3d_errors(moved(truth, random_sim3(8)), truth)
    assert errors.ate_median < 1e-9
    assert errors.rte_median < 1e-9
    assert errors.scale == pytest.approx(1 / np.cbrt(np.linalg.det(random_sim3(8)[:3, :3])))


def test_simcol3d_medians_equal_the_error_put_in():
    """Every motion of the estimate turns 3 degrees too far about the camera's own z."""
    truth = random_path()
    extra = np.eye(4)
    extra[:3, :3] = Rotation.from_euler("z", 3, degrees=True).as_matrix()
    estimated = [truth[0]]
    for before, after in pairwise(truth):
        estimated.append(estimated[-1] @ np.linalg.inv(before) @ after @ extra)
    errors = simcol3d_errors(np.stack(estimated), truth)
    assert errors.rot_median_deg == pytest.approx(3)
    assert errors.rte_median < 1e-9
    assert errors.count == len(truth) - 1
    drift = np.linalg.norm(np.stack(estimated)[:, :3, 3] - truth[:, :3, 3], axis=1)
    assert errors.ate_median == pytest.approx(np.median(drift))


def test_written_paths_are_read_back_and_by_evo(tmp_path):
    seconds, world_from_camera = np.arange(40) / 30, random_path(3)
    write_tum(tmp_path / "path.tum", seconds, world_from_camera)
    read_seconds, read_poses = read_tum(tmp_path / "path.tum")
    np.testing.assert_allclose(read_seconds, seconds, atol=1e-6)
    np.testing.assert_allclose(read_poses, world_from_camera, atol=1e-8)
    by_evo = file_interface.read_tum_trajectory_file(str(tmp_path / "path.tum"))
    np.testing.assert_allclose(np.stack(by_evo.poses_se3), world_from_camera, atol=1e-8)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "no poses"),
        ("# only a comment\n", "no poses"),
        ("0 1 2 3 0 0 0 1\n0.1 1 2 3 0 0 0\n", "line 2: a pose is eight"),
        ("0 1 2 nan 0 0 0 1\n", "line 1: a pose is eight finite"),
        ("0,5 1 2 3 0 0 0 1\n", "line 1: a pose is eight finite numbers"),
        ("\n0 1 2 3 0 0 0 2\n", "line 2: the quaternion's length is 2"),
        ("0 1 2 3 0 0 0 1\n0 1 2 3 0 0 0 1\n", "line 2: time must increase"),
    ],
)
def test_bad_paths_are_refused_with_the_line(tmp_path, text, message):
    path = tmp_path / "path.txt"
    path.write_text(text)
    with pytest.raises(ReconstructionError, match=message):
        read_tum(path)


@pytest.mark.parametrize("between", [",", ", ", ";", "\t", "  "])
def test_numbers_may_be_parted_as_spreadsheets_do(tmp_path, between):
    path = tmp_path / "path.txt"
    path.write_text(between.join(["0.5", *"1230001"]) + "\n")
    assert read_tum(path)[1][0, :3, 3].tolist() == [1, 2, 3]


def test_association_is_one_to_one_and_within_reach():
    first, second = associate(np.array([0.0, 1.0, 2.0, 3.0]), np.array([0.004, 1.2, 2.001, 2.002]), 0.01)
    assert first.tolist() == [0, 2]
    assert second.tolist() == [0, 2]
    with pytest.raises(ReconstructionError, match="within"):
        associate(np.array([0.0]), np.array([5.0]))


@given(SEEDS)
@settings(max_examples=30, deadline=None)
def test_association_equals_brute_force(seed):
    rng = np.random.default_rng(seed)
    first, second = np.sort(rng.uniform(0, 1, 30)), np.sort(rng.uniform(0, 1, 20))
    gap = np.abs(first[:, None] - second)
    pairs = {(i, j) for i, j in np.argwhere(gap < 0.05) if gap[i].argmin() == j and gap[:, j].argmin() == i}
    assert set(zip(*associate(first, second, 0.05), strict=True)) == pairs


def test_pairs_and_shapes_are_checked():
    path = random_path()
    with pytest.raises(ReconstructionError, match="pairs of poses"):
        trajectory_errors(path[:-1], path)
    with pytest.raises(ReconstructionError, match=r"\(N,4,4\)"):
        trajectory_errors(path[:, :3], path[:, :3])
    with pytest.raises(ReconstructionError, match="alignment is one of"):
        trajectory_errors(path, path, "sim(3)")


def test_a_surface_off_a_straight_path_is_aligned_by_the_orientations():
    """Centres alone leave the roll open: a wall 20 mm off the path would land anywhere on a circle."""
    rng = np.random.default_rng(0)
    truth = np.tile(np.eye(4), (40, 1, 1))
    truth[:, :3, :3] = Rotation.from_euler("xyz", rng.normal(0, 5, (40, 3)), degrees=True).as_matrix()
    truth[:, 2, 3] = np.linspace(0, 60, 40)
    estimate = np.linalg.inv(truth[0]) @ truth
    estimate[:, :3, 3] = (estimate[:, :3, 3] + rng.normal(0, 0.05, (40, 3))) / 7
    wall = truth[10] @ np.array([20.0, 0, 15, 1])
    in_estimate = (np.linalg.inv(truth[0]) @ wall)[:3] / 7
    found = align_poses(estimate, truth) @ np.append(in_estimate, 1)
    assert np.linalg.norm(found - wall) < 0.1
