"""Pictures of an evaluation: contact sheet with error maps (Figure 4), error over points (Figure 5)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from completion.calibration import Calibration
from completion.evaluate import FrameResult

ERROR_SHOWN = 0.15  # relative error at which the colour saturates


def contact_sheet(path: Path, results: Sequence[FrameResult], title: str, unit: str, frames: int = 6) -> Path:
    """Rows: image with its points, true depth, completed depth, relative error; columns: frames spread evenly."""
    plt = _pyplot()
    chosen = [results[i] for i in np.unique(np.linspace(0, len(results) - 1, frames).round().astype(int))]
    figure, axes = plt.subplots(4, len(chosen), figsize=(2.1 * len(chosen), 9), squeeze=False, layout="constrained")
    for column, result in enumerate(chosen):
        known = result.truth > 0
        low, high = np.percentile(result.truth[known], [1, 99])
        rows, columns = np.nonzero(result.sparse > 0)
        axes[0, column].imshow(result.rgb)
        axes[0, column].scatter(columns, rows, c=result.sparse[rows, columns], s=3, cmap="turbo_r", vmin=low, vmax=high)
        axes[0, column].set_title(f"{result.name}: {result.points} points", fontsize=8)
        for row, depth in ((1, result.truth), (2, result.prediction)):
            shown = np.where(depth > 0, depth, np.nan)
            picture = axes[row, column].imshow(shown, cmap="turbo_r", vmin=low, vmax=high)
        figure.colorbar(picture, ax=axes[2, column], shrink=0.7, label=unit)
        error = np.where(known, np.abs(result.prediction - result.truth) / np.where(known, result.truth, 1), np.nan)
        picture = axes[3, column].imshow(100 * error, cmap="magma", vmin=0, vmax=100 * ERROR_SHOWN)
        axes[3, column].set_title(f"abs.REL {100 * result.errors.abs_rel:.1f} %", fontsize=8)
        figure.colorbar(picture, ax=axes[3, column], shrink=0.7, label="%")
    for row, label in enumerate(("image, points", "truth", "completed", "relative error")):
        axes[row, 0].set_ylabel(label)
    for axis in axes.flat:
        axis.set_xticks([]), axis.set_yticks([])
    figure.suptitle(title, fontsize=9)
    figure.savefig(path, dpi=110)
    plt.close(figure)
    return path


def sweep_plot(path: Path, curves: Mapping[str, Mapping[int, float]], title: str) -> Path:
    """abs.REL in percent over the number of points, one line per name, both axes logarithmic (paper Fig. 5)."""
    plt = _pyplot()
    figure, axis = plt.subplots(figsize=(6, 4), layout="constrained")
    for name, curve in curves.items():
        axis.plot(list(curve), [100 * value for value in curve.values()], marker="o", label=name)
    axis.set(xscale="log", yscale="log", xlabel="points per frame", ylabel="abs.REL [%]")
    axis.grid(True, which="both", alpha=0.3)
    axis.legend(fontsize=8)
    axis.set_title(title, fontsize=9)
    figure.savefig(path, dpi=110)
    plt.close(figure)
    return path


def calibration_plot(path: Path, calibrations: Mapping[str, Calibration]) -> Path:
    """Median actual over median predicted error by deciles; a calibrated model lies on ln 2 times the diagonal."""
    plt = _pyplot()
    figure, axis = plt.subplots(figsize=(5, 5), layout="constrained")
    for name, found in calibrations.items():
        predicted, actual = 100 * np.array(found.predicted), 100 * np.array(found.actual)
        axis.plot(predicted, actual, marker="o", label=f"{name}: Spearman {found.spearman:.2f}, {found.pixels} px")
    low, high = axis.get_xlim()
    line = np.geomspace(max(low, 0.05), high, 50)
    axis.plot(line, np.log(2) * line, "k--", linewidth=1, label="Laplace, calibrated: median error = ln 2 x predicted")
    axis.set(xscale="log", yscale="log", xlabel="predicted relative error [%]", ylabel="actual relative error [%]")
    axis.grid(True, which="both", alpha=0.3)
    axis.legend(fontsize=7)
    figure.savefig(path, dpi=110)
    plt.close(figure)
    return path


def _pyplot() -> Any:
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    return plt
