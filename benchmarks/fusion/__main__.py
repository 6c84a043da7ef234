"""`python -m benchmarks.fusion`: see `comparison.py`."""

from benchmarks.common.runner import run
from benchmarks.fusion import comparison

if __name__ == "__main__":
    run(comparison, "benchmarks.fusion")
