"""Streaming accumulator of per-frame scores, calibration pixels and a few full frames of an evaluation."""

from __future__ import annotations

import tempfile
from collections.abc import Iterable, Iterator

import numpy as np

from completion.confidence import error_from_confidence
from completion.evaluation.evaluate import Array, FrameResult, LeftOut, Score
from completion.evaluation.metrics import SimCol3DDepthErrors, simcol3d_errors
from completion.evaluation.strata import FrameStratum, Stratum, frame_strata, merged_strata
from completion.evaluation.uncertainty import DECILES, ErrorCalibration, PixelErrors, calibrate, pixel_errors

SAMPLES = 6  # full frames that are plotted


class Accumulator:
    """Scores of all frames, pixels for the calibration, and full results of 6 to 12 evenly spaced frames.

    trajectory: keep all depth maps in a temporary file, since SimCol3D's metrics read them twice.
    """

    def __init__(self, trajectory: bool = False) -> None:
        self.scores: list[Score] = []
        self.left_out = LeftOut()
        self._pixels: list[PixelErrors] = []
        self._strata: list[dict[str, FrameStratum]] = []
        self._sample_frames: list[FrameResult] = []
        self._every = 1
        # Not a plain file, in which NumPy's error of a full disk does not say so.
        self._maps = tempfile.SpooledTemporaryFile(max_size=1) if trajectory else None  # noqa: SIM115

    def __enter__(self) -> Accumulator:
        return self

    def __exit__(self, *_: object) -> None:
        if self._maps:
            self._maps.close()

    def add(self, result: FrameResult) -> None:
        """Accumulate the next frame."""
        if len(self.scores) % self._every == 0:
            self._sample_frames.append(result)
        if len(self._sample_frames) == 2 * SAMPLES:
            self._sample_frames, self._every = self._sample_frames[::2], 2 * self._every
        self.scores.append(Score(result.name, result.points, result.errors))
        if result.confidence is not None:
            error = error_from_confidence(result.confidence)
            self._pixels.append(pixel_errors(result.prediction, result.truth, error))
            images = (result.rgb, result.truth, result.sparse, result.prediction)
            self._strata.append(frame_strata(*images, error, result.confidence))
        if self._maps:
            np.save(self._maps, result.prediction, allow_pickle=False)
            np.save(self._maps, result.truth, allow_pickle=False)

    def add_all(self, results: Iterable[FrameResult]) -> Accumulator:
        for result in results:
            self.add(result)
        return self

    def sample_frames(self) -> list[FrameResult]:
        """At most `SAMPLES` evenly spaced frames, the first and the last kept one included."""
        places = (
            np.linspace(0, len(self._sample_frames) - 1, min(SAMPLES, len(self._sample_frames))).round().astype(int)
        )
        return [self._sample_frames[place] for place in places]

    def calibration(self) -> ErrorCalibration | None:
        """Calibration of the predicted error; None for a model without one, or for too few pixels."""
        return calibrate(self._pixels) if sum(len(p.depth) for p in self._pixels) >= DECILES else None

    def strata(self) -> dict[str, Stratum]:
        """Predicted and actual error by stratum; empty for a model that predicts none."""
        return merged_strata(self._strata)

    def simcol3d(self) -> SimCol3DDepthErrors | None:
        """SimCol3D's metrics of all frames as one trajectory; None without `trajectory`."""
        return simcol3d_errors(self._depth_pairs) if self._maps else None

    def _depth_pairs(self) -> Iterator[tuple[Array, Array]]:
        assert self._maps
        self._maps.seek(0)
        for _ in self.scores:
            yield np.load(self._maps, allow_pickle=False), np.load(self._maps, allow_pickle=False)
