"""`python -m pipeline` is `reconstruct`."""

from pipeline.cli import reconstruct_main

reconstruct_main()
