"""Freed memory is kept: by the kernel's own count of page faults."""

import subprocess
import sys

import pytest

from pipeline.run_folder import malloc

COUNT_FAULTS = """
import resource
import numpy as np
from pipeline.run_folder.malloc import LARGEST_REUSED, keep_freed_memory

def faults(size):
    before = resource.getrusage(resource.RUSAGE_SELF).ru_minflt
    for _ in range(10):
        for array in [np.empty(size, np.uint8) for _ in range(2)]:
            array[::4096] = 1
    return resource.getrusage(resource.RUSAGE_SELF).ru_minflt - before

faults(20 << 20)
usual = faults(20 << 20)
kept = keep_freed_memory()
faults(20 << 20)
print(usual, int(kept), faults(20 << 20), faults(2 * LARGEST_REUSED))
"""


def test_memory_that_is_freed_comes_back_without_page_faults_and_the_largest_blocks_still_go():
    run = subprocess.run([sys.executable, "-c", COUNT_FAULTS], capture_output=True, text=True, check=True)
    usual, kept, after, largest = map(int, run.stdout.split())
    if not kept or usual < 1000:
        pytest.skip("not glibc's allocator, or the kernel does not count faults or has huge pages")
    pages = 2 * (20 << 20) // 4096  # of one turn, without huge pages
    assert after < pages / 100
    assert after < usual / 10
    assert largest > 10 * after


RESIDENT = """
import resource
import numpy as np
from pathlib import Path
from pipeline.run_folder.malloc import give_back_freed_memory, keep_freed_memory

def mib():
    return int(Path("/proc/self/statm").read_text().split()[1]) * resource.getpagesize() / 2**20

keep_freed_memory()
arrays = [np.ones(1 << 18) for _ in range(100)]
last = np.ones(1000)  # at the end of the heap: what lies before it is not given back by itself
del arrays
before = mib()
print(before, int(give_back_freed_memory()), mib())
"""


def test_freed_memory_goes_back_when_asked():
    run = subprocess.run([sys.executable, "-c", RESIDENT], capture_output=True, text=True, check=False)
    if run.returncode != 0 and "statm" in run.stderr:
        pytest.skip("the system does not tell the resident memory")
    before, given, after = map(float, run.stdout.split())
    if not given:
        pytest.skip("not glibc's allocator")
    assert after < before - 150, "200 MiB were freed"


SCATTERED = """
import resource
import numpy as np
from pathlib import Path
from pipeline.run_folder.malloc import LARGEST_IN_HEAP, freed_memory_kept, keep_freed_memory, return_freed_memory

def mib():
    return int(Path("/proc/self/statm").read_text().split()[1]) * resource.getpagesize() / 2**20

def left_over():
    before = mib()
    arrays = [np.ones(2 * LARGEST_IN_HEAP, np.uint8) for _ in range(15)]
    between = [np.ones(1 << 17, np.uint8) for _ in range(15)]
    last = np.ones(1 << 17, np.uint8)  # in the heap, behind all others
    del arrays, between
    return mib() - before

known = return_freed_memory()
returned = left_over()
with freed_memory_kept():
    kept = left_over()
print(int(known), returned, kept, left_over())
"""


def test_large_arrays_go_back_at_once_but_while_a_network_works():
    run = subprocess.run([sys.executable, "-c", SCATTERED], capture_output=True, text=True, check=False)
    if run.returncode != 0 and "statm" in run.stderr:
        pytest.skip("the system does not tell the resident memory")
    assert run.returncode == 0, run.stderr
    known, returned, kept, after = map(float, run.stdout.split())
    if not known:
        pytest.skip("not glibc's allocator")
    assert returned < 30, "120 MiB of large arrays were freed"
    assert kept > 90
    assert after < 30


def test_a_process_that_did_not_ask_is_left_as_it_is(monkeypatch):
    """As one that calls `reconstruct()` from Python."""
    asked = []
    monkeypatch.setattr(malloc, "_set_limit", lambda which, value: asked.append(value) or True)
    monkeypatch.setattr(malloc, "_returning", False)
    with malloc.freed_memory_kept():
        pass
    assert asked == []
    malloc.return_freed_memory()
    with malloc.freed_memory_kept():
        kept = list(asked)
    assert malloc.LARGEST_REUSED in kept
    assert asked[len(kept) :] == [malloc.ARENAS, malloc.LARGEST_IN_HEAP, malloc.MOST_FREE]
