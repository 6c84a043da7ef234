"""Rectification of a stereo pair and its depth: OpenCV's `stereoRectify` and semi-global matching, with a check from
right to left."""

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from haustra.core.camera import Camera
from haustra.core.errors import HaustraError
from pipeline.input.stereo.rig_file import StereoRig

Picture = NDArray[np.uint8]
NEAREST_MM = 8.0  # of the wall
MATCHED_WIDTH = 640  # px; wider pictures are matched smaller
BLOCK = 5  # px, of a matched patch
EDGE = 0.2  # of the disparity, its range within a patch at an edge: patches carry the near side's over the far one
AGREE_PX = 0.5  # between left to right and right to left
REFINED_PX, REFINEMENTS = 17, 3  # window and rounds of the last refinement
FLAT = 4.0  # squared grey levels a pixel, of a window without texture: it then stays
PRECISION_PX = 0.3  # of a disparity
FEWEST_MATCHES = 30
RATIO = 0.75  # of a match's distance to the second best one's
MOST_OFF_ROW = 0.01  # of the height, in the median: rectified matches lie on one row


@dataclass(frozen=True)
class RectifiedRig:
    """camera: pinhole of the rectified left pictures. maps: of both eyes, (H,W,2) source pixels, OpenCV's."""

    camera: Camera
    maps: tuple[NDArray[np.float32], NDArray[np.float32]]
    baseline_mm: float

    @property
    def error_per_mm(self) -> float:
        """Depth's standard deviation over its square, 1/mm."""
        return PRECISION_PX / (self.camera.focal[0] * self._shrink * self.baseline_mm)

    @property
    def _shrink(self) -> float:
        return min(1.0, MATCHED_WIDTH / self.camera.width)

    def rectified(self, left: Picture, right: Picture) -> tuple[Picture, Picture]:
        """Both pictures (H,W,3), black where they show nothing."""
        pair = (cv2.remap(eye, by, None, cv2.INTER_LINEAR) for eye, by in zip((left, right), self.maps, strict=True))
        first, second = (np.asarray(eye, np.uint8) for eye in pair)
        return first, second

    def depth(self, left: Picture, right: Picture) -> NDArray[np.float64]:
        """(h,w) z-depth in mm of rectified pictures, 0 = none; h and w are those that they were matched at."""
        size = round(self._shrink * left.shape[1]), round(self._shrink * left.shape[0])
        small = [cv2.resize(eye, size, interpolation=cv2.INTER_AREA) for eye in (left, right)]
        first, second = (cv2.cvtColor(eye, cv2.COLOR_RGB2GRAY) for eye in small)
        focal = self.camera.focal[0] * self._shrink
        most = 16 * int(np.ceil(focal * self.baseline_mm / NEAREST_MM / 16))
        there = _disparity(first, second, most)
        back = _disparity(second[:, ::-1], first[:, ::-1], most)[:, ::-1]
        column = np.arange(first.shape[1])[None] - np.rint(there).astype(int)
        row = np.arange(first.shape[0])[:, None]
        agree = np.abs(back[row, np.clip(column, 0, first.shape[1] - 1)] - there) <= AGREE_PX
        known = (there > 0.5) & (column >= 0) & agree & (first > 8) & ~_at_edge(there)
        fine = _refined(first, second, there, known)
        return np.where(known & (fine > 0.5), focal * self.baseline_mm / np.maximum(fine, 0.5), 0.0)

    def check(self, pairs: list[tuple[Picture, Picture]]) -> None:
        """HaustraError, one sentence, where rectified pairs are not of this rig, or the eyes are swapped."""
        across, down = [np.zeros(0)], [np.zeros(0)]
        for left, right in pairs:
            apart = _apart(left, right)
            across.append(apart[:, 0])
            down.append(np.abs(apart[:, 1]))
        x, y = np.concatenate(across), np.concatenate(down)
        if len(x) < FEWEST_MATCHES:
            raise HaustraError(f"the two eyes show nothing in common ({len(x)} matches): is the layout right?")
        if np.median(x) < 0:
            raise HaustraError(
                f"the eyes are swapped: the left one sees things {-np.median(x):.1f} px farther left than the right one"
            )
        off = float(np.median(y))
        if off > MOST_OFF_ROW * self.camera.height:
            raise HaustraError(
                f"after rectification what the two eyes see lies {off:.1f} px off its row in the median: the stereo "
                "calibration is of another rig or size, or the layout is another one"
            )


