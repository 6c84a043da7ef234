"""`python -m benchmarks.paper --work WORK`: see `run_queue`."""

from benchmarks.paper.run_queue import main

if __name__ == "__main__":
    main()
