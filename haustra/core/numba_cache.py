"""Loops that NumPy would make in a dozen passes, compiled by Numba at their first call.

What is compiled, some seconds for each package, is kept beside the module or in the user's cache. No fast mathematics:
sums run in the order in which they are written, so that the same numbers give the same bytes. A compiled function must
not use globals or functions of other files: a change there would not be noticed.
"""

import inspect
from collections.abc import Callable
from contextlib import suppress
from hashlib import sha256
from pathlib import Path
from typing import Any, TypeVar, cast

from numba import config, njit
from numba.core.caching import FunctionCache, IndexDataCacheFile

Function = TypeVar("Function", bound=Callable[..., Any])

# Off by default in Numba: statements that are written out one below the other become vector instructions. The order of
# each sum stays, so that the bytes do.
config.SLP_VECTORIZE = 1  # type: ignore[attr-defined]


def compiled(function: Function) -> Function:
    """Without the interpreter's lock; kept on disk where that can be done, else compiled in each process."""
    dispatcher: Any = njit(nogil=True)(function)
    with suppress(Exception):  # package and home are read-only, or another Numba keeps its code in another way
        dispatcher._cache = _Kept(function)
    return cast(Function, dispatcher)


class _Kept(FunctionCache):
    """Numba's store of one function, which never stops a run: a full disk or a damaged file only costs the time.

    Numba writes the index before the code, and names the code by a number alone: a run that is cut short between the
    two would leave a new index to old code. So each version of the sources has names of its own.
    """

    def __init__(self, function: Callable[..., Any]) -> None:
        super().__init__(function)
        sources = [Path(inspect.getfile(function)), Path(__file__)]
        version = sha256(b"".join(path.read_bytes() for path in sources)).hexdigest()[:16]
        self._cache_file = IndexDataCacheFile(
            self.cache_path, f"{self._impl.filename_base}-{version}", self._impl.locator.get_source_stamp()
        )

    def load_overload(self, *arguments: Any) -> Any:
        with suppress(Exception):
            return super().load_overload(*arguments)
        return None

    def save_overload(self, *arguments: Any) -> None:
        with suppress(Exception):
            super().save_overload(*arguments)
