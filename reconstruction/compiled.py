"""Loops that NumPy would make in a dozen passes, compiled by Numba at their first call.

What is compiled, some seconds for all of them, is kept beside the module or in the user's cache. No fast mathematics:
sums run in the order in which they are written, so that the same numbers give the same bytes.
"""

from collections.abc import Callable
from typing import Any, TypeVar, cast

from numba import njit

Function = TypeVar("Function", bound=Callable[..., Any])


def compiled(function: Function) -> Function:
    """Without the interpreter's lock; kept on disk where anything can be written, else compiled in each process."""
    try:
        return cast(Function, njit(cache=True, nogil=True)(function))
    except RuntimeError:  # Numba's word for a package and a home that are both read-only
        return cast(Function, njit(nogil=True)(function))
