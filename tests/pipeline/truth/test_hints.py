"""Clocks and units that would explain a bad fit are named, and nothing is said of a good one."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from haustra.core.se3 import inverse
from pipeline.truth.hints import (
    MIRROR,
    Y_UP,
    Timed,
    clock_hint,
    misfit_hint,
    path_hints,
    pose_hint,
    surface_hint,
    unit_hint,
)

RATE, FRAMES = 30, 300


def winding(seed: int, frames: int = FRAMES) -> np.ndarray:
    """A smooth path (N,3) that repeats nothing, some 100 mm long."""
    rng = np.random.default_rng(seed)
    t = np.arange(frames) / RATE
    waves = [np.sin(t[:, None] * rng.uniform(0.5, 2.5, 3) + rng.uniform(0, 6, 3)) * rng.uniform(2, 6) for _ in range(4)]
    return np.sum(waves, axis=0) + t[:, None] * (2, 0, 8)


def seen(seed: int, noise: float = 0.05) -> Timed:
    """A run's path: turned, in its own unit, with noise."""
    rng = np.random.default_rng(seed + 1000)
    turn, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    turn *= np.sign(np.linalg.det(turn))
    centres = 0.03 * (winding(seed) + rng.normal(0, noise, (FRAMES, 3))) @ turn.T + rng.normal(size=3)
    return Timed(np.arange(FRAMES) / RATE, centres)


@pytest.mark.parametrize("shift", [-3.0, -2.2, -1.4, -0.7, -0.4, 0.3, 0.5, 1.0, 1.4, 2.5, 3.5])
def test_a_clock_that_is_off_is_named(shift: float) -> None:
    run = seen(int(abs(shift) * 10))
    truth = Timed(run.seconds + shift, winding(int(abs(shift) * 10)))
    hint = clock_hint(run, truth)
    assert f"the true times {-round(shift * RATE) / RATE:+.3g} s" in hint


@pytest.mark.parametrize("rate", [0.5, 2.0, 24 / 25, 30 / 25, 24 / 30])
@pytest.mark.parametrize("seed", range(3))
def test_times_of_another_frame_rate_are_named(rate: float, seed: int) -> None:
    hint = clock_hint(seen(seed), Timed(np.arange(FRAMES) / RATE / rate, winding(seed)))
    assert f"the true times times {rate:.3g}: they may be of another frame rate" in hint


@pytest.mark.parametrize("seed", range(12))
def test_the_right_clock_is_left_alone(seed: int) -> None:
    assert clock_hint(seen(seed), Timed(np.arange(FRAMES) / RATE, winding(seed))) == ""


@pytest.mark.parametrize("seed", range(10))
def test_a_path_that_is_wrong_under_every_clock_is_no_matter_of_clocks(seed: int) -> None:
    walk = np.cumsum(np.random.default_rng(seed).normal(size=(FRAMES, 3)), axis=0)
    assert clock_hint(Timed(np.arange(FRAMES) / RATE, walk), Timed(np.arange(FRAMES) / RATE, winding(seed + 50))) == ""


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize(("unit", "name", "factor"), [(1e-3, "metres", 1000), (1e-2, "centimetres", 100)])
def test_units_are_named_where_the_run_has_millimetres(seed: int, unit: float, name: str, factor: int) -> None:
    scale = unit * np.random.default_rng(seed).uniform(0.8, 1.25)
    hint = unit_hint(Timed(np.arange(FRAMES) / RATE, unit * winding(seed)), scale, True)
    assert f"say {name}: multiply the truth by {factor}" in hint


@pytest.mark.parametrize("seed", range(10))
def test_metres_are_guessed_at_where_the_run_has_none(seed: int) -> None:
    assert "metres" in unit_hint(Timed(np.arange(FRAMES) / RATE, 1e-3 * winding(seed)), 1e-3, False)
    assert unit_hint(Timed(np.arange(FRAMES) / RATE, winding(seed)), 31.0, False) == ""
    assert unit_hint(Timed(np.arange(FRAMES) / RATE, winding(seed)), 1.03, True) == ""


