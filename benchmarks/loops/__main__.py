"""Whether places seen twice are found, and what closing loops over them and joining submaps is worth."""

from benchmarks.common.runner import choose

if __name__ == "__main__":
    choose("benchmarks.loops", __doc__, ["pose_graph", "joins"])
