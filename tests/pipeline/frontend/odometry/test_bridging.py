"""Depth carries the camera over a blind stretch in a tube whose wall is a formula: with folds, smooth, another one."""

from functools import cache

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from haustra.core.se3 import angle_between, in_camera, inverse
from pipeline.frontend.odometry.bridging.cloud_registration import WallPatches
from pipeline.frontend.odometry.bridging.depth_odometry import by_velocity
from pipeline.frontend.odometry.bridging.gap import Registered, _agreed, registered_over_gap

END, BEGIN, COUNT = 50, 81, 130
BACK, AHEAD = (200.0, -0.45), (100.0, 0.45)  # start, mm, and speed, mm a frame
APART_MM, FOLDS_MM, ACROSS_MM = 14.0, 5.0, 22.0  # from fold to fold, their height, and the tube's radius


def world_from_camera(k: float, start: float = BACK[0], speed: float = BACK[1]) -> np.ndarray:
    """Through the tube, backwards at a negative speed (mm a frame), the look wandering."""
    found = np.eye(4)
    found[:3, :3] = Rotation.from_rotvec(
        [0.1 * np.sin(k / 17), 0.12 * np.cos(k / 23), 0.1 * np.sin(k / 30)]
    ).as_matrix()
    found[:3, 3] = 3 * np.sin(k / 20), 2 * np.cos(k / 25), start + speed * k
    return found


def radius(points: np.ndarray, folds: float, seed: int) -> np.ndarray:
    angle, along = np.arctan2(points[:, 1], points[:, 0]), points[:, 2]
    ring = np.cos(2 * np.pi * along / APART_MM + 1.1 * seed + 0.8 * np.sin(angle)) * (
        0.6 + 0.4 * np.cos(3 * angle + seed)
    )
    return ACROSS_MM + folds * ring


def cloud(
    frame: int, folds: float = FOLDS_MM, seed: int = 0, noise: float = 0.01, path: tuple[float, float] = BACK
) -> np.ndarray:
    """Points (N,3) in the camera's axes by marching along 1000 rays to the first one outside; noise: of depth, as
    blocks of four cells of 2 % have it."""
    rng = np.random.default_rng([seed, frame])
    rays = np.column_stack([rng.uniform(-1, 1, (1000, 2)), np.ones(1000)])
    pose = world_from_camera(frame, *path)
    depth, inside = np.full(1000, 4.0), np.arange(1000)
    for _ in range(140):
        points = in_camera(pose, rays[inside] * depth[inside, None])
        inside = inside[np.hypot(points[:, 0], points[:, 1]) < radius(points, folds, seed)]
        depth[inside] += 0.4
    depth[inside] = np.inf
    return (rays * (depth * (1 + noise * rng.normal(size=1000)))[:, None])[depth < 60]


folded = cache(cloud)
HERE = {k: world_from_camera(k) for k in range(END + 1)}
THERE = {k: world_from_camera(k) for k in range(BEGIN, COUNT)}


def off(found: np.ndarray, true: np.ndarray) -> tuple[float, float]:
    """Shift, mm, and turn, degrees."""
    error = inverse(true) @ found
    return float(np.linalg.norm(error[:3, 3])), float(np.degrees(angle_between(error, np.eye(4))))


@pytest.mark.parametrize("path", [BACK, pytest.param(AHEAD, marks=pytest.mark.slow)], ids=["backwards", "ahead"])
@pytest.mark.parametrize("seed", [0, pytest.param(1, marks=pytest.mark.slow)])
def test_the_pose_after_the_gap_is_found(seed, path):
    poses = {k: world_from_camera(k, *path) for k in range(COUNT)}
    here, there = ({k: poses[k] for k in frames} for frames in (HERE, THERE))
    found = registered_over_gap(here, there, lambda k: folded(k, seed=seed, path=path))
    assert found is not None
    shift, turn = off(found, poses[BEGIN])
    assert shift < 0.7
    assert turn < 2.5
    assert shift < off(by_velocity(here, there), poses[BEGIN])[0]


@pytest.mark.parametrize("folds", [pytest.param(0.0, marks=pytest.mark.slow), 0.6])
@pytest.mark.parametrize(
    ("speed", "begin"),
    [
        (0.45, 81),
        pytest.param(0.2, 66, marks=pytest.mark.slow),
        pytest.param(-0.1, 66, marks=pytest.mark.slow),
        pytest.param(-0.45, 81, marks=pytest.mark.slow),
    ],
)
def test_a_smooth_tube_tells_nothing(folds, speed, begin):
    """Neither the way along it nor the turn about it is seen."""
    path = (AHEAD if speed > 0 else BACK)[0], speed
    poses = {k: world_from_camera(k, *path) for k in range(begin + 45)}
    here, there = {k: poses[k] for k in range(END + 1)}, {k: poses[k] for k in range(begin, begin + 45)}
    assert registered_over_gap(here, there, lambda k: cloud(k, folds, path=path)) is None


@pytest.mark.parametrize("speed", [0.45, pytest.param(-0.45, marks=pytest.mark.slow)])
def test_a_gap_that_the_sensor_does_not_see_either_is_refused(speed):
    """The camera halts in it, and both velocities agree on a fold one period away, where the clouds fit as well."""
    path = (AHEAD if speed > 0 else BACK)[0], speed

    def held_up(k):  # the frame at which the camera would be without the halt
        return k if k <= END else END + max(0, k - BEGIN)

    def clouds(k):
        return None if END < k < BEGIN else folded(held_up(k), path=path)

    poses = {k: world_from_camera(held_up(k), *path) for k in range(COUNT)}
    here, there = ({k: poses[k] for k in frames} for frames in (HERE, THERE))
    assert registered_over_gap(here, there, clouds) is None
    found = registered_over_gap(here, there, lambda k: folded(held_up(k), path=path))
    assert found is not None
    assert off(found, poses[BEGIN])[0] < 0.7


