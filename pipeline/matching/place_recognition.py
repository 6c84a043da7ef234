"""Which far-apart frames may show the same place: VLAD over the video's own SIFT descriptors.

VLAD (Jegou et al., CVPR 2010) sums, for each visual word, how the image's descriptors deviate from it. The words are
learnt from the video itself, so no vocabulary file is needed. Only candidates: matching must confirm each.
"""

import cv2
import numpy as np
from numpy.typing import NDArray

WORDS = 32
SAMPLE = 20_000  # descriptors from which the words are learnt


def loop_pairs(
    descriptors: list[NDArray], stride: int, neighbours: int, min_gap: int, seed: int
) -> list[tuple[int, int]]:
    """Pairs (earlier, later) of frame rows at least `min_gap` apart; every `stride`-th frame proposes `neighbours`.

    descriptors: one (n_i, 128) array per frame.
    """
    if neighbours == 0 or len(descriptors) <= min_gap:
        return []
    stacked = [d.astype(np.float32) for d in descriptors]
    if sum(len(d) for d in stacked) < 2 * WORDS:
        return []
    words = _learn_words(np.concatenate(stacked), seed)
    signatures = np.stack([vlad(d, words) for d in stacked])
    pairs = set()
    for row in range(0, len(signatures), stride):
        similarity = signatures @ signatures[row]
        similarity[max(0, row - min_gap + 1) : row + min_gap] = -np.inf
        best = np.argsort(-similarity, kind="stable")[:neighbours]
        pairs |= {(min(row, int(b)), max(row, int(b))) for b in best if np.isfinite(similarity[b])}
    return sorted(pairs)


def _learn_words(descriptors: NDArray[np.float32], seed: int) -> NDArray[np.float32]:
    """(WORDS,128) k-means centres of a sample."""
    rng = np.random.default_rng(seed)
    if len(descriptors) > SAMPLE:
        descriptors = descriptors[np.sort(rng.choice(len(descriptors), SAMPLE, replace=False))]
    cv2.setRNGSeed(seed + 1)
    criteria = (cv2.TERM_CRITERIA_MAX_ITER, 15, 0.0)
    return cv2.kmeans(descriptors, WORDS, None, criteria, 1, cv2.KMEANS_PP_CENTERS)[2]


def vlad(descriptors: NDArray[np.float32], words: NDArray[np.float32]) -> NDArray[np.float32]:
    """Signature (WORDS*128,) of unit length, by signed square root; zero for an image without features."""
    signature = np.zeros_like(words)
    if len(descriptors):
        distance = (words * words).sum(1)[None] - 2 * descriptors @ words.T
        nearest = distance.argmin(axis=1)
        np.add.at(signature, nearest, descriptors - words[nearest])
    flat = (np.sign(signature) * np.sqrt(np.abs(signature))).ravel()
    return (flat / max(float(np.linalg.norm(flat)), 1e-12)).astype(np.float32)
