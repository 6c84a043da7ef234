"""`python -m benchmarks.robustness`: see `fuzz.py`, a file of its own since its worker processes import it by name."""

from benchmarks.common.runner import run
from benchmarks.robustness import fuzz

if __name__ == "__main__":
    run(fuzz, "benchmarks.robustness")
