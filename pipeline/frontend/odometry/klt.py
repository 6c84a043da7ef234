"""KLT tracking of corners, in images whose illumination was normalised.

Lucas-Kanade assumes that a patch keeps its grey values, but the lamp moves with the camera: a patch that comes twice as
near becomes four times as bright. The logarithm turns that factor into an offset, the local mean takes the offset away,
and the local spread evens out what is left of exposure and gamma.
"""

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from haustra.core.threads import side_by_side

Pixels = NDArray[np.float32]  # (N,2), COLMAP's convention unless named otherwise

WINDOW = 15  # px at 320 px width; scaled with the image
LEVELS, ITERATIONS = 3, 20  # halvings of the image, and steps in each, of a search from where the point was
NEAR_LEVELS, NEAR_ITERATIONS = 1, 10  # from where it should be; coarser windows reach beyond the mask and lose points
LOCAL_SHARE = 0.05  # of the width: half the side of the surroundings that are evened out
FLOOR = 0.02  # of the logarithm; where the wall varies less than 2 %, noise must not become texture
CONTRAST = 42.0  # grey levels for one local standard deviation
MAX_RETURN_PX = 0.7  # forward-backward error; beyond it the patch was lost on the way
BORDER = 5  # px from the edge of the mask at which windows still lie mostly inside
HALVES, MANY = 2, 50  # points that are worth a second thread: OpenCV lets go of the interpreter
MIN_CORNER = 5e-4  # smallest eigenvalue of the structure tensor, of normalised images


