"""What the shipped model makes of an image and sparse depth, beside linear interpolation."""

from benchmarks.common.runner import choose

if __name__ == "__main__":
    choose(
        "benchmarks.completion",
        __doc__,
        ["accuracy", "strata", "point_errors", "working_sizes", "mesh_sizes", "mesh_weights"],
    )
