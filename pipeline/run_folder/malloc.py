"""Keep the memory that is freed, for what is asked for next; give it back where the next stage asks for other arrays.

Where many large arrays are freed together, glibc gives their memory back to the system and gets the next ones as fresh
pages, each of which costs a fault when it is first touched. A network asks for and frees the same arrays again and
again: completing a frame spent a tenth of its time on that, a step of training an eighth.
"""

import ctypes
import sys
from typing import Any

LARGEST_REUSED = 32 << 20  # bytes of one array; glibc takes no more, larger ones still go back at once
MOST_KEPT = 256 << 20  # bytes that are free at the heap's end before some go back
_M_TRIM_THRESHOLD, _M_MMAP_THRESHOLD = -1, -3  # glibc's malloc.h


def keep_freed_memory() -> bool:
    """Tell glibc's allocator so, for this process; False where there is none, and nothing changes."""
    mallopt = _of_glibc("mallopt")
    if mallopt is None:
        return False
    return bool(mallopt(_M_MMAP_THRESHOLD, LARGEST_REUSED) and mallopt(_M_TRIM_THRESHOLD, MOST_KEPT))


def give_back_freed_memory() -> bool:
    """Whether any went back to the system: also what lies free between arrays in use, and in the heaps of threads that
    have ended."""
    malloc_trim = _of_glibc("malloc_trim")
    return malloc_trim is not None and bool(malloc_trim(0))


def _of_glibc(name: str) -> Any:
    """A function of the allocator by its name, where there is one."""
    return getattr(ctypes.CDLL(None), name, None) if sys.platform.startswith("linux") else None
