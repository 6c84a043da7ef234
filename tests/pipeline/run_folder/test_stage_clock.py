"""Time of stages against work of a known kind."""

import time

import pytest

from pipeline.run_folder.stage_clock import StageClock


def _compute(seconds: float) -> str:
    end = time.process_time() + seconds
    while time.process_time() < end:
        pass
    return "done"


def test_a_stage_is_what_it_was_and_its_time_is_known() -> None:
    clock = StageClock()
    assert clock("computing", _compute)(0.1) == "done"
    clock("waiting", time.sleep)(0.1)
    computing, waiting = clock.times
    assert (computing.stage, waiting.stage) == ("computing", "waiting")
    assert computing.seconds >= 0.09
    assert computing.cpu_seconds >= 0.09
    assert waiting.seconds >= 0.09
    assert waiting.cpu_seconds < computing.cpu_seconds
    assert 10 < computing.peak_mib <= waiting.peak_mib < 100_000
    assert [one["stage"] for one in clock.to_list()] == ["computing", "waiting"]


def test_a_stage_that_fails_is_not_timed() -> None:
    clock = StageClock()
    with pytest.raises(ZeroDivisionError):
        clock("failing", lambda: 1 / 0)()
    assert clock.times == []
