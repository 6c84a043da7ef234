"""Motion is told where a wall moves, and not where noise, sliding corners or a bad frame are all that there is."""

from dataclasses import replace

import numpy as np
import pytest

from reconstruction.motion.held_out_motion import Residuals, held_out_motion

FOCAL = 200.0
POINTS, FRAMES, SECONDS = 400, 60, 6.0


def followed(seed, move=lambda world, seconds: np.zeros_like(world), noise_px=0.4):
    """Residuals of a wall about 1 away, seen from a camera that stands: all points in all frames."""
    rng = np.random.default_rng(seed)
    wall = np.column_stack([rng.uniform(-0.8, 0.8, (POINTS, 2)), rng.uniform(0.7, 1.3, POINTS)])
    point, frame = (a.ravel() for a in np.meshgrid(np.arange(POINTS), np.arange(FRAMES), indexing="ij"))
    seconds, world = 3.0 + frame * SECONDS / FRAMES, wall[point]
    slope = np.zeros((len(point), 2, 3))
    slope[:, 0, 0] = slope[:, 1, 1] = FOCAL / world[:, 2]
    slope[:, :, 2] = -FOCAL * world[:, :2] / world[:, 2:] ** 2
    pixels = -np.einsum("mij,mj->mi", slope, move(world, seconds)) + noise_px * rng.standard_normal((len(point), 2))
    return Residuals(point, world, seconds, pixels, slope)


def ring(world, seconds):
    """A contraction that crosses the wall: 0.006 of its distance, 0.3 wide."""
    at = np.exp(-(((world[:, 0] - 0.3 * (seconds - 6)) / 0.3) ** 2))
    return 0.006 * at[:, None] * np.array([0.6, 0.8, 0.0])


@pytest.mark.parametrize("seed", range(4))
def test_a_still_wall_is_not_told_to_move(seed):
    found = held_out_motion(followed(seed))
    assert not found.is_told
    assert found.explained < 0


@pytest.mark.parametrize("seed", range(2))
def test_a_moving_wall_is(seed):
    found = held_out_motion(followed(seed, ring))
    assert found.is_told


def test_pieces_of_a_film_count_by_what_they_miss():
    still, moving = held_out_motion(followed(0)), held_out_motion(followed(0, ring))
    both = still + moving
    assert both.before == still.before + moving.before
    assert still.explained < both.explained < moving.explained


def test_a_lens_that_is_wrong_is_told_too():
    """What the words to the user must not deny: neighbours share the error of a lens."""
    seen = followed(3)
    turned = 0.5 * np.column_stack([seen.world[:, 1], -seen.world[:, 0]]) * np.sin(seen.seconds)[:, None]
    assert held_out_motion(replace(seen, pixels=seen.pixels + turned)).is_told


@pytest.mark.parametrize("size", [3.0, 10.0])
def test_corners_that_slide_for_themselves_are_no_motion(size):
    seen = followed(5)
    rng = np.random.default_rng(6)
    slide = rng.standard_normal((POINTS, 2))[seen.point] * ((seen.seconds - 6) / SECONDS)[:, None]
    assert not held_out_motion(replace(seen, pixels=seen.pixels + size / 3 * slide)).is_told


def test_a_corner_found_twice_does_not_foretell_itself():
    seen = followed(7)
    rng = np.random.default_rng(8)
    slide = rng.standard_normal((POINTS, 2))[seen.point] * ((seen.seconds - 6) / SECONDS)[:, None]
    twice = Residuals(
        np.concatenate([2 * seen.point, 2 * seen.point + 1]),
        *(np.concatenate([a, a]) for a in (seen.world, seen.seconds, seen.pixels + 2 * slide, seen.jacobian)),
    )
    assert not held_out_motion(twice).is_told


def test_too_little_to_tell():
    seen = followed(0)
    few, short = seen.point < 40, seen.seconds < 3.5
    for mine in (few, short):
        part = (a[mine] for a in (seen.point, seen.world, seen.seconds, seen.pixels, seen.jacobian))
        assert held_out_motion(Residuals(*part)) is None
