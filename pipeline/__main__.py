"""`python -m pipeline` is `reconstruct`."""

from pipeline.cli.main import reconstruct_main

reconstruct_main()
