"""The key q and Ctrl-C: each asks for the end, and nothing is torn from what is being done."""

from __future__ import annotations

import os
import pty
import signal
import sys
import threading

import pytest

from pipeline.live.keyboard import first_interrupt_asks, watched_keyboard


@pytest.mark.parametrize("typed", [b"q", b"xq", b"Q"])
def test_q_is_noticed_though_other_keys_come_with_it(monkeypatch, typed):
    ours, theirs = pty.openpty()
    with os.fdopen(theirs, "r") as terminal:
        monkeypatch.setattr(sys, "stdin", terminal)
        asked = threading.Event()
        with watched_keyboard(asked):
            os.write(ours, typed)
            assert asked.wait(5)
    os.close(ours)


def test_other_keys_are_none(monkeypatch):
    ours, theirs = pty.openpty()
    with os.fdopen(theirs, "r") as terminal:
        monkeypatch.setattr(sys, "stdin", terminal)
        asked = threading.Event()
        with watched_keyboard(asked):
            os.write(ours, b"xyz")
            assert not asked.wait(0.6)
    os.close(ours)


def test_the_first_interrupt_asks_and_the_second_interrupts():
    asked, before = threading.Event(), signal.getsignal(signal.SIGINT)
    with first_interrupt_asks(asked):
        os.kill(os.getpid(), signal.SIGINT)
        assert asked.wait(5)
        with pytest.raises(KeyboardInterrupt):
            signal.raise_signal(signal.SIGINT)
    assert signal.getsignal(signal.SIGINT) is before
