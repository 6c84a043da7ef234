"""What the parts and numbers of fusion are worth to the mesh of finished runs."""

from benchmarks.common.runner import choose

if __name__ == "__main__":
    choose("benchmarks.fusion", __doc__, ["comparison", "truncation"])
