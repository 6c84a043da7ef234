"""Rectification of a stereo pair and its depth: OpenCV's `stereoRectify` and dense inverse search (Kroeger et al., ECCV
2016), with a check from right to left."""

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from haustra.core.camera import Camera
from haustra.core.errors import HaustraError
from pipeline.input.calibration import FARTHEST_CENTRE, MOST_FOCAL_RATIO, refuse_impossible
from pipeline.input.stereo.rig_file import StereoRig

Picture = NDArray[np.uint8]
NEAREST_MM = 8.0  # of the wall
MATCHED_WIDTH = 640  # px; wider pictures are matched smaller
RIM = 5  # px around a jump in disparity
EDGE = 0.2  # of the disparity, its range within a patch at an edge: patches carry the near side's over the far one
AGREE_PX = 0.5  # between left to right and right to left
MOST_DOWN_PX = 1.0  # off the row; rectified matches lie on one
LEAST_PX = 0.5  # of a disparity
DARK = 8  # grey level up to which nothing is matched
SMOOTHING = 2  # iterations; OpenCV's 5 bring near and far wall 0.05 px closer to each other, none leaves more holes
PRECISION_PX = 0.3  # of a disparity
FEWEST_MATCHES = 30
RATIO = 0.75  # of a match's distance to the second best one's
MOST_EYE_RATIO = 2 * MOST_FOCAL_RATIO  # of focal lengths: films of two eyes may keep each at half its width
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
        there, back = _flows(first, second)
        x, y = np.meshgrid(np.arange(size[0], dtype=np.float32), np.arange(size[1], dtype=np.float32))
        met = x + there[..., 0]
        returned = cv2.remap(back, met, y + there[..., 1], cv2.INTER_LINEAR)[..., 0]
        disparity = -there[..., 0].astype(np.float64)
        known = (disparity > LEAST_PX) & (met >= 0) & (first > DARK) & ~_at_edge(disparity)
        known &= (np.abs(there[..., 0] + returned) <= AGREE_PX) & (np.abs(there[..., 1]) <= MOST_DOWN_PX)
        focal = self.camera.focal[0] * self._shrink
        depth = focal * self.baseline_mm / np.maximum(disparity, LEAST_PX)
        return np.where(known & (depth >= NEAREST_MM), depth, 0.0)

    def check(self, pairs: list[tuple[Picture, Picture]]) -> None:
        """HaustraError, one sentence, where rectified pairs are not of this rig, or the eyes are swapped."""
        across, down = [np.zeros(0)], [np.zeros(0)]
        for left, right in pairs:
            apart = _apart(left, right)
            across.append(apart[:, 0])
            down.append(np.abs(apart[:, 1]))
        x, y = np.concatenate(across), np.concatenate(down)
        if len(x) < FEWEST_MATCHES:
            raise HaustraError(
                f"the two eyes show nothing in common ({len(x)} matches): is the layout right? A film of one eye is "
                "taken without --stereo"
            )
        if abs(np.median(x)) < LEAST_PX:
            raise HaustraError(
                f"the two eyes see things in the same place (within {abs(np.median(x)):.1f} px in the median), which "
                "shows no depth: is one eye's film given twice, or was the film recorded in 2D?"
            )
        if np.median(x) < 0:
            raise HaustraError(
                f"the left eye sees things {-np.median(x):.1f} px farther left than the right one: the eyes are "
                "swapped in the film, or the calibration has the second eye's place for the first's"
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
    if rig.size is None:
        for x, y in (first[:2, 2], second[:2, 2]):
            if max(abs(x / size[0] - 0.5), abs(y / size[1] - 0.5)) > FARTHEST_CENTRE:
                raise HaustraError(
                    f"the stereo calibration names no picture size, and its centre ({x:.0f}, {y:.0f}) is not that of "
                    f"one eye's {size[0]}x{size[1]} pixels: write image_width and image_height into it"
                )
    if rig.size is not None and rig.size != size:
        scale = size[0] / rig.size[0]
        if abs(rig.size[1] * scale - size[1]) > 1.5:
            raise HaustraError(
                f"the stereo calibration is for {rig.size[0]}x{rig.size[1]} pixels, but one eye has {size[0]}x{size[1]}"
                ": is --stereo-layout right? If it is, calibrate at this size"
            )
        for matrix in (first, second):
            matrix[:2, 2] += 0.5
            matrix[:2] *= scale
            matrix[:2, 2] -= 0.5
    for name, matrix, terms in (("first", first, rig.first_terms), ("second", second, rig.second_terms)):
        _check_eye(name, matrix, terms, size)
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


def _check_eye(name: str, matrix: NDArray[np.float64], terms: NDArray[np.float64], size: tuple[int, int]) -> None:
    """HaustraError for the lens of one eye that cannot be of its pictures; OpenCV's terms beyond eight are small."""
    (fx, _, cx), (_, fy, cy) = matrix[:2]
    distortion = np.zeros(8)
    distortion[: len(terms)] = terms[:8]
    eye = Camera("FULL_OPENCV", *size, tuple(map(float, (fx, fy, cx + 0.5, cy + 0.5, *distortion))))
    refuse_impossible(eye, f"the stereo calibration's {name} camera", MOST_EYE_RATIO)


def _flows(left: Picture, right: Picture) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """(H,W,2) px from each pixel of the left grey picture to where the right one shows it, and back. In one thread: the
    search goes in as many stripes as there are threads, which shows in the result."""
    threads = cv2.getNumThreads()
    cv2.setNumThreads(1)
    try:
        search = cv2.DISOpticalFlow.create(cv2.DISOPTICAL_FLOW_PRESET_MEDIUM)
        search.setFinestScale(0)
        search.setVariationalRefinementIterations(SMOOTHING)
        eyes = np.ascontiguousarray(left), np.ascontiguousarray(right)
        nothing: Any = None
        found = search.calc(*eyes, nothing), search.calc(*eyes[::-1], nothing)
    finally:
        cv2.setNumThreads(threads)
    there, back = (np.asarray(flow, np.float32) for flow in found)
    return there, back


def _at_edge(disparity: NDArray[np.float64]) -> NDArray[np.bool_]:
    """(H,W) True within a patch of a jump in disparity, on both sides."""
    window = np.ones((2 * RIM + 1, 2 * RIM + 1), np.uint8)
    values = disparity.astype(np.float32)
    lowest, highest = cv2.erode(values, window), cv2.dilate(values, window)
    return np.asarray(highest - lowest > EDGE * np.maximum(values, 1.0))
