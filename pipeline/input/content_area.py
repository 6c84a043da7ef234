"""Where a frame shows tissue: the lit disc or octagon of the endoscope, less the lamp's mirror images.

The area is found once per video from the (nearly) brightest value that each pixel takes over many frames, since a
dark lumen moves and the black border does not. What the processor burned in, beside the picture or over it, is cut out.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from haustra.core.errors import HaustraError
from pipeline.input.burned_in_text import BORDER_LEVEL, find_overlay

MIN_CONTENT = 0.05  # share of the frame; less is a lit label, not a picture
CORNER = 0.06  # of the shorter side: squares in the corners that are looked at
FULLER_THAN_A_DISC = 0.8  # share of the box; a disc has 0.785, the octagons of two real colonoscopes 0.90 and 0.92
LEAST_PART = 0.01  # of the picture: smaller ones, cut off by text, are leftovers of its letters


@dataclass(frozen=True)
class ContentArea:
    """mask: (H,W) uint8, 255 = tissue, in source pixels; box: x0, y0, width, height around it; lit: (H,W), nonzero
    where the frames that it was found by are ever lit, tissue or not."""

    mask: NDArray[np.uint8]
    box: tuple[int, int, int, int]
    lit: NDArray[np.uint8]


def find_content(frames: Sequence[NDArray[np.uint8]]) -> ContentArea:
    """Content area of frames (H,W,3) uint8 RGB; raises `HaustraError` when all of them are black."""
    values = np.array([cv2.blur(np.maximum.reduce(cv2.split(rgb)), (5, 5)) for rgb in frames])
    if len(values) == 0:
        raise HaustraError("the video holds no frames")
    # The third brightest of many: a title card or two must not light the border.
    rank = min(2, len(values) // 4)
    brightest = np.partition(values, len(values) - 1 - rank, axis=0)[len(values) - 1 - rank]
    lit = (brightest > BORDER_LEVEL).astype(np.uint8)
    largest = _pieces(lit, MIN_CONTENT * lit.size)[:1]
    if not largest:
        raise HaustraError("the video is black: no part of the frame is ever lit")
    overlay = find_overlay(frames)
    # Text beside the picture would draw the hull over the border; text across it parts the picture in two.
    parts = _pieces(np.where(overlay, 0, largest[0]), LEAST_PART * np.count_nonzero(largest[0]))
    area = _area_of(_tidy(parts or largest), lit)
    return replace(area, mask=np.where(overlay, 0, area.mask).astype(np.uint8))


def _pieces(lit: NDArray[np.uint8], least: float) -> list[NDArray[np.uint8]]:
    """Connected parts (H,W) of at least so many pixels, the largest first."""
    _, labels, stats, _ = cv2.connectedComponentsWithStats(lit)
    sizes = stats[1:, cv2.CC_STAT_AREA]
    return [(labels == 1 + k).astype(np.uint8) for k in np.argsort(-sizes, kind="stable") if sizes[k] >= least]


def _tidy(parts: list[NDArray[np.uint8]]) -> NDArray[np.uint8]:
    """Cut thin attachments, fill to the convex hull of all parts, step inside the blurred rim."""
    height, width = parts[0].shape
    size = max(3, round(0.02 * min(height, width)) | 1)
    kernel = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (size, size))
    outlines = [outline for part in parts for outline in _outline(part, kernel)]
    if not outlines:
        return parts[0] * 255
    hull = cv2.convexHull(np.concatenate(outlines))
    filled = cv2.fillConvexPoly(np.zeros_like(parts[0]), hull, 255)
    if (filled > 0).mean() > 0.98:
        return np.full_like(parts[0], 255)
    # Many endoscopes draw a bright rim, fixed to the image: its features would say that nothing moves. Eroding pads
    # with "lit", so that an edge that is the frame's own edge stays.
    return cv2.erode(filled, kernel, iterations=2)


def _outline(part: NDArray[np.uint8], kernel: NDArray[np.uint8]) -> list[NDArray[np.int32]]:
    """The longest outline of what is wider than the kernel; none where nothing is."""
    height, width = part.shape
    size = len(kernel)
    padded = cv2.copyMakeBorder(part, size, size, size, size, cv2.BORDER_REPLICATE)
    opened = cv2.morphologyEx(padded, cv2.MORPH_OPEN, kernel)[size : size + height, size : size + width]
    contours, _ = cv2.findContours(opened, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    return [max(contours, key=cv2.contourArea)] if contours else []


def _area_of(mask: NDArray[np.uint8], lit: NDArray[np.uint8]) -> ContentArea:
    x, y, width, height = cv2.boundingRect(mask)
    return ContentArea(mask, (int(x), int(y), int(width), int(height)), lit)


def has_cut_corners(area: ContentArea) -> bool:
    """Whether the content is a rectangle without its corners, as colonoscopes' processors show it: neither a whole
    rectangle, as of a crop or a rigid endoscope's inner part, nor a disc, as of a rigid endoscope."""
    x, y, width, height = area.box
    shown = area.mask[y : y + height, x : x + width] > 0
    side = max(1, round(CORNER * min(width, height)))
    corners = (shown[:side, :side], shown[:side, -side:], shown[-side:, :side], shown[-side:, -side:])
    dark = sum(corner.mean() < 0.5 for corner in corners)
    return dark >= 3 and shown.mean() > FULLER_THAN_A_DISC  # a fourth may lie under burned-in text, or be left


def highlight_mask(rgb: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """255 where the lamp is mirrored or the sensor is burnt out: features there move with the camera.

    rgb: (H,W,3) uint8 -> (H,W) uint8. Burnt-out pixels, and small spots far brighter than their surroundings and
    pale, each with a margin.
    """
    channels = cv2.split(rgb)  # NumPy's min and max over an axis of three take twelve times as long
    smallest = np.minimum.reduce(channels)
    size = max(5, round(0.06 * rgb.shape[1]) | 1)
    surroundings = cv2.medianBlur(smallest, min(size, 255))
    spot = (smallest.astype(np.int16) - surroundings > 40) & (smallest > 140)
    burnt = (np.maximum.reduce(channels) >= 252) & (smallest >= 235)
    return cv2.dilate((spot | burnt).astype(np.uint8) * 255, np.ones((5, 5), np.uint8))
