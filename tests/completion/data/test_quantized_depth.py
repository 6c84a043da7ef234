"""Depth stored in coarse steps, brought back: nearer to what it was rounded from, never further off than rounding."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from typer.testing import CliRunner

from completion.data.evaluation_frame import EvaluationFrame
from completion.data.quantized_depth import dequantize
from completion.evaluation import evaluate
from completion.evaluation.evaluate import Protocol, evaluate_frames, mean_errors
from completion.evaluation.metrics import depth_errors
from completion.evaluation.predictors import load_predictor
from haustra.core.errors import CompletionError
from pipeline.cli.main import app

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
    smooth = dequantize(stored(true), STEP)
    before, after = (np.sqrt(np.mean((depth - true) ** 2)) for depth in (stored(true), smooth))
    assert before == pytest.approx(STEP / np.sqrt(12), rel=0.1)  # uniform within a step
    assert after < before / 2  # wide stairs where the wall is flat keep some of it


def test_edges_and_holes_stay() -> None:
    true = wall()
    true[20:30, 20:30] = 0
    smooth = dequantize(stored(true), STEP)
    middle = true.shape[1] // 2
    jump = (smooth[:, middle] - smooth[:, middle - 1]) - (true[:, middle] - true[:, middle - 1])
    assert np.abs(jump).max() <= STEP + 1e-4
    assert np.abs(jump).mean() < 0.3 * STEP
    np.testing.assert_array_equal(smooth == 0, true == 0)


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 2**31), st.floats(0.05, 3.0))
def test_nothing_moves_further_than_half_a_step(seed: int, step: float) -> None:
    rng = np.random.default_rng(seed)
    depth = (step * rng.integers(0, 9, (12, 128))).astype(np.float32)
    smooth = dequantize(depth, step)
    assert np.abs(smooth - depth).max() <= step / 2 * (1 + 1e-5)
    np.testing.assert_array_equal(smooth == 0, depth == 0)


def test_what_touches_nothing_of_its_own_is_left_alone() -> None:
    """Flat wall a step away beside a hole; every neighbour across an edge; two flats three steps apart."""
    holed = np.full((64, 128), STEP, np.float32)
    holed[20:30, 50:60] = 0
    board = ((np.indices((64, 128)).sum(axis=0) % 2 * 10 + 5) * STEP).astype(np.float32)
    fold = np.full((64, 128), 10 * STEP, np.float32)
    fold[:, 64:] += 3 * STEP
    for depth in (holed, board, fold):
        np.testing.assert_allclose(dequantize(depth, STEP), depth, rtol=1e-6)


@pytest.mark.parametrize(("slope", "left"), [(1.37, 0.7), (2.13, 1.001)])
def test_steep_wall_gains_or_is_left_alone(slope: float, left: float) -> None:
    """Steps from pixel to pixel; where some of them pass for edges, what lies between is not pulled to one side."""
    true = np.broadcast_to(20 + slope * STEP * np.arange(60, dtype=np.float32), (60, 60))
    off = [np.abs(depth - true)[10:-10, 10:-10].mean() for depth in (stored(true), dequantize(stored(true), STEP))]
    assert off[1] < left * off[0]


def test_a_larger_image_is_smoothed_as_far() -> None:
    """The same wall in twice the pixels, which then take four times the passes."""
    small, large = dequantize(stored(wall()), STEP), dequantize(np.kron(stored(wall()), np.ones((2, 2))), STEP)
    apart = np.abs(large.reshape(96, 2, 96, 2).mean(axis=(1, 3)) - small)[8:-8, 8:-8] / STEP
    assert np.median(apart) < 0.02


@pytest.mark.parametrize("step", [0.5, 0.0, -1.0])
def test_depth_in_other_steps_is_refused(step: float) -> None:
    with pytest.raises(CompletionError, match="does not come in steps"):
        dequantize(stored(wall()), step)


def test_evaluation_judges_against_the_smooth_depth_and_says_so(monkeypatch: pytest.MonkeyPatch) -> None:
    """Interpolation of all the smooth depth's own points errs by nothing, and against the stored depth by stairs."""
    monkeypatch.setattr(evaluate, "MOST_GIVEN", 1.0)
    true = wall()
    frame = EvaluationFrame("0", np.zeros((*true.shape, 3), np.uint8), stored(true), "mm")
    protocol = Protocol(points=true.size, depth_step=STEP)
    result = next(iter(evaluate_frames([frame], load_predictor("nearest"), protocol)))
    np.testing.assert_array_equal(result.truth, dequantize(stored(true), STEP))
    assert mean_errors([result], protocol).abs_rel < 1e-6
    assert depth_errors(result.prediction, stored(true)).abs_rel > 1e-3
    assert "truth without its steps of 0.784314" in str(protocol)
    assert "steps" not in str(Protocol())


def test_the_command_takes_the_step(tmp_path: Path) -> None:
    """A folder as SimCol3D's: 200 mm in 255 steps of 256 counts."""
    counts = (256 * np.round(wall() / STEP)).astype(np.uint16)
    cv2.imwrite(str(tmp_path / "Depth_0000.png"), counts)
    cv2.imwrite(str(tmp_path / "FrameBuffer_0000.png"), np.zeros((*counts.shape, 3), np.uint8))
    words = ["evaluate", str(tmp_path), "--model", "nearest", "--points", str(counts.size // 3), "-q"]
    stored_too, smooth = (CliRunner().invoke(app, [*words, *more]) for more in ([], ["--depth-step", "0.784314"]))
    assert stored_too.exit_code == smooth.exit_code == 0
    assert "truth without its steps of 0.784314" in smooth.stdout
    assert "steps" not in stored_too.stdout
    wrong = CliRunner().invoke(app, [*words, "--depth-step", "0.7"])
    assert wrong.exit_code == 1
    assert "does not come in steps of 0.7" in str(wrong.exception)