@pytest.mark.parametrize("noise", [0.005, 0.015, 0.03, 0.05])
def test_a_smooth_tube_does_not_hold_a_cloud_however_noisy(noise):
    wall = WallPatches.of(
        np.concatenate([in_camera(world_from_camera(k), cloud(k, 0.0, noise=noise)) for k in range(0, 40, 4)])
    )
    assert not wall.holds(cloud(40, 0.0, noise=noise), world_from_camera(40))


def test_a_folded_tube_holds_a_cloud():
    wall = WallPatches.of(np.concatenate([in_camera(world_from_camera(k), folded(k)) for k in range(0, 40, 4)]))
    assert wall.holds(folded(40), world_from_camera(40))


def least_difference(folds: float, seed: int) -> float:
    """RMS, mm, of another tube's radius to the first one's, at the turn and the shift at which they are most alike."""
    angle, along = np.meshgrid(np.linspace(0, 2 * np.pi, 72, endpoint=False), np.linspace(0, APART_MM, 56, False))

    def wall(turn: float, shift: float, folds: float, seed: int) -> np.ndarray:
        x, y = np.cos(angle - turn), np.sin(angle - turn)
        return radius(np.column_stack([x.ravel(), y.ravel(), (along - shift).ravel()]), folds, seed)

    first = wall(0, 0, FOLDS_MM, 0)
    turns, shifts = np.linspace(0, 2 * np.pi, 36, endpoint=False), np.linspace(0, APART_MM, 28, False)
    return min(np.sqrt(np.mean((wall(t, s, folds, seed) - first) ** 2)) for t in turns for s in shifts)


ALIKE = pytest.mark.xfail(strict=True, reason="walls within 0.8 mm RMS, turned by 30 deg, are taken for one another")


@pytest.mark.parametrize(
    ("seed", "folds"),
    [
        (3, 5.0),
        *(pytest.param(*other, marks=pytest.mark.slow) for other in [(9, 2.0), (2, 5.0), (4, 5.0), (3, 3.0)]),
        pytest.param(8, 5.0, marks=[ALIKE, pytest.mark.slow]),
    ],
)
def test_clouds_of_another_tube_are_refused(seed, folds):
    """A tube that is nearly the first one, turned and moved along (seeds 1 and 6), may be taken for it."""
    assert least_difference(folds, seed) > 0.5

    def clouds(k):
        return folded(k) if k <= END else cloud(k, seed=seed, folds=folds)

    assert registered_over_gap(HERE, THERE, clouds) is None


def at(along_mm: float, degrees: float = 0.0) -> np.ndarray:
    pose = np.eye(4)
    pose[:3, :3] = Rotation.from_euler("z", degrees, degrees=True).as_matrix()
    pose[2, 3] = along_mm
    return pose


@pytest.mark.parametrize(
    ("ways", "found", "taken"),
    [
        ((0, 9), (1, 1.5), 1),  # both registrations end at one pose, near the first way
        ((0, 9), (1, 5), None),  # they end apart
        ((0, 1), (9, 9.5), None),  # far from both ways
        ((0, 9), (None, 1), 1),  # one passes, and the other way led there
        ((0, 9), (1, None), None),  # it lies at its own way alone
        ((0, 0), (None, None), None),
    ],
)
def test_a_pose_needs_a_second_witness(ways, found, taken):
    registered = [None if z is None else Registered(at(z), misfit=1.0 + k) for k, z in enumerate(found)]
    pose = _agreed((at(ways[0]), at(ways[1])), registered)
    assert (pose is None) == (taken is None)
    if taken is not None:
        np.testing.assert_allclose(pose, at(taken))


def test_witnesses_of_another_turn_are_none():
    assert _agreed((at(0, 20), at(0, -20)), [Registered(at(0), 1.0), Registered(at(0), 1.0)]) is None


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


def sheet_and_strip() -> tuple[WallPatches, np.ndarray]:
    """A wavy wall of 30 by 20 mm, and a cloud of it that reaches 9 mm beyond its end."""

    def wave(x, y):
        return np.column_stack([x.ravel(), y.ravel(), (30 + 3 * np.sin(x / 5) + 3 * np.cos(y / 4)).ravel()])

    wall = WallPatches.of(wave(*np.meshgrid(np.arange(0, 30, 0.5), np.arange(0, 20, 0.5))))
    return wall, wave(*np.meshgrid(np.arange(12, 39, 0.25), np.arange(0, 20, 0.25)))


def test_points_beyond_the_edge_of_the_wall_have_no_plane():
    wall, cloud_of = sheet_and_strip()
    off_mm, share = wall.fit(cloud_of, np.eye(4))
    assert off_mm < 0.1
    assert 18 / 27 - 0.02 < share < 19 / 27 + 0.02


def test_two_walls_joined_are_both_there():
    wall, _ = sheet_and_strip()
    x, y = np.meshgrid(np.arange(60, 70, 0.5), np.arange(0, 10, 0.5))
    flat = np.column_stack([x.ravel(), y.ravel(), np.full(x.size, 5.0)])
    both = wall.joined(WallPatches.of(flat))
    assert wall.fit(flat, np.eye(4))[1] == 0
    assert both.fit(flat, np.eye(4)) == (pytest.approx(0, abs=1e-9), 1.0)
    points = wall.tree.data
    assert both.fit(points, np.eye(4)) == pytest.approx(wall.fit(points, np.eye(4)))
