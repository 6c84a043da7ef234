"""Depth stored in coarse steps, brought back: nearer to what it was rounded from, never further off than rounding."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from completion.errors import CompletionError
from completion.evaluate import Protocol, evaluate_frames, mean_errors
from completion.frames import EvaluationFrame
from completion.metrics import depth_errors
from completion.predictors import load_predictor
from completion.stepped_depth import without_steps

STEP = 200 / 255


def wall(size: int = 96) -> np.ndarray:
    """z of a curved wall that recedes, with the edge of a fold across it, mm."""
    y, x = np.mgrid[:size, :size] / size
    z = 12 + 14 * y**2 + 3 * np.sin(4 * x) * y
    z[:, size // 2 :] += 12
    return z.astype(np.float32)


def stored(z: np.ndarray) -> np.ndarray:
    return (STEP * np.round(z / STEP)).astype(np.float32)


def test_most_of_the_rounding_is_taken_back() -> None:
    true = wall()
    smooth = without_steps(stored(true), STEP)
    before, after = (np.sqrt(np.mean((depth - true) ** 2)) for depth in (stored(true), smooth))
    assert before == pytest.approx(STEP / np.sqrt(12), rel=0.1)  # uniform within a step
    assert after < before / 2  # wide stairs where the wall is flat keep some of it


def test_edges_and_holes_stay() -> None:
    true = wall()
    true[20:30, 20:30] = 0
    smooth = without_steps(stored(true), STEP)
    middle = true.shape[1] // 2
    jump = (smooth[:, middle] - smooth[:, middle - 1]) - (true[:, middle] - true[:, middle - 1])
    assert np.abs(jump).max() <= STEP + 1e-4
    assert np.abs(jump).mean() < 0.3 * STEP
    np.testing.assert_array_equal(smooth == 0, true == 0)


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 2**31), st.floats(0.05, 3.0))
def test_nothing_moves_further_than_half_a_step(seed: int, step: float) -> None:
    rng = np.random.default_rng(seed)
    depth = (step * rng.integers(0, 9, (20, 24))).astype(np.float32)
    smooth = without_steps(depth, step)
    assert np.abs(smooth - depth).max() <= step / 2 * (1 + 1e-5)
    np.testing.assert_array_equal(smooth == 0, depth == 0)


def test_a_constant_or_unlinked_picture_is_left_alone() -> None:
    flat = np.full((16, 16), 30 * STEP, np.float32)
    np.testing.assert_allclose(without_steps(flat, STEP), flat, rtol=1e-6)
    board = (np.indices((16, 16)).sum(axis=0) % 2 * 10 + 5) * STEP  # every neighbour is across an edge
    np.testing.assert_allclose(without_steps(board.astype(np.float32), STEP), board, rtol=1e-6)


@pytest.mark.parametrize("step", [0.5, 0.0, -1.0])
def test_depth_in_other_steps_is_refused(step: float) -> None:
    with pytest.raises(CompletionError, match="does not come in steps"):
        without_steps(stored(wall()), step)


def test_evaluation_judges_against_the_smooth_depth_and_says_so() -> None:
    """Interpolation of all the smooth depth's own points errs by nothing, and against the stored depth by stairs."""
    true = wall()
    frame = EvaluationFrame("0", np.zeros((*true.shape, 3), np.uint8), stored(true), "mm")
    protocol = Protocol(points=true.size, depth_step=STEP)
    result = next(iter(evaluate_frames([frame], load_predictor("nearest"), protocol)))
    np.testing.assert_array_equal(result.truth, without_steps(stored(true), STEP))
    assert mean_errors([result], protocol).abs_rel < 1e-6
    assert depth_errors(result.prediction, stored(true)).abs_rel > 1e-3
    assert "truth without its steps of 0.784314" in str(protocol)
    assert "steps" not in str(Protocol())