def posed(seed: int) -> np.ndarray:
    """True poses (N,4,4) of a camera that looks about while it goes along a winding path."""
    poses = np.tile(np.eye(4), (FRAMES, 1, 1))
    poses[:, :3, :3] = Rotation.from_rotvec(winding(seed + 7) / 12).as_matrix()
    poses[:, :3, 3] = winding(seed)
    return poses


def mirrored_centres(poses: np.ndarray, axis: int) -> np.ndarray:
    stored = poses.copy()
    stored[:, axis, 3] *= -1
    return stored


def stored_w_first(poses: np.ndarray) -> np.ndarray:
    stored = poses.copy()
    quaternions = Rotation.from_matrix(poses[:, :3, :3]).as_quat()
    stored[:, :3, :3] = Rotation.from_quat(quaternions[:, [3, 0, 1, 2]]).as_matrix()
    return stored


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize(
    ("stored", "reading"),
    [
        (stored_w_first, "quaternions are w x y z"),
        (lambda poses: poses @ Y_UP, "OpenGL's axes"),
        (lambda poses: np.stack([inverse(pose) for pose in poses]), "camera_from_world"),
        (lambda poses: MIRROR @ poses @ MIRROR, "left-handed"),
        (lambda poses: mirrored_centres(poses, 0), "x of the centres has the other sign"),
        (lambda poses: mirrored_centres(poses, 2), "z of the centres has the other sign"),
        (lambda poses: poses, ""),
        (lambda poses: np.roll(poses, 60, axis=0), ""),
    ],
)
def test_poses_of_another_convention_are_named(seed: int, stored, reading: str) -> None:
    run = posed(seed)
    run[:, :3, 3] = 0.03 * (run[:, :3, 3] + np.random.default_rng(seed).normal(0, 0.05, (FRAMES, 3)))
    hint = pose_hint(run, stored(posed(seed)))
    assert reading in hint
    assert bool(hint) == bool(reading)


@pytest.mark.parametrize("seed", range(5))
def test_only_paths_that_hardly_resemble_each_other_are_called_another_film(seed: int) -> None:
    rng, mine, other = np.random.default_rng(seed), posed(seed), posed(seed + 20)
    noisy = mine.copy()
    noisy[:, :3, 3] += rng.normal(0, 1.0, (len(mine), 3))
    assert misfit_hint(noisy, mine) == ""
    hint = misfit_hint(other, mine)
    assert "either this is the truth of another film, or the run is wrong" in hint
    assert "rotation median" in hint


@pytest.mark.parametrize("seed", range(5))
def test_a_straight_path_that_is_right_is_not_called_another_film(seed: int) -> None:
    """By its centres alone it may be turned about itself."""
    rng, true = np.random.default_rng(seed), posed(seed)
    true[:, :3, 3] = np.linspace(0, 100, len(true))[:, None] * [0, 0, 1.0] + rng.normal(0, 0.05, (len(true), 3))
    run = true.copy()
    run[:, :3, 3] += rng.normal(0, 2.0, (len(true), 3))
    assert misfit_hint(run, true) == ""


@pytest.mark.parametrize(("count", "few"), [(3, True), (9, True), (10, False)])
def test_a_path_that_is_compared_at_few_poses_is_told(count: int, few: bool) -> None:
    true = posed(0)[:count]
    path = Timed(np.arange(count) / RATE, true[:, :3, 3])
    hints = path_hints(path, path, true, true, 1.0, True)
    assert [f"compared at {count} poses alone" in hint for hint in hints] == [True] * few


@pytest.mark.parametrize("seed", range(4))
def test_a_true_wall_that_no_camera_could_see_is_named(seed: int) -> None:
    rng, centres = np.random.default_rng(seed), winding(seed)
    wall = centres[rng.integers(0, FRAMES, 4000)] + 25 * Rotation.random(4000, random_state=seed).as_matrix()[:, 0]
    assert surface_hint(wall, centres) == ""
    assert "is it in metres?" in surface_hint(wall / 1000, centres)
    assert "another frame or unit" in surface_hint(wall + 1000, centres)
