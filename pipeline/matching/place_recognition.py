"""Place recognition: similarity of pictures by VLAD over visual words learned from the video itself.

VLAD (Jegou et al., CVPR 2010) sums, for each visual word, how the picture's descriptors deviate from it. The words are
learnt from the video itself, so no vocabulary file is needed. Only candidates: geometry must confirm each.
"""

from collections.abc import Sequence
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from pipeline.matching.keyframe_features import MIN_FEATURES, KeyframeFeatures
from pipeline.matching.sift import rootsift

WORDS = 32
SAMPLE = 20_000  # descriptors from which the words are learnt

Pair = tuple[int, int]


def learn_visual_words(descriptors: NDArray[np.float32], seed: int) -> NDArray[np.float32]:
    """(WORDS,128) k-means centres of a sample of descriptors (N,128)."""
    descriptors = _sample(descriptors, seed)
    cv2.setRNGSeed(seed + 1)
    criteria = (cv2.TERM_CRITERIA_MAX_ITER, 15, 0.0)
    return cv2.kmeans(descriptors, WORDS, None, criteria, 1, cv2.KMEANS_PP_CENTERS)[2]


def _sample(descriptors: NDArray[Any], seed: int) -> NDArray[Any]:
    if len(descriptors) <= SAMPLE:
        return descriptors
    chosen = np.random.default_rng(seed).choice(len(descriptors), SAMPLE, replace=False)
    return descriptors[np.sort(chosen)]


def vlad(descriptors: NDArray[np.float32], visual_words: NDArray[np.float32]) -> NDArray[np.float32]:
    """Signature (WORDS*128,) of unit length, by signed square root; zero for a picture without features."""
    signature = np.zeros_like(visual_words)
    if len(descriptors):
        distance = (visual_words * visual_words).sum(1)[None] - 2 * descriptors @ visual_words.T
        nearest = distance.argmin(axis=1)
        np.add.at(signature, nearest, descriptors - visual_words[nearest])
    flat = (np.sign(signature) * np.sqrt(np.abs(signature))).ravel()
    return (flat / max(float(np.linalg.norm(flat)), 1e-12)).astype(np.float32)


class VisualWords:
    """Words that pictures share, and each keyframe's signature by them, computed once.

    Learn them of everything that will be compared: of each pair of submaps anew, they take longer than the comparison.
    """

    def __init__(self, centres: NDArray[np.float32] | None) -> None:
        self._centres = centres  # (WORDS,128); None where there were too few descriptors to learn from
        self._known: dict[int, tuple[NDArray[np.uint8], NDArray[np.float32]]] = {}  # the first keeps its number taken

    @staticmethod
    def of(keyframes: Sequence[KeyframeFeatures], seed: int) -> "VisualWords":
        """Learnt from keyframes' descriptors."""
        stacked = np.concatenate([features.descriptors for features in keyframes] or [np.zeros((0, 128), np.uint8)])
        if len(stacked) < WORDS:
            return VisualWords(None)
        # RootSIFT takes four times the bytes: of the sample here, of one keyframe at a time below.
        return VisualWords(learn_visual_words(rootsift(_sample(stacked, seed)), seed))

    def similarities(
        self, first: Sequence[KeyframeFeatures], second: Sequence[KeyframeFeatures]
    ) -> NDArray[np.float32]:
        """(F,S) cosine of the keyframes' signatures; minus infinity where one has too few features."""
        if not first or not second or self._centres is None:
            return np.full((len(first), len(second)), -np.inf, np.float32)
        one, other = (np.stack([self._signature(features) for features in side]) for side in (first, second))
        enough = [np.array([len(features) >= MIN_FEATURES for features in side]) for side in (first, second)]
        return np.where(enough[0][:, None] & enough[1], one @ other.T, -np.inf).astype(np.float32)

    def _signature(self, features: KeyframeFeatures) -> NDArray[np.float32]:
        number = id(features.descriptors)  # keyframes are renumbered when maps are merged; their descriptors stay
        if number not in self._known:
            assert self._centres is not None
            self._known[number] = features.descriptors, vlad(features.rootsift, self._centres)
        return self._known[number][1]


def retrieve(similarity: NDArray[np.float32], per_row: int) -> list[Pair]:
    """Row and column of the `per_row` most similar columns of each row, most similar first; none at minus infinity."""
    order = np.argsort(-similarity, axis=1, kind="stable")[:, :per_row]
    pairs = [(float(-similarity[i, j]), i, int(j)) for i in range(len(order)) for j in order[i]]
    return [(i, j) for value, i, j in sorted(pairs) if np.isfinite(value)]


def retrieve_within(similarity: NDArray[np.float32], per_row: int) -> list[Pair]:
    """`retrieve` within one list: each pair once, the smaller number first, in ascending order."""
    return sorted({(min(pair), max(pair)) for pair in retrieve(similarity, per_row)})


def loop_pairs(descriptors: list[NDArray], stride: int, neighbours: int, min_gap: int, seed: int) -> list[Pair]:
    """Pairs (earlier, later) of frame rows at least `min_gap` apart; every `stride`-th frame proposes `neighbours`.

    descriptors: one (n_i, 128) array per frame.
    """
    if neighbours == 0 or len(descriptors) <= min_gap:
        return []
    stacked = [d.astype(np.float32) for d in descriptors]
    if sum(len(d) for d in stacked) < 2 * WORDS:
        return []
    visual_words = learn_visual_words(np.concatenate(stacked), seed)
    signatures = np.stack([vlad(d, visual_words) for d in stacked])
    pairs = set()
    for row in range(0, len(signatures), stride):
        similarity = signatures @ signatures[row]
        similarity[max(0, row - min_gap + 1) : row + min_gap] = -np.inf
        best = np.argsort(-similarity, kind="stable")[:neighbours]
        pairs |= {(min(row, int(b)), max(row, int(b))) for b in best if np.isfinite(similarity[b])}
    return sorted(pairs)
