"""Another process does the jobs: in order, the oldest given up when too many wait, and its end told in a sentence."""

from __future__ import annotations

import os
import time

import pytest

from haustra.core.errors import HaustraError
from pipeline.live.worker import Worker
from tests.helpers.processes import wait_for


class Doubler:
    def __init__(self, factor):
        if factor == 0:
            raise HaustraError("no factor")
        self.factor = factor

    def __call__(self, job):
        if job == "die":
            os._exit(3)
        if job == "fail":
            raise HaustraError("it does not work")
        time.sleep(0.3 if job == "slow" else 0)
        return job * self.factor


def test_results_come_in_order_and_what_waits_too_long_is_dropped():
    with Worker("doubler", Doubler, 2, most_waiting=2) as worker:
        worker.wait_until_ready(30)
        worker.submit("slow")
        wait_for(lambda: worker.waiting == 1 and not worker._waiting, 10)  # it is in work
        for job, full in ((1, False), (2, False), (3, True), (4, True)):
            assert worker.is_full == full
            worker.submit(job)
        assert worker.wait_until_idle(30)
        assert list(worker.results()) == ["slowslow", 6, 8]
        assert worker.dropped == 2
        assert worker.free


@pytest.mark.parametrize(("job", "words"), [("die", "ended unexpectedly"), ("fail", "it does not work")])
def test_a_process_that_ends_is_told_and_stops_nobody(job, words):
    with Worker("doubler", Doubler, 2) as worker:
        worker.submit(job)
        assert not worker.wait_until_idle(30)
        assert words in worker.failure
        worker.submit(1)
        assert not worker.free


def test_a_process_that_cannot_begin_says_why():
    with Worker("doubler", Doubler, 0) as worker, pytest.raises(HaustraError, match="no factor"):
        worker.wait_until_ready(30)
