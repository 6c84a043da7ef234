"""How fast each part is, beside what others use for it. Timings belong on a quiet machine."""

from benchmarks.common.runner import choose

if __name__ == "__main__":
    choose(
        "benchmarks.speed",
        __doc__,
        ["throughput", "live", "completion", "decimation", "fusion", "phantom", "window_adjustment"],
    )
