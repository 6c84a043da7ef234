"""Work on the next items of a stream while this one is in hand."""

from collections import deque
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from typing import TypeVar

Item = TypeVar("Item")
Made = TypeVar("Made")


def prefetched(make: Callable[[Item], Made], items: Sequence[Item], count: int = 2) -> Iterator[Made]:
    """What `make` gives of each item, in their order; a thread makes up to `count` of them before they are asked for.

    What `make` raises is raised where its item would have come. Nothing is made after the iterator is closed.
    """
    with ThreadPoolExecutor(1, "lookahead") as thread:
        waiting: deque[Future[Made]] = deque()
        try:
            for item in items:
                waiting.append(thread.submit(make, item))
                if len(waiting) > count:
                    yield waiting.popleft().result()
            while waiting:
                yield waiting.popleft().result()
        finally:
            thread.shutdown(wait=True, cancel_futures=True)
