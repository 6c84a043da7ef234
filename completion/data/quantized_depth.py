"""Dequantization of true depth that was stored in coarse steps, by constrained diffusion.

SimCol3D stores 200 mm in 255 steps. Near the camera a step is 4 % of the depth, several times a good model's error. The
original lies within half a step of the stored value: diffusion within these bounds, but not across edges, smooths it.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from completion.data.evaluation_frame import Depth
from haustra.core.errors import CompletionError

# Each pass averages four neighbours; in an image of AT_WIDTH columns they reach about seven pixels. Chosen on rendered
# frames, of 30 to 600: from 60 on they hardly differ.
PASSES, AT_WIDTH = 100, 320
EDGE = 2.5  # steps between neighbours that are taken for an edge; so steep a wall shows no stairs either


def dequantize(depth: Depth, step: float) -> Depth:
    """Depth (H,W), 0 = none, stored in multiples of `step` in its unit -> the same smoothed, nowhere further than half
    a step from what was stored. CompletionError if the depth does not come in such steps."""
    stored = depth.astype(np.float64)
    valid = stored > 0
    if not step > 0 or np.abs(stored / step - np.round(stored / step)).max(initial=0.0) > 0.01:
        raise CompletionError(f"this depth does not come in steps of {step:g}")
    rows, columns = (_inner(stored, valid, axis, EDGE * step) for axis in (0, 1))
    weight = (rows.astype(np.float64) + columns) * 2
    smooth = stored.copy()
    for _ in range(round(PASSES * (depth.shape[1] / AT_WIDTH) ** 2)):
        total = np.where(rows, _neighbours(smooth, 0), 0) + np.where(columns, _neighbours(smooth, 1), 0)
        mean = np.divide(total, weight, out=smooth.copy(), where=weight > 0)
        smooth = np.clip(mean, stored - step / 2, stored + step / 2)
    return np.where(valid, smooth, 0).astype(np.float32)


def _inner(stored: NDArray[np.float64], valid: NDArray[np.bool_], axis: int, edge: float) -> NDArray[np.bool_]:
    """(H,W): whether a pixel and both its neighbours along an axis are of one surface. With one of them alone the mean
    would pull a slope towards it."""
    near = np.abs(np.diff(stored, axis=axis)) < edge
    known = [np.take(valid, np.arange(*span), axis) for span in ((0, valid.shape[axis] - 1), (1, valid.shape[axis]))]
    linked = near & known[0] & known[1]
    none = np.zeros_like(np.take(linked, [0], axis))
    return np.concatenate([none, linked], axis) & np.concatenate([linked, none], axis)


def _neighbours(values: NDArray[np.float64], axis: int) -> NDArray[np.float64]:
    """(H,W): sum of the two along an axis; the ends wrap round, and are never asked."""
    return np.asarray(np.roll(values, 1, axis) + np.roll(values, -1, axis))
