"""Whether a sensor gives the distance along each pixel's ray in place of the depth along the camera's axis.

The two differ by the cosine of the ray's angle to the axis: by nothing in the middle of the picture, by half at 60
degrees. Ratios of the sensor's depth and the map's then grow towards the border, in every frame alike. A map that was
adjusted by the sensor has bent to it, so that maps are asked before. Other errors grow towards the border as well:
a focal length that is too short, and, since the wall of a tube is nearest there, a constant length that is added.
"""

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
FEWEST, FEWEST_IN_FRAME = 30, 8  # ratios for a scale, and of a frame that counts for the disagreement
FEWEST_TO_TELL = 300  # ratios in frames that count, for a sentence on what the values are
# What the disagreement must fall to, if the sensor's values are taken for distances. Chosen on d_0.0 and e_0.0 of
# living_choosing.yaml, 4 s of each, sensors of 3 % noise: depth along the axis rises to 1.9 and 2.3 times, distances
# fall to 0.57 and 0.72; depth through a lens that is 15 % too short falls to 0.67 and 0.80.
BETTER = 0.8


def doubt_of_axis(log_ratio: Array, log_slant: Array, frame: NDArray[np.int64]) -> str:
    """A sentence where the values of a sensor fit a map clearly better as distances along the rays; empty otherwise.

    log_ratio (K,): of the sensor's value over the map's depth; log_slant (K,): of the map's distance along the ray over
    its depth along the axis; frame (K,): a number or row of the frame of each."""
    _, of_frame, often = np.unique(frame, return_inverse=True, return_counts=True)
    if (often[of_frame] >= FEWEST_IN_FRAME).sum() < FEWEST_TO_TELL:
        return ""
    along_axis, _ = within_frames(log_ratio, frame)
    along_ray, _ = within_frames(log_ratio - log_slant, frame)
    if along_ray >= BETTER * along_axis:
        return ""
    return (
        "do not trust depth and lengths: the sensor's values fit the pictures' geometry better as distances along each "
        f"pixel's ray than as depth along the camera's axis (within a frame the two differ by {100 * along_ray:.1f} % "
        f"in the median instead of {100 * along_axis:.1f} %): if the sensor gives such distances, multiply each by the "
        "cosine of its ray's angle to the axis; if not, check that no constant length is added to its depth, and that "
        "the camera's focal length is not too short"
    )


def within_frames(log_ratio: Array, frame: NDArray[np.int64]) -> tuple[float, Array]:
    """Median absolute deviation of (K,) from each frame's median, and those medians, of frames with enough of them."""
    medians, off = [], [np.zeros(0)]
    for one in np.unique(frame):
        mine = log_ratio[frame == one]
        if len(mine) >= FEWEST_IN_FRAME:
            medians.append(float(np.median(mine)))
            off.append(np.abs(mine - medians[-1]))
    every = np.concatenate(off)
    return (float(np.median(every)) if len(every) else 0.0), np.array(medians or [0.0])
