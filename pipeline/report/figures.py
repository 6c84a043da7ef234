"""Pictures of a run as RGB arrays or PNG bytes; nothing is shown on a screen."""

import io

import cv2
import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from numpy.typing import NDArray


def webp(image: NDArray[np.uint8], quality: int = 88) -> bytes:
    """(H,W,3) uint8 RGB to WebP: a tenth of PNG's size for a shaded surface."""
    return cv2.imencode(".webp", image[..., ::-1], [cv2.IMWRITE_WEBP_QUALITY, quality])[1].tobytes()


def figure_png(figure: Figure) -> bytes:
    buffer = io.BytesIO()
    FigureCanvasAgg(figure)  # not pyplot, whose choice of where to draw is the caller's
    figure.savefig(buffer, dpi=110)
    return buffer.getvalue()


def path_figure(centres: NDArray[np.float64], keyframes: NDArray[np.int64], seconds: NDArray, unit: str) -> bytes:
    """The camera path from two sides, coloured by time; keyframes are ringed.

    The path is turned to its principal axes, so that its longest extent lies along x.
    """
    centred = centres - centres.mean(axis=0)
    turned = centred @ np.linalg.svd(centred, full_matrices=False)[2].T
    figure = Figure(figsize=(7, 5.2), layout="constrained")
    panels = figure.subplots(2, 1, sharex=True)
    for panel, axis, name in zip(panels, (1, 2), ("second axis", "third axis"), strict=True):
        panel.plot(turned[:, 0], turned[:, axis], color="0.75", linewidth=1, zorder=1)
        dots = panel.scatter(turned[:, 0], turned[:, axis], c=seconds, s=9, cmap="viridis", zorder=3)
        panel.scatter(
            turned[keyframes, 0],
            turned[keyframes, axis],
            s=34,
            facecolors="none",
            edgecolors="k",
            linewidths=0.5,
        )
        panel.set_ylabel(f"{name} [{unit}]")
        panel.set_aspect("equal", adjustable="datalim")
        panel.grid(alpha=0.3)
    panels[1].set_xlabel(f"first principal axis of the path [{unit}]")
    figure.colorbar(dots, ax=panels, label="time [s]")
    return figure_png(figure)
