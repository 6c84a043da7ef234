"""Pairing of a run's poses with true ones by time: chance meetings are refused, and the likely reason is named."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from haustra.core.errors import HaustraError
from pipeline.input.pose_files.pairing import paired

RUN = np.arange(60) / 30
TRUTH = Path("truth.txt")


def test_times_of_one_clock_are_paired() -> None:
    mine, theirs = paired(RUN, RUN + 0.004, TRUTH)
    np.testing.assert_array_equal(mine, theirs)
    assert len(mine) == 60


def test_a_truth_with_a_pose_for_every_tenth_frame_is_enough() -> None:
    mine, theirs = paired(RUN, RUN[::10], TRUTH)
    np.testing.assert_array_equal(mine, 10 * theirs)


def test_fewer_poses_than_a_path_has_are_too_few() -> None:
    with pytest.raises(HaustraError, match=r"truth.txt holds 2 poses; at least 3 are needed"):
        paired(RUN, RUN[:2], TRUTH)


def test_a_run_of_a_few_frames_of_a_long_truth_is_enough() -> None:
    assert len(paired(RUN[20:40], np.arange(3000) / 30, TRUTH)[0]) == 20


@pytest.mark.parametrize(
    ("true_seconds", "reason"),
    [
        (np.arange(60.0), r"only 3 of 60 .* frame numbers: divide them by the film's frames a second"),
        (np.arange(1, 61.0), r"frame numbers"),
        (1000 * RUN + 5e3, r"milliseconds: divide them by 1000"),
        (1e9 * RUN, r"nanoseconds"),
        (np.round(1000 * RUN), r"milliseconds"),
        (RUN + 1.4, r"a clock \+1.4 s off"),
        (RUN + 1.6e9, r"times go from 16\d{8}\.\d{3} to .* a clock \+1600000000\.000 s off .*: subtract it"),
        (RUN - 1.2, r"a clock -1.2 s off"),
    ],
)
def test_what_met_by_chance_is_refused_and_the_reason_named(true_seconds: np.ndarray, reason: str) -> None:
    with pytest.raises(HaustraError, match=reason):
        paired(RUN, true_seconds, TRUTH)
