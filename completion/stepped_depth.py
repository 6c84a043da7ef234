"""True depth that was stored in coarse steps, brought back to the smooth surface that it was rounded from.

SimCol3D stores 200 mm in 255 steps. A step is 4 % of what is near, several times a good model's error there, so that
judged by such depth every model looks alike. What was rounded lies within half a step of what is stored: inside these
bounds, and not across edges, diffusion flattens the stairs.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from completion.errors import CompletionError
from completion.frames import Depth

# Each pass averages four neighbours; in a picture of `AT_WIDTH` columns PASSES of them reach about seven pixels. Chosen
# on rendered frames, of 30, 100 and 300: few leave wide stairs, many pull curved wall flat until it meets the bounds.
PASSES, AT_WIDTH = 100, 320
EDGE = 2.5  # steps between neighbours that are taken for an edge; so steep a wall shows no stairs either


def without_steps(depth: Depth, step: float) -> Depth:
    """Depth (H,W), 0 = none, stored in multiples of `step` in its unit -> the same smoothed, nowhere further than half
    a step from what was stored. CompletionError if the depth does not come in such steps."""
    stored = depth.astype(np.float64)
    valid = stored > 0
    if not step > 0 or np.abs(stored / step - np.round(stored / step)).max(initial=0.0) > 0.01:
        raise CompletionError(f"this depth does not come in steps of {step:g}")
    across, down = (_linked(stored, valid, axis, EDGE * step) for axis in (1, 0))
    links = _sum_of_neighbours(np.ones_like(stored), across, down)
    smooth = stored.copy()
    for _ in range(round(PASSES * (depth.shape[1] / AT_WIDTH) ** 2)):
        mean = np.divide(_sum_of_neighbours(smooth, across, down), links, out=smooth.copy(), where=links > 0)
        smooth = np.clip(mean, stored - step / 2, stored + step / 2)
    return np.where(valid, smooth, 0).astype(np.float32)


def _linked(stored: NDArray[np.float64], valid: NDArray[np.bool_], axis: int, edge: float) -> NDArray[np.float64]:
    """1 where neighbours along an axis belong to one surface, else 0; one shorter along that axis."""
    near = np.abs(np.diff(stored, axis=axis)) < edge
    both = np.diff(valid.astype(np.int8), axis=axis) == 0
    here = valid[:, 1:] if axis == 1 else valid[1:]
    return (near & both & here).astype(np.float64)


def _sum_of_neighbours(
    values: NDArray[np.float64], across: NDArray[np.float64], down: NDArray[np.float64]
) -> NDArray[np.float64]:
    """(H,W): of each pixel's linked neighbours."""
    total = np.zeros_like(values)
    total[:, 1:] += across * values[:, :-1]
    total[:, :-1] += across * values[:, 1:]
    total[1:] += down * values[:-1]
    total[:-1] += down * values[1:]
    return total
