"""Items made ahead of their turn: same order, no more than was asked for, and what fails fails in its turn."""

import gc
import os
import signal
import threading
import time
from contextlib import nullcontext
from itertools import islice

import pytest

from haustra.core import threads
from haustra.core.threads import prefetched, side_by_side


def test_same_as_one_after_the_other():
    assert list(prefetched(lambda k: k * k, range(50))) == [k * k for k in range(50)]
    assert list(prefetched(lambda k: k * k, range(2), count=5)) == [0, 1]
    assert list(prefetched(lambda k: k, [])) == []


def test_it_is_another_thread_that_makes_them():
    assert threading.get_ident() not in set(prefetched(lambda _: threading.get_ident(), range(5)))


def test_the_next_ones_are_made_while_one_is_in_hand_and_no_more():
    """The first result is in hand: two more are made without being asked for, of a long stream."""
    made, third = [], threading.Event()

    def make(k):
        made.append(k)
        if k == 2:
            third.set()
        return k

    stream = prefetched(make, range(10**9), count=2)
    assert next(stream) == 0
    assert third.wait(10)
    stream.close()
    assert made == [0, 1, 2]


@pytest.mark.parametrize("fails", [False, True])
def test_nothing_is_made_after_the_end(fails):
    """Closed, or left by an error of who asks, while the second item is in the making and the third waits for it."""
    made, begun, go_on = [], threading.Event(), threading.Event()

    def make(k):
        if k == 1:
            begun.set()
            assert go_on.wait(10)
        made.append(k)
        return k

    def ask():
        for _ in prefetched(make, range(10)):
            assert begun.wait(10)
            threading.Timer(0.2, go_on.set).start()  # while the end waits for what is in the making
            if fails:
                raise KeyError("who asks")
            return

    with pytest.raises(KeyError) if fails else nullcontext():
        ask()
    gc.collect()
    assert made == [0, 1]


def test_what_fails_fails_in_its_turn():
    def make(k):
        if k == 3:
            raise ValueError("no third")
        return k

    stream = prefetched(make, range(10))
    assert list(islice(stream, 3)) == [0, 1, 2]
    with pytest.raises(ValueError, match="no third"):
        next(stream)


def test_a_few_items_are_made_at_once_and_come_in_their_order(monkeypatch):
    """Each waits for the other: one after the other they would never end."""
    monkeypatch.setattr(threads, "processors", lambda: 2)
    both = threading.Barrier(2, timeout=20)

    def make(k):
        both.wait()
        return k, threading.get_ident()

    for _ in range(3):
        (zero, here), (one, there) = side_by_side(make, [0, 1])
        assert (zero, one) == (0, 1)
        assert here == threading.get_ident() != there
    assert side_by_side(make, []) == []


def test_a_single_processor_makes_them_in_turn(monkeypatch):
    monkeypatch.setattr(threads, "processors", lambda: 1)
    assert side_by_side(lambda k: (k, threading.get_ident()), [0, 1]) == [(k, threading.get_ident()) for k in (0, 1)]


@pytest.mark.parametrize("bad", [0, 1])
def test_what_one_of_a_few_raises_is_raised(bad):
    with pytest.raises(ZeroDivisionError):
        side_by_side(lambda k: 1 / (k - bad), [0, 1])
    assert side_by_side(str, [0, 1]) == ["0", "1"], "and the threads are still there"


def test_what_was_begun_has_ended_when_the_call_does(monkeypatch):
    monkeypatch.setattr(threads, "processors", lambda: 2)
    ended = threading.Event()

    def make(k):
        if k == 0:
            raise KeyboardInterrupt
        time.sleep(0.2)
        ended.set()

    with pytest.raises(KeyboardInterrupt):
        side_by_side(make, [0, 1])
    assert ended.is_set()


@pytest.mark.skipif(not hasattr(os, "fork"), reason="no fork on this system")
def test_a_forked_process_has_threads_of_its_own():
    assert side_by_side(str, [0, 1]) == ["0", "1"]
    child = os.fork()
    if child == 0:
        os._exit(0 if side_by_side(str, [0, 1]) == ["0", "1"] else 1)
    for _ in range(200):  # a child without threads would wait for ever
        ended, status = os.waitpid(child, os.WNOHANG)
        if ended:
            break
        time.sleep(0.05)
    else:
        os.kill(child, signal.SIGKILL)
    assert ended == child
    assert status == 0
