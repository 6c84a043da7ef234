"""Per-frame errors of a completion model on frames with true depth, under a stated protocol.

Points are drawn from (seed, index of the frame), so that two models, or two runs, get the same ones.
"""

from __future__ import annotations

import csv
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field, replace
from itertools import islice
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field

from completion.data.evaluation_frame import EvaluationFrame
from completion.data.quantized_depth import dequantize
from completion.data.sampling_benchmark import get_sampler
from completion.evaluation.metrics import Alignment, Averaging, DepthErrors, average, depth_errors
from completion.evaluation.predictors import Predictor
from haustra.core.errors import CompletionError

Array = NDArray[np.floating]
MOST_GIVEN = 0.5  # share of the true pixels that may be points: those that are given back are no errors
COLUMNS = ("rmse", "abs_rel", "mae", "delta_1", "delta_2", "delta_3", "scale", "pixels", "missing")


class Protocol(BaseModel):
    """The settings that an error depends on besides the model and the frames."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    sampler: str = "uniform"
    points: int = Field(100, ge=0)
    alignment: Alignment = "none"
    averaging: Averaging = "per_frame"
    seed: int = Field(0, ge=0)
    stride: int = Field(1, ge=1)
    depth_step: float = Field(0.0, ge=0)
    """In the truth's unit: quantization step that is smoothed out of the truth first; 0: none."""

    def __str__(self) -> str:
        return self.described("")

    def described(self, found: str) -> str:
        """In words; `found` is said of the points, where there were not as many as asked for."""
        untouched = "no scale alignment"
        if self.sampler == "sfm":  # points of an unknown scale, with noise and outliers: `sampling_benchmark.like_sfm`
            untouched = "their unknown scale given back by its true value"
        scaled = {"none": untouched, "points": "scale from the sparse points"}
        scale = scaled.get(self.alignment, self.alignment + " scale")
        return f"{self.points} {self.sampler} points{found}, {scale}, {self.conditions}"

    @property
    def conditions(self) -> str:
        """What holds for any points and alignment: averaging, seed, frames that are looked at, truth."""
        every = f", one frame in {self.stride}" if self.stride > 1 else ""
        return f"{self.averaging.replace('_', '-')} mean, seed {self.seed}{every}{self._truth}"

    @property
    def _truth(self) -> str:
        return f", truth without its steps of {self.depth_step:g}" if self.depth_step else ""


@dataclass(frozen=True)
class Score:
    """One frame's errors, and how many points it really had."""

    name: str
    points: int
    errors: DepthErrors


@dataclass(frozen=True)
class FrameResult(Score):
    """A score with the arrays that it was computed from."""

    rgb: NDArray[np.uint8]
    truth: Array
    sparse: Array
    prediction: Array  # aligned as the protocol says, in the truth's unit
    confidence: Array | None


@dataclass(frozen=True)
class LeftOut:
    """Names of frames that cannot be judged: those without any true depth, those in which the sampler finds no point
    with true depth, and those whose true depth is mostly given to the network as points."""

    without_truth: list[str] = field(default_factory=list)
    without_points: list[str] = field(default_factory=list)
    without_others: list[str] = field(default_factory=list)

    def __str__(self) -> str:
        what = {"true depth": self.without_truth, "points": self.without_points}
        what["true depth but at the points"] = self.without_others
        counts = ((len(names), missing) for missing, names in what.items())
        frames = ", ".join(f"{count} without {what}" for count, what in counts if count)
        return frames and f"{frames} left out"


def evaluate_frames(
    frames: Iterable[EvaluationFrame],
    predict: Predictor,
    protocol: Protocol,
    advance: Callable[[int], None] | None = None,
    left_out: LeftOut | None = None,
) -> Iterable[FrameResult]:
    """Results frame by frame; CompletionError for a frame whose picture and true depth differ in size.

    A frame that cannot be judged is left out, and its name added to `left_out`.

    The unknown factor of SfM-like points is divided out of the prediction, before the protocol's scale alignment.
    """
    sampler, left_out = get_sampler(protocol.sampler), left_out or LeftOut()
    for judged, (place, frame) in enumerate(islice(enumerate(frames), 0, None, protocol.stride), start=1):
        if protocol.depth_step:
            frame = replace(frame, depth=dequantize(frame.depth, protocol.depth_step))
        _check_sizes(frame)
        if not (frame.depth > 0).any():
            left_out.without_truth.append(frame.name)
            continue
        rng = np.random.default_rng([protocol.seed, place])
        sparse = sampler(frame.rgb, frame.depth, protocol.points, rng)
        if not sparse.points:
            left_out.without_points.append(frame.name)
            continue
        if sparse.points > MOST_GIVEN * np.count_nonzero(frame.depth > 0):
            left_out.without_others.append(frame.name)
            continue
        depth, confidence = predict(frame.rgb, sparse.depth, frame.intrinsics)
        depth = depth / np.float32(sparse.factor)
        known = sparse.depth / np.float32(sparse.factor)
        errors = depth_errors(depth, frame.depth, protocol.alignment, known)
        aligned = depth * np.float32(errors.scale)
        yield FrameResult(frame.name, sparse.points, errors, frame.rgb, frame.depth, known, aligned, confidence)
        if advance:
            advance(judged)


def _check_sizes(frame: EvaluationFrame) -> None:
    """CompletionError where picture and depth do not lie pixel on pixel: a fill that does not look at the picture would
    be judged all the same, and points at the picture's features would be depths of other places."""
    (height, width), (rows, columns) = frame.rgb.shape[:2], frame.depth.shape
    if (height, width) != (rows, columns):
        raise CompletionError(
            f"frame {frame.name}: its picture has {width}x{height} px and its true depth {columns}x{rows} px; "
            "give both in one size"
        )


def mean_errors(results: Sequence[Score], protocol: Protocol) -> DepthErrors:
    """Mean errors over the frames, as the protocol averages."""
    return average([result.errors for result in results], protocol.averaging)


def write_csv(path: Path, results: Iterable[Score]) -> None:
    """One line per frame."""
    with path.open("w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(["frame", "points", *COLUMNS])
        for result in results:
            row = result.errors.to_dict()
            writer.writerow([result.name, result.points, *(f"{row[name]:.6g}" for name in COLUMNS)])


def paper_row(errors: DepthErrors, unit: str) -> dict[str, str]:
    """The paper's five columns as it prints them: abs.REL in percent (its table says cm; the values are percent)."""
    return {
        f"RMSE [{unit}]": f"{errors.rmse:.4f}",
        "abs.REL [%]": f"{100 * errors.abs_rel:.4f}",
        f"MAE [{unit}]": f"{errors.mae:.4f}",
        "delta_1": f"{errors.delta_1:.4f}",
        "delta_2": f"{errors.delta_2:.4f}",
    }


def markdown_table(rows: Sequence[tuple[str, dict[str, str]]], first: str = "method") -> str:
    """Rows of equal columns as a Markdown table."""
    columns = list(rows[0][1])
    lines = [f"| {first} | {' | '.join(columns)} |", "|---" * (len(columns) + 1) + "|"]
    lines += [f"| {name} | {' | '.join(cells[column] for column in columns)} |" for name, cells in rows]
    return "\n".join(lines)
