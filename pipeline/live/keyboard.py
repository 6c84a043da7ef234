"""How a session is ended from the terminal: the key `q`, without Enter, and Ctrl-C."""

import os
import signal
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from typing import Any

WAIT_S = 0.2
MOST_TYPED = 64  # characters that are read at once


@contextmanager
def watched_keyboard(asked: threading.Event) -> Iterator[None]:
    """While it lasts, `q` sets `asked`. Nothing happens where there is no terminal, as in a script or a service."""
    if not sys.stdin or not sys.stdin.isatty() or sys.platform == "win32":
        yield
        return
    import select
    import termios
    import tty

    terminal = sys.stdin.fileno()
    before = termios.tcgetattr(terminal)
    over = threading.Event()

    def watch() -> None:
        while not over.is_set():
            if not select.select([terminal], [], [], WAIT_S)[0]:
                continue
            typed = os.read(terminal, MOST_TYPED)  # not by sys.stdin, which would keep the rest where select is blind
            if not typed or b"q" in typed.lower():
                asked.set()
                return

    tty.setcbreak(terminal)
    thread = threading.Thread(target=watch, name="keyboard", daemon=True)
    thread.start()
    try:
        yield
    finally:
        over.set()
        try:
            thread.join(2 * WAIT_S)
        finally:  # also where an impatient Ctrl-C ends the waiting
            with suppress(OSError, termios.error):
                termios.tcsetattr(terminal, termios.TCSADRAIN, before)


@contextmanager
def first_interrupt_asks(asked: threading.Event) -> Iterator[None]:
    """While it lasts the first Ctrl-C sets `asked`, wherever the program is; a second one interrupts as ever."""
    if threading.current_thread() is not threading.main_thread():  # only that one may say what a signal does
        yield
        return
    before = signal.getsignal(signal.SIGINT)

    def ask(*_: Any) -> None:
        asked.set()
        signal.signal(signal.SIGINT, before)

    signal.signal(signal.SIGINT, ask)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)