def normalise(rgb: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """(H,W,3) uint8 -> (H,W) uint8 around 128: log, less its local mean, over its local spread."""
    grey = cv2.cvtColor(rgb, cv2.COLOR_RGB2GRAY).astype(np.float32)
    log = cv2.log(grey + 4.0)  # 4 grey levels: below them the sensor's noise is all there is
    size = 2 * round(LOCAL_SHARE * rgb.shape[1]) + 1
    mean = cv2.blur(log, (size, size))
    high = log - mean
    spread = cv2.sqrt(cv2.blur(high * high, (size, size))) + FLOOR
    # Clipped before it is rounded: the conversion takes absolute values and would fold deep shadow up to grey.
    return cv2.convertScaleAbs(np.maximum(high * (CONTRAST / spread) + 128.0, 0.0))


@dataclass(frozen=True)
class TrackerImage:
    """One frame as the tracker sees it. image: (H,W) uint8, normalised; mask: (H,W), nonzero where windows fit."""

    image: NDArray[np.uint8]
    mask: NDArray[np.uint8]


def tracker_image(rgb: NDArray[np.uint8], mask: NDArray[np.uint8]) -> TrackerImage:
    """mask: (H,W), nonzero where features may lie; it is shrunk by a border."""
    framed = cv2.copyMakeBorder(mask, 1, 1, 1, 1, cv2.BORDER_CONSTANT, value=0)
    inner = cv2.erode(framed, np.ones((2 * BORDER + 1, 2 * BORDER + 1), np.uint8))[1:-1, 1:-1]
    return TrackerImage(normalise(rgb), inner)


def _window(image: NDArray[np.uint8]) -> tuple[int, int]:
    size = max(11, round(WINDOW * image.shape[1] / 320) | 1)
    return size, size


def track_klt(
    reference: TrackerImage, current: TrackerImage, places: Pixels, guess: Pixels, near: bool = False
) -> tuple[Pixels, NDArray[np.bool_]]:
    """Where points at `places` of the reference are now, searched from `guess`, within some pixels if it is `near`; and
    which of them came back to where they started, within the mask."""
    if len(places) == 0:
        return places.copy(), np.zeros(0, dtype=bool)
    if len(places) < MANY:
        return _track(reference, current, places, guess, near)
    halves = zip(np.array_split(places, HALVES), np.array_split(guess, HALVES), strict=True)
    found = side_by_side(lambda half: _track(reference, current, *half, near), list(halves))
    return np.concatenate([pixels for pixels, _ in found]), np.concatenate([back for _, back in found])


def _track(
    reference: TrackerImage, current: TrackerImage, places: Pixels, guess: Pixels, near: bool
) -> tuple[Pixels, NDArray[np.bool_]]:
    """`track_klt` of one point and more, in the thread that calls it."""
    start = (places - 0.5).astype(np.float32)
    window = _window(reference.image)
    guessed = (guess - 0.5).astype(np.float32)
    levels, steps = (NEAR_LEVELS, NEAR_ITERATIONS) if near else (LEVELS, ITERATIONS)
    ahead, there = _flow(reference, current, start, guessed, window, levels, steps)
    # The way back begins at its goal. It is the coarse images that say no to a false match.
    back, here = _flow(current, reference, ahead, start.copy(), window, LEVELS, steps)
    returned = np.linalg.norm(back - start, axis=1) < MAX_RETURN_PX
    found = (there.ravel() > 0) & (here.ravel() > 0) & returned & inside(current.mask, ahead + 0.5)
    return ahead + 0.5, found


def _flow(
    reference: TrackerImage,
    current: TrackerImage,
    places: Pixels,
    guess: Pixels,
    window: tuple[int, int],
    levels: int,
    steps: int,
) -> tuple[Pixels, NDArray[np.uint8]]:
    """Pyramidal Lucas-Kanade in OpenCV's integer-centre pixels."""
    moved, status, _ = cv2.calcOpticalFlowPyrLK(
        reference.image,
        current.image,
        places,
        guess,
        winSize=window,
        maxLevel=levels,
        criteria=(cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_COUNT, steps, 0.01),
        flags=cv2.OPTFLOW_USE_INITIAL_FLOW,
        minEigThreshold=1e-4,
    )
    return moved, status


def inside(mask: NDArray[np.uint8], pixels: Pixels) -> NDArray[np.bool_]:
    """(N,) whether each pixel lies in the image and on the mask."""
    height, width = mask.shape
    finite: NDArray[np.bool_] = np.asarray(np.isfinite(pixels).all(axis=1))
    x, y = np.floor(np.where(finite[:, None], pixels, -1)).astype(int).T
    within = finite & (x >= 0) & (y >= 0) & (x < width) & (y < height)
    return within & (mask[y.clip(0, height - 1), x.clip(0, width - 1)] > 0)


def detect(view: TrackerImage, occupied: Pixels, cell: int) -> Pixels:
    """New corners, one for each empty cell of a grid: the best there, if it is a corner at all.

    A grid rather than the strongest corners of the image: those crowd on vessels and highlights' rims, and poses need
    points all around.
    """
    strength = cv2.cornerMinEigenVal(view.image, 5, ksize=3)
    strength[view.mask == 0] = 0
    padded = in_whole_cells(strength, cell)
    rows, columns = padded.shape[0] // cell, padded.shape[1] // cell
    cells = padded.reshape(rows, cell, columns, cell).transpose(0, 2, 1, 3).reshape(rows * columns, cell * cell)
    best = cells.argmax(axis=1)
    value = cells[np.arange(len(cells)), best]
    x = np.arange(rows * columns) % columns * cell + best % cell
    y = np.arange(rows * columns) // columns * cell + best // cell
    found = np.stack([x, y], axis=1)[value > MIN_CORNER].astype(np.float32) + 0.5
    return found[_is_apart(found, occupied, 0.7 * cell, strength.shape)]


def in_whole_cells(image: NDArray[Any], cell: int) -> NDArray[Any]:
    """The image (H,W), with zeros to the right and below up to whole cells of so many pixels a side."""
    return np.pad(image, [(0, -length % cell) for length in image.shape])


def _is_apart(found: Pixels, occupied: Pixels, distance: float, shape: tuple[int, ...]) -> NDArray[np.bool_]:
    """Which of `found` keep their distance from all of `occupied`."""
    taken = np.zeros(shape, dtype=np.uint8)
    for x, y in np.floor(occupied).astype(int):
        cv2.circle(taken, (int(x), int(y)), round(distance), 255, -1)
    x, y = np.floor(found).astype(int).T
    return taken[y, x] == 0
