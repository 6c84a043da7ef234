"""Items made ahead of their turn: same order, no more than was asked for, and what fails fails in its turn."""

import gc
import threading
from contextlib import nullcontext
from itertools import islice

import pytest

from haustra.core.threads import prefetched


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
