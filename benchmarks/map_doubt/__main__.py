"""Whether a submap is wrong, by what it says about itself."""

from benchmarks.common.runner import choose

if __name__ == "__main__":
    choose("benchmarks.map_doubt", __doc__, ["fit", "ship"])
