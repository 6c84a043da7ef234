"""Pictures of a run as RGB arrays or PNG bytes; nothing is shown on a screen."""

import io

import cv2
import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from pipeline.sparse_depth import SparseDepth


def png(image: NDArray[np.uint8]) -> bytes:
    """(H,W,3) uint8 RGB to PNG."""
    return cv2.imencode(".png", image[..., ::-1])[1].tobytes()


def figure_png(figure: Figure) -> bytes:
    buffer = io.BytesIO()
    figure.savefig(buffer, dpi=110)
    plt.close(figure)
    return buffer.getvalue()


def path_figure(centres: NDArray[np.float64], keyframes: NDArray[np.int64], seconds: NDArray, unit: str) -> bytes:
    """The camera path from two sides, coloured by time; keyframes are ringed.

    The path is turned to its principal axes, so that its longest extent lies along x.
    """
    centred = centres - centres.mean(axis=0)
    turned = centred @ np.linalg.svd(centred, full_matrices=False)[2].T
    figure, panels = plt.subplots(2, 1, figsize=(7, 5.2), sharex=True, constrained_layout=True)
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


def frame_figure(
    rgb: NDArray[np.uint8],
    sparse: SparseDepth,
    depth: NDArray[np.float32],
    confidence: NDArray[np.float32],
    unit: str,
) -> bytes:
    """One keyframe: image, sparse depth on it, dense depth, confidence; both depths share one colour scale."""
    figure, panels = plt.subplots(1, 4, figsize=(14, 3.5), constrained_layout=True)
    known = depth[depth > 0]
    low, high = np.percentile(known, [1, 98]) if len(known) else (0, 1)
    panels[0].imshow(rgb)
    panels[1].imshow(rgb // 2)
    panels[1].scatter(*(sparse.pixels - 0.5).T, c=sparse.depth, s=6, cmap="turbo", vmin=low, vmax=high)
    shown = panels[2].imshow(np.where(depth > 0, depth, np.nan), cmap="turbo", vmin=low, vmax=high)
    figure.colorbar(shown, ax=panels[2], label=f"depth [{unit}]", fraction=0.046)
    sure = panels[3].imshow(np.where(depth > 0, confidence, np.nan), cmap="magma", vmin=0, vmax=1)
    figure.colorbar(sure, ax=panels[3], label="confidence", fraction=0.046)
    titles = ("image", f"{len(sparse.depth)} sparse points", "completed depth", "confidence")
    for panel, title in zip(panels, titles, strict=True):
        panel.set_title(title, fontsize=10)
        panel.set_axis_off()
        panel.set_xlim(-0.5, rgb.shape[1] - 0.5)
        panel.set_ylim(rgb.shape[0] - 0.5, -0.5)
    return figure_png(figure)
