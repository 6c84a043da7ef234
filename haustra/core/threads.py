"""Threads that share a stage's work and change nothing that is computed; libraries that keep to one thread."""

import contextlib
import functools
import os
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor, wait
from typing import TypeVar

import cv2
from threadpoolctl import threadpool_limits

MOST_WORKERS = 4  # each holds a frame and what is made of it; where a quota allows less than there are, 4 do no harm

Item = TypeVar("Item")
Made = TypeVar("Made")


def prefetched(make: Callable[[Item], Made], items: Iterable[Item], count: int = 2, threads: int = 1) -> Iterator[Made]:
    """What `make` gives of each item, in their order; up to `count` of them are made before they are asked for, as many
    at once as there are threads.

    The calling thread asks for the items. What `make` raises is raised where its item would have come. Nothing is made
    after the iterator is closed.
    """
    with ThreadPoolExecutor(threads, "lookahead") as pool:
        waiting: deque[Future[Made]] = deque()
        try:
            for item in items:
                waiting.append(pool.submit(make, item))
                if len(waiting) > count:
                    yield waiting.popleft().result()
            while waiting:
                yield waiting.popleft().result()
        finally:
            pool.shutdown(wait=True, cancel_futures=True)


def side_by_side(make: Callable[[Item], Made], items: Sequence[Item]) -> list[Made]:
    """What `make` gives of each of a few items, the first made by the calling thread, on a single processor all.
    For work of milliseconds: the other threads stay from call to call. `make` must not call this function."""
    if processors() == 1:
        return [make(item) for item in items]
    others = [_kept_threads().submit(make, item) for item in items[1:]]
    try:
        first = [make(item) for item in items[:1]]
    finally:
        wait(others)  # whatever happens: they may write where the caller goes on
    return first + [other.result() for other in others]


@functools.cache
def _kept_threads() -> ThreadPoolExecutor:
    return ThreadPoolExecutor(MOST_WORKERS, "side")


if hasattr(os, "register_at_fork"):  # a forked process has none of the threads
    os.register_at_fork(after_in_child=_kept_threads.cache_clear)


def workers() -> int:
    """How many threads share a stage's work: the processors, but no more than hold their items in memory at once."""
    return min(MOST_WORKERS, processors())


def processors() -> int:
    """Those that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


@contextlib.contextmanager
def single_threaded() -> Iterator[None]:
    """OpenCV and BLAS keep to the thread that calls them: pictures and matrices are small, and other processors have
    items of their own. With two threads each, tracking took up to twice the processor time, and longer."""
    before = cv2.getNumThreads()
    cv2.setNumThreads(1)
    try:
        with threadpool_limits(1, "blas"):
            yield
    finally:
        cv2.setNumThreads(before)
