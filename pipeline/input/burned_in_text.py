"""Text and marks that a processor burns into the picture: fixed to the image, they would say that nothing moves.

Burned in is what shows fine detail of high contrast in nearly every frame, and in the median of all frames too: tissue
moves on, so that its detail averages out; digits that change keep some strokes in common. Corners that a tracker finds
there stand still, and where the tissue fades from view, as in a red-out, they are all that is left to follow.

A line of text is found, a lone letter or the outline of a box is not. An instrument that never moves is taken for text.
"""

from collections.abc import Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

from haustra.core.threads import prefetched, workers

FEWEST_FRAMES = 6  # among which something moves
LOOKED_AT = 640  # px, longer side
# Shares of the picture's shorter side:
STROKE = 0.03  # a median over this leaves no letter standing
REACH = 0.01  # detail this near counts, as one digit's strokes are not another's
LETTER = 0.04  # a line of text and its gaps
LINE = 0.1  # from a letter's place to the next: what is fainter there belongs to the same line
MARGIN = 0.01  # around what was found: compression rings there
BORDER_LEVEL = 24  # grey levels; video black is 16, JPEG ringing adds a few
CONTRAST = 30  # grey levels of any channel; most vessels have less
ALWAYS = 0.75  # share of the frames; the rest may be title cards
DENSE = 0.3  # share of a letter's square that its strokes fill; the edge of the lit disc fills a tenth
MOST = 0.25  # share of what is lit; more is no text
LEAST_CHANGE = 0.03  # of the brightness, of half of what is lit: in a view that stays, nothing is told from tissue


def find_overlay(frames: Sequence[NDArray[np.uint8]]) -> NDArray[np.bool_]:
    """(H,W): where frames (H,W,3) uint8 RGB, taken from all over a video, have text or marks burned in."""
    height, width = frames[0].shape[:2]
    nothing = np.zeros((height, width), bool)
    if len(frames) < FEWEST_FRAMES:
        return nothing
    share = min(1.0, LOOKED_AT / max(height, width))
    size = max(1, round(width * share)), max(1, round(height * share))
    small = [cv2.resize(frame, size, interpolation=cv2.INTER_AREA) for frame in frames]
    side = min(size)
    reach, letter = _disc(REACH * side), 2 * round(LETTER * side / 2) + 1
    details = list(prefetched(_fine_detail, small, workers(), workers()))
    always = np.mean([cv2.dilate(detail, reach) for detail in details], axis=0) >= ALWAYS
    still = always & (cv2.dilate(_fine_detail(np.median(small, axis=0).astype(np.uint8)), reach) > 0)
    strokes = cv2.boxFilter(np.mean(details, axis=0, dtype=np.float32), -1, (letter, letter))
    near_letters = cv2.dilate((still & (strokes > DENSE)).astype(np.uint8), _disc(LINE * side)) > 0
    found = cv2.dilate((still & near_letters).astype(np.uint8), _disc(letter / 2 + MARGIN * side))
    if not _stands_out(small, found > 0):
        return nothing
    return cv2.resize(found, (width, height), interpolation=cv2.INTER_NEAREST) > 0


def _stands_out(frames: Sequence[NDArray[np.uint8]], found: NDArray[np.bool_]) -> bool:
    """Whether little of the lit picture was found, and the rest changes over the frames, between their tenth and
    ninetieth percentiles; neither noise nor a lamp that flickers is a change."""
    green = np.array([cv2.blur(frame[..., 1], (5, 5)) for frame in frames], np.float32)
    lit = np.median(green, axis=0) > BORDER_LEVEL
    rest = lit & ~found
    if not rest.any() or (found & lit).sum() > MOST * lit.sum():
        return False
    seen = green[:, rest]
    low, high = np.percentile(seen / np.maximum(seen.mean(axis=1, keepdims=True), 1), (10, 90), axis=0)
    return float(np.median(high - low)) >= LEAST_CHANGE


def _fine_detail(rgb: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """1 where any channel (H,W,3) stands out from its surroundings by the contrast of a letter."""
    window = min(max(5, round(STROKE * min(rgb.shape[:2])) | 1), 255)
    off = cv2.absdiff(rgb, cv2.medianBlur(rgb, window))
    return (np.maximum.reduce(cv2.split(off)) > CONTRAST).astype(np.uint8)


def _disc(radius: float) -> NDArray[np.uint8]:
    side = 2 * max(1, round(radius)) + 1
    return cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (side, side)).astype(np.uint8)
