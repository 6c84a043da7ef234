"""The command `haustra doctor`."""

from pathlib import Path
from typing import Annotated

import typer

from haustra.core.errors import HaustraError
from pipeline.cli.given_paths import must_be_run


def doctor(
    run: Annotated[Path | None, typer.Argument(help="run folder of which settings and counts are told too")] = None,
    test: Annotated[bool, typer.Option("--test/--no-test", help="reconstruct a second of the embedded clip")] = True,
) -> None:
    """Say what this machine has of what is needed, test it, and print the text of a bug report."""
    if run is not None:
        must_be_run(run)
    from pipeline.doctor.report import ADVICE, examine, facts_of_run

    faults = 0
    for finding in examine(Path.cwd(), test):
        print(finding, flush=True)
        faults += finding.verdict == "fault"
    if run is not None:
        print(f"\nthe run:\n{facts_of_run(run)}")
    print(f"\n{ADVICE}")
    if faults:
        raise HaustraError(f"{faults} findings are marked with !: they keep reconstruct from working as it should")
