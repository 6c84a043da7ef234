"""What becomes of memory that is freed: it goes back to the system, or is kept for what is asked for next.

glibc gives large arrays pages of their own, which go back at once when they are freed, and smaller ones a place in its
heap, which can only shrink where its end is free. What counts as large grows, unless told otherwise, with every large
array that is freed, up to 32 MiB. A run asks for arrays of all sizes, and its heap would soon be mostly holes.

A network, though, asks for and frees the same arrays again and again, and each page of its own costs a fault when it
is first touched: completing a frame spent a tenth of its time on that, a step of training an eighth.
"""

import ctypes
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

# Bytes of one array, where memory goes back. At 1 MiB the page faults of a run of 600 frames took 3 s of processor time
# more, and its peak was 1 % lower (one run each).
LARGEST_IN_HEAP = 4 << 20
MOST_FREE = 64 << 20  # bytes that are free at the heap's end before some go back
LARGEST_REUSED = 32 << 20  # the same where memory is kept; glibc takes no more, larger ones still go back at once
MOST_KEPT = 256 << 20
ARENAS = 2  # heaps that all threads share: each that has one of its own keeps there what it freed
_returning = False  # whether `return_freed_memory` was the last that this process asked for
_M_TRIM_THRESHOLD, _M_MMAP_THRESHOLD, _M_ARENA_MAX = -1, -3, -8  # glibc's malloc.h


def return_freed_memory() -> bool:
    """From now on arrays over `LARGEST_IN_HEAP` go back when they are freed, and threads share heaps; False where
    glibc's allocator is not, and nothing changes. For a process of our own: glibc's own limits do not come back, and
    heaps that threads have already stay."""
    _set_limit(_M_ARENA_MAX, ARENAS)
    return _set_limits(LARGEST_IN_HEAP, MOST_FREE, returning=True)


def keep_freed_memory() -> bool:
    """From now on those up to `LARGEST_REUSED` are kept for the next; False as above."""
    return _set_limits(LARGEST_REUSED, MOST_KEPT, returning=False)


@contextmanager
def freed_memory_kept() -> Iterator[None]:
    """Kept while a network works, where this process returns it else; in another process, such as one that calls
    `reconstruct()`, nothing changes."""
    if not _returning:
        yield
        return
    keep_freed_memory()
    try:
        yield
    finally:
        return_freed_memory()
        give_back_freed_memory()


def give_back_freed_memory() -> bool:
    """Whether any went back to the system: also what lies free between arrays in use, and in the heaps of threads that
    have ended."""
    malloc_trim = _of_glibc("malloc_trim")
    return malloc_trim is not None and bool(malloc_trim(0))


def _set_limits(largest: int, most: int, returning: bool) -> bool:
    global _returning
    _returning = _set_limit(_M_MMAP_THRESHOLD, largest) and _set_limit(_M_TRIM_THRESHOLD, most) and returning
    return _of_glibc("mallopt") is not None


def _set_limit(which: int, value: int) -> bool:
    mallopt = _of_glibc("mallopt")
    return mallopt is not None and bool(mallopt(which, value))


def _of_glibc(name: str) -> Any:
    """A function of the allocator by its name, where there is one."""
    return getattr(ctypes.CDLL(None), name, None) if sys.platform.startswith("linux") else None
