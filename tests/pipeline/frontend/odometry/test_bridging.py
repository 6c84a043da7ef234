"""Registration over a blind stretch in a tube whose wall is a formula: with folds, smooth, and of another tube."""

from functools import cache

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from haustra.core.se3 import angle_between, in_camera, inverse
from pipeline.frontend.odometry.bridging.cloud_registration import WallPatches
from pipeline.frontend.odometry.bridging.gap import registered_over_gap, velocity_over_gap

END, BEGIN, COUNT = 50, 81, 130
APART_MM, ACROSS_MM = 14.0, 22.0  # of the folds, and the tube's radius


def world_from_camera(k: float) -> np.ndarray:
    """Backwards through the tube, the look wandering."""
    found = np.eye(4)
    found[:3, :3] = Rotation.from_rotvec(
        [0.1 * np.sin(k / 17), 0.12 * np.cos(k / 23), 0.1 * np.sin(k / 30)]
    ).as_matrix()
    found[:3, 3] = 3 * np.sin(k / 20), 2 * np.cos(k / 25), 200 - 0.45 * k
    return found


def radius(points: np.ndarray, folds: float, seed: int) -> np.ndarray:
    angle, along = np.arctan2(points[:, 1], points[:, 0]), points[:, 2]
    ring = np.cos(2 * np.pi * along / APART_MM + 1.1 * seed + 0.8 * np.sin(angle)) * (
        0.6 + 0.4 * np.cos(3 * angle + seed)
    )
    return ACROSS_MM + folds * ring


def cloud(frame: int, folds: float = 3.0, seed: int = 0, noise: float = 0.02) -> np.ndarray:
    """Points (N,3) in the camera's axes by marching along 1000 rays to the first one outside."""
    rng = np.random.default_rng([seed, frame])
    rays = np.column_stack([rng.uniform(-1, 1, (1000, 2)), np.ones(1000)])
    depth, hit = np.full(1000, 4.0), np.zeros(1000, bool)
    for _ in range(140):
        points = in_camera(world_from_camera(frame), rays * depth[:, None])
        hit |= np.hypot(points[:, 0], points[:, 1]) >= radius(points, folds, seed)
        depth[~hit] += 0.4
    return (rays * (depth * (1 + noise * rng.normal(size=1000)))[:, None])[hit & (depth < 60)]


folded = cache(cloud)
HERE = {k: world_from_camera(k) for k in range(END + 1)}
THERE = {k: world_from_camera(k) for k in range(BEGIN, COUNT)}


def off(found: np.ndarray) -> tuple[float, float]:
    error = inverse(world_from_camera(BEGIN)) @ found
    return float(np.linalg.norm(error[:3, 3])), float(np.degrees(angle_between(error, np.eye(4))))


def test_the_pose_after_the_gap_is_found():
    found = registered_over_gap(HERE, THERE, folded)
    assert found is not None
    shift, turn = off(found)
    assert shift < 1.0
    assert turn < 2.0
    assert shift < off(velocity_over_gap(HERE, THERE))[0]


def test_clouds_of_another_tube_are_refused():
    assert registered_over_gap(HERE, THERE, lambda k: folded(k) if k <= END else cloud(k, seed=3, folds=5.0)) is None


def test_a_gap_that_is_too_long_and_a_blind_sensor_are_refused():
    assert registered_over_gap(HERE, {k + 100: p for k, p in THERE.items()}, folded) is None
    assert registered_over_gap(HERE, THERE, lambda _: None) is None


@pytest.mark.parametrize("way", [(0, 0, 1.5, 0, 0, 0), (0, 0, 0, 0, 0, 0.06)])
def test_what_a_smooth_tube_leaves_free_stays_with_the_guess(way):
    """Along a smooth tube and about its axis nothing speaks for a step; across it the wall does."""
    wall = WallPatches.of(
        np.concatenate([in_camera(world_from_camera(k), cloud(k, 0.0, noise=0.005)) for k in range(0, 40, 4)])
    )
    step = np.eye(4)
    step[:3, :3], step[:3, 3] = Rotation.from_rotvec(way[3:]).as_matrix(), way[:3]
    across = np.eye(4)
    across[0, 3] = 1.2
    guess = across @ step @ world_from_camera(40)
    found = wall.registered(cloud(40, 0.0, noise=0.005), guess)
    assert abs(found[0, 3] - world_from_camera(40)[0, 3]) < 0.3  # brought back
    change = found @ inverse(guess)
    assert abs(change[2, 3]) < 0.5
    assert abs(Rotation.from_matrix(change[:3, :3]).as_rotvec()[2]) < 0.03
