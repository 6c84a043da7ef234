"""A finished run taken back to before its depth, so that the stages from there on can be run otherwise."""

import shutil
from pathlib import Path

from pipeline.finished_run import Run
from pipeline.run_folder.workspace import Workspace, open_workspace

LATER = ("depth", "multiview", "refinement", "motion", "surface", "coverage", "report")


def without_depth(made: Run, folder: Path) -> Workspace:
    """A copy of a run in `folder`, whose depth and all that follows is still to be made (`reconstruct`, `resume`)."""
    shutil.copytree(made.folder, folder)
    for name in ("depth", "confidence"):
        shutil.rmtree(folder / name)
    workspace = open_workspace(folder)
    for stage in LATER:
        workspace.record["stages"].pop(stage, None)
    workspace.save()
    return workspace
