"""Plots of an evaluation: sample frames with error maps, methods side by side (the paper's Fig. 4), error over points
(Fig. 5), features before and after structure awareness (Fig. 6), calibration."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from completion.evaluation.evaluate import FrameResult
from completion.evaluation.uncertainty import ErrorCalibration
from haustra.core.errors import CompletionError

Features = NDArray[np.floating]  # (C,h,w)
KINDS = ("png", "jpg", "jpeg", "pdf", "svg", "tif", "tiff", "webp")  # that need no other program: pgf asks for LaTeX
ERROR_SHOWN = 0.15  # relative error at which the colour saturates


def sample_frames_plot(path: Path, results: Sequence[FrameResult], title: str, unit: str) -> Path:
    """Rows: image with its points, true depth, completed depth, relative error; a column for each frame."""
    figure, axes = _subplots(4, len(results), figsize=(2.1 * len(results), 9), squeeze=False, layout="constrained")
    for column, result in enumerate(results):
        known = result.truth > 0
        low, high = _shown_range(result)
        _image_with_points(axes[0, column], result)
        axes[0, column].set_title(f"{result.name}: {result.points} points", fontsize=8)
        for row, depth in ((1, result.truth), (2, result.prediction)):
            shown = np.where(depth > 0, depth, np.nan)
            mapped = axes[row, column].imshow(shown, cmap="turbo_r", vmin=low, vmax=high)
        figure.colorbar(mapped, ax=axes[2, column], shrink=0.7, label=unit)
        error = np.where(known, np.abs(result.prediction - result.truth) / np.where(known, result.truth, 1), np.nan)
        mapped = axes[3, column].imshow(100 * error, cmap="magma", vmin=0, vmax=100 * ERROR_SHOWN)
        axes[3, column].set_title(f"abs.REL {100 * result.errors.abs_rel:.1f} %", fontsize=8)
        figure.colorbar(mapped, ax=axes[3, column], shrink=0.7, label="%")
    for row, label in enumerate(("image, points", "truth", "completed", "relative error")):
        axes[row, 0].set_ylabel(label)
    return _without_ticks(figure, axes, title, path)


def comparison_plot(path: Path, results: Mapping[str, Sequence[FrameResult]], title: str) -> Path:
    """Rows: frames; columns: image with its points, true depth, then what each method makes of them (paper Fig. 4)."""
    frames = next(iter(results.values()))
    shape = (len(frames), 2 + len(results))
    figure, axes = _subplots(*shape, figsize=(2 * shape[1], 2.1 * shape[0]), squeeze=False, layout="constrained")
    for row, result in enumerate(frames):
        low, high = _shown_range(result)
        _image_with_points(axes[row, 0], result)
        axes[row, 0].set_ylabel(result.name, fontsize=8)
        depths = {"truth": result.truth, **{name: several[row].prediction for name, several in results.items()}}
        for axis, (name, depth) in zip(axes[row, 1:], depths.items(), strict=True):
            axis.imshow(np.where(depth > 0, depth, np.nan), cmap="turbo_r", vmin=low, vmax=high)
            error = "" if name == "truth" else f"\nabs.REL {100 * results[name][row].errors.abs_rel:.1f} %"
            axis.set_title(name + error, fontsize=8)
    return _without_ticks(figure, axes, title, path)


def attention_plot(path: Path, frames: Sequence[tuple[FrameResult, Features, Features]], title: str) -> Path:
    """Rows: image, mean strength of the features before and after structure awareness; columns: frames (Fig. 6)."""
    figure, axes = _subplots(3, len(frames), figsize=(2.1 * len(frames), 6.6), squeeze=False, layout="constrained")
    for column, (result, *features) in enumerate(frames):
        _image_with_points(axes[0, column], result)
        for row, maps in enumerate(features, start=1):
            # Each on its own scale: what matters is where features are strong, not by how much the module amplifies.
            axes[row, column].imshow(np.abs(maps).mean(axis=0), cmap="inferno", interpolation="bilinear")
    for row, label in enumerate(("image, points", "before", "after")):
        axes[row, 0].set_ylabel(label)
    return _without_ticks(figure, axes, title, path)


def _shown_range(result: FrameResult) -> tuple[float, float]:
    low, high = np.percentile(result.truth[result.truth > 0], [1, 99])
    return float(low), float(high)


def _image_with_points(axis: Any, result: FrameResult) -> None:
    low, high = _shown_range(result)
    rows, columns = np.nonzero(result.sparse > 0)
    axis.imshow(result.rgb)
    axis.scatter(columns, rows, c=result.sparse[rows, columns], s=3, cmap="turbo_r", vmin=low, vmax=high)


def _without_ticks(figure: Any, axes: Any, title: str, path: Path) -> Path:
    for axis in axes.flat:
        axis.set_xticks([]), axis.set_yticks([])
    figure.suptitle(title, fontsize=9)
    return _saved(figure, path)


def check_plot(path: Path) -> None:
    """CompletionError for a suffix that is no kind of picture, before the work that the plot shows."""
    if path.suffix.lower().removeprefix(".") not in KINDS:
        raise CompletionError(f"cannot draw {path}: give a name that ends in .{', .'.join(KINDS)}")


def _saved(figure: Any, path: Path) -> Path:
    figure.savefig(path, dpi=110)
    return path


def sweep_plot(path: Path, curves: Mapping[str, Mapping[int, float]], title: str) -> Path:
    """abs.REL in percent over the number of points, one line per name, both axes logarithmic (paper Fig. 5)."""
    figure, axis = _subplots(figsize=(6, 4), layout="constrained")
    for name, curve in curves.items():
        axis.plot(list(curve), [100 * value for value in curve.values()], marker="o", label=name)
    axis.set(xscale="log", yscale="log", xlabel="points per frame", ylabel="abs.REL [%]")
    axis.grid(True, which="both", alpha=0.3)
    axis.legend(fontsize=8)
    axis.set_title(title, fontsize=9)
    return _saved(figure, path)


def calibration_plot(
    path: Path, calibrations: Mapping[str, ErrorCalibration], strata: Mapping[str, Mapping[str, Mapping[str, float]]]
) -> Path:
    """Left: median actual over median predicted error by deciles; a calibrated model lies on ln 2 times the diagonal.
    Right: share of pixels whose error is below the predicted one, by stratum (`strata`: label -> name -> figures)."""
    from matplotlib.ticker import LogLocator, NullFormatter

    size = (10, 4.5 + 0.35 * len(calibrations))
    figure, (axis, shares) = _subplots(1, 2, figsize=size, layout="constrained")
    for name, found in calibrations.items():
        predicted, actual = 100 * np.array(found.predicted), 100 * np.array(found.actual)
        axis.plot(predicted, actual, marker="o", label=_calibration_label(name, found))
    low, high = axis.get_xlim()
    line = np.geomspace(max(low, 0.05), high, 50)
    axis.plot(line, np.log(2) * line, "k--", linewidth=1, label="Laplace, calibrated: median error = ln 2 x predicted")
    axis.set(xscale="log", yscale="log", xlabel="predicted relative error [%]", ylabel="actual relative error [%]")
    for scale in (axis.xaxis, axis.yaxis):  # a decade's own labels run into one another
        scale.set_major_locator(LogLocator(subs=(1, 2, 5)))
        scale.set_major_formatter("{x:g}")
        scale.set_minor_formatter(NullFormatter())
    axis.grid(True, which="both", alpha=0.3)
    _strata_shares(shares, strata)
    figure.legend(loc="outside lower center", fontsize=7)  # under the curves, however many there are
    return _saved(figure, path)


def _strata_shares(axis: Any, strata: Mapping[str, Mapping[str, Mapping[str, float]]]) -> None:
    """Points of each label in a row for each stratum, beside the band of 63 +- 8 %."""
    names = list(dict.fromkeys(name for found in strata.values() for name in found))
    axis.axvspan(55, 71, color="0.9")
    axis.axvline(100 * (1 - np.exp(-1)), color="k", linestyle="--", linewidth=1)
    for found in strata.values():
        axis.plot([100 * found[n]["within_one"] for n in found], [names.index(n) for n in found], "o")
    axis.set(yticks=range(len(names)), yticklabels=names, xlim=(0, 100))
    axis.set_xlabel("errors below the predicted one [%]; 63 if calibrated")
    axis.invert_yaxis()
    axis.grid(True, axis="x", alpha=0.3)


def _calibration_label(name: str, found: ErrorCalibration) -> str:
    relative = f"Spearman {found.spearman:.2f} (exact Laplace scales: {found.spearman_if_exact:.2f})"
    baseline = f"exact: {found.spearman_absolute_if_exact:.2f}, depth alone: {found.spearman_depth_alone:.2f}"
    return f"{name}: {relative}\nin depth's unit {found.spearman_absolute:.2f} ({baseline}); {found.pixels} px"


def _subplots(rows: int = 1, columns: int = 1, *, squeeze: bool = True, **of_figure: Any) -> tuple[Any, Any]:
    """As pyplot's, which is not asked: where figures are drawn is the caller's choice."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(**of_figure)
    FigureCanvasAgg(figure)
    return figure, figure.subplots(rows, columns, squeeze=squeeze)
