"""The key `q` in the terminal, without Enter."""

import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress

WAIT_S = 0.2


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
            if select.select([terminal], [], [], WAIT_S)[0] and sys.stdin.read(1) in ("q", "Q", ""):
                asked.set()
                return

    tty.setcbreak(terminal)
    thread = threading.Thread(target=watch, name="keyboard", daemon=True)
    thread.start()
    try:
        yield
    finally:
        over.set()
        with suppress(OSError, termios.error):
            termios.tcsetattr(terminal, termios.TCSADRAIN, before)
