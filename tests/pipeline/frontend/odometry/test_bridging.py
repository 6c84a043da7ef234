"""Registration over a blind stretch in a tube whose wall is a formula: with folds, smooth, and of another tube."""

from functools import cache

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from haustra.core.se3 import angle_between, in_camera, inverse
from pipeline.frontend.odometry.bridging.cloud_registration import WallPatches
from pipeline.frontend.odometry.bridging.gap import _best_of_turns, registered_over_gap, velocity_over_gap

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


def off(found: np.ndarray, frame: int = BEGIN) -> tuple[float, float]:
    error = inverse(world_from_camera(frame)) @ found
    return float(np.linalg.norm(error[:3, 3])), float(np.degrees(angle_between(error, np.eye(4))))


@pytest.mark.parametrize("seed", range(4))
def test_the_pose_after_the_gap_is_found(seed):
    found = registered_over_gap(HERE, THERE, lambda k: folded(k, seed=seed))
    assert found is not None
    shift, turn = off(found)
    assert shift < 0.7
    assert turn < 1.5
    assert shift < off(velocity_over_gap(HERE, THERE))[0]


@pytest.mark.parametrize(("seed", "folds"), [(3, 5.0), (2, 3.0), (8, 3.0), (9, 3.0), (10, 3.0)])
def test_clouds_of_another_tube_are_refused(seed, folds):
    def clouds(k):
        return folded(k) if k <= END else cloud(k, seed=seed, folds=folds)

    assert registered_over_gap(HERE, THERE, clouds) is None


def wall_and_cloud() -> tuple[WallPatches, np.ndarray]:
    """Of frames 0 to 40, and of frames between them in the axes of the 22nd."""
    wall = np.concatenate([in_camera(world_from_camera(k), folded(k)) for k in range(0, 41, 4)])
    into = inverse(world_from_camera(22))
    seen = [in_camera(into @ world_from_camera(k), folded(k)) for k in range(18, 27, 2) if k % 4]
    return WallPatches.of(wall), np.concatenate(seen)


@pytest.mark.parametrize("degrees", [28.0, -28.0])
def test_a_guess_that_is_best_of_turns_about_the_axis_is_brought_back(degrees):
    """This tube hardly holds the turn, and one registration leaves it; of turns 8 degrees apart the best is taken."""
    wall, seen = wall_and_cloud()
    guess = world_from_camera(22)
    guess[:3, :3] = guess[:3, :3] @ Rotation.from_euler("z", degrees, degrees=True).as_matrix()
    assert off(wall.registered(seen, guess), 22)[1] > 20
    found = _best_of_turns(wall, seen, guess)
    assert off(found, 22)[1] < 4.1
    assert wall.misfit(seen, found) < wall.misfit(seen, wall.registered(seen, guess))


def test_points_beyond_the_edge_of_the_wall_have_no_plane():
    """A flat sheet and a cloud that reaches 3 mm beyond it: 10 of 13 parts of the cloud lie on the sheet, and it is not
    drawn over the edge."""
    x, y = np.meshgrid(np.arange(0, 10, 0.5), np.arange(0, 10, 0.5))
    sheet = WallPatches.of(np.column_stack([x.ravel(), y.ravel(), np.full(x.size, 30.0)]))
    x, y = np.meshgrid(np.arange(0, 13, 0.25), np.arange(0, 10, 0.25))
    off_mm, share = sheet.fit(np.column_stack([x.ravel(), y.ravel(), np.full(x.size, 30.0)]), np.eye(4))
    assert off_mm < 1e-9
    assert 10 / 13 - 0.02 < share < 10.7 / 13


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
