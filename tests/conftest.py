"""Tiny seeded inputs shared by the tests."""

import os
import signal

import pytest

# The suite runs in as many processes as there are processors. Threads of torch and of NumPy's BLAS that wait for work
# spin, and take the processors from the other process: tests of the networks took four times as long. Both libraries
# read this when they are imported.
os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")


if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    # A shell's background job ignores Ctrl-C, and so would every process that the tests start and interrupt.
    signal.signal(signal.SIGINT, signal.default_int_handler)

if signal.getsignal(signal.SIGHUP) is signal.SIG_IGN:  # and what `nohup` starts ignores a lost terminal
    signal.signal(signal.SIGHUP, signal.SIG_DFL)

# Half of the suite's time: begun first, so that no process is left with one of them when the others are done.
LONGEST = (
    "test_reconstruct.py",
    "test_chunks.py",
    "test_final_adjustment.py",
    "test_train.py",
    "test_submap_merging.py",
)


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """The longest files first, the rest as they are."""
    items.sort(key=lambda item: LONGEST.index(item.path.name) if item.path.name in LONGEST else len(LONGEST))