def _apart(left: Picture, right: Picture) -> NDArray[np.float64]:
    """(K,2) px from where the right eye sees a feature to where the left one does."""
    sift = cv2.SIFT.create(nfeatures=1000, contrastThreshold=0.002, enable_precise_upscale=True)
    found = [sift.detectAndCompute(cv2.cvtColor(eye, cv2.COLOR_RGB2GRAY), None) for eye in (left, right)]
    if any(descriptors is None for _, descriptors in found):
        return np.zeros((0, 2))
    (here, first), (there, second) = found
    best = cv2.BFMatcher(cv2.NORM_L2).knnMatch(first, second, k=2)
    same = [pair[0] for pair in best if len(pair) == 2 and pair[0].distance < RATIO * pair[1].distance]
    apart = [np.subtract(here[match.queryIdx].pt, there[match.trainIdx].pt) for match in same]
    return np.array(apart, np.float64).reshape(-1, 2)


def rectify(rig: StereoRig, size: tuple[int, int]) -> RectifiedRig:
    """For pictures of one eye of size (width, height). HaustraError where the calibration is of another shape."""
    first, second = rig.first.copy(), rig.second.copy()
    if rig.size is not None and rig.size != size:
        scale = size[0] / rig.size[0]
        if abs(rig.size[1] * scale - size[1]) > 1.5:
            raise HaustraError(
                f"the stereo calibration is for {rig.size[0]}x{rig.size[1]} pixels, but one eye has {size[0]}x{size[1]}"
            )
        for matrix in (first, second):
            matrix[:2, 2] += 0.5
            matrix[:2] *= scale
            matrix[:2, 2] -= 0.5
    lenses = (first, rig.first_terms, second, rig.second_terms)
    turn1, turn2, new1, new2, *_ = cv2.stereoRectify(
        *lenses, size, rig.turn, rig.shift.reshape(3, 1), flags=cv2.CALIB_ZERO_DISPARITY, alpha=0
    )
    maps = [
        np.stack(cv2.initUndistortRectifyMap(matrix, terms, turn, new, size, cv2.CV_32FC1), axis=-1)
        for matrix, terms, turn, new in ((first, rig.first_terms, turn1, new1), (second, rig.second_terms, turn2, new2))
    ]
    params = (new1[0, 0], new1[1, 1], new1[0, 2] + 0.5, new1[1, 2] + 0.5)
    camera = Camera("PINHOLE", *size, tuple(float(value) for value in params))
    return RectifiedRig(camera, (maps[0], maps[1]), rig.baseline_mm)


def _refined(left: Picture, right: Picture, disparity: NDArray[np.float64], known: NDArray[np.bool_]) -> NDArray:
    """(H,W) disparity by least squares on grey values (Lucas and Kanade) within `REFINED_PX`, each pixel from its own:
    semi-global matching takes patches to be square to the axis, which bends oblique wall by up to 4 %."""
    first, there = left.astype(np.float32), right.astype(np.float32)
    found, weight = disparity.astype(np.float32), known.astype(np.float32)
    x, y = np.meshgrid(np.arange(found.shape[1], dtype=np.float32), np.arange(found.shape[0], dtype=np.float32))

    def summed(values: NDArray[np.float32]) -> NDArray[np.float32]:
        return np.asarray(cv2.boxFilter(weight * values, -1, (REFINED_PX, REFINED_PX), normalize=False), np.float32)

    count = np.maximum(summed(np.ones_like(found)), 1)
    for _ in range(REFINEMENTS):
        moved = cv2.remap(there, x - found, y, cv2.INTER_CUBIC)
        slope, off = cv2.Sobel(moved, cv2.CV_32F, 1, 0, ksize=3) / 8, first - moved
        mean_slope, mean_off = summed(slope) / count, summed(off) / count  # the two eyes' brightness may differ
        across = summed(slope * off) - count * mean_slope * mean_off
        square = summed(slope * slope) - count * mean_slope**2
        found += np.where(known, np.clip(-across / (square + FLAT), -0.5, 0.5), 0)
    return found.astype(np.float64)


def _at_edge(disparity: NDArray[np.float64]) -> NDArray[np.bool_]:
    """(H,W) True within a patch of a jump in disparity, on both sides."""
    window = np.ones((2 * BLOCK + 1, 2 * BLOCK + 1), np.uint8)
    values = disparity.astype(np.float32)
    lowest, highest = cv2.erode(values, window), cv2.dilate(values, window)
    return np.asarray(highest - lowest > EDGE * np.maximum(values, 1.0))


def _disparity(left: Picture, right: Picture, most: int) -> NDArray[np.float64]:
    """(H,W) px, negative where there is none; padded, so that the left border is matched too."""
    matcher = cv2.StereoSGBM.create(
        minDisparity=0,
        numDisparities=most,
        blockSize=BLOCK,
        P1=8 * BLOCK**2,
        P2=32 * BLOCK**2,
        uniquenessRatio=10,
        speckleWindowSize=150,
        speckleRange=1,
        mode=cv2.STEREO_SGBM_MODE_HH,
    )
    padded = [
        cv2.copyMakeBorder(np.ascontiguousarray(eye), 0, 0, most, 0, cv2.BORDER_CONSTANT) for eye in (left, right)
    ]
    return np.asarray(matcher.compute(*padded)[:, most:] / 16.0, np.float64)
