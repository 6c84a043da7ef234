"""A finished run taken back to an earlier stage, so that the stages from there on can be run otherwise."""

import shutil
from pathlib import Path

from pipeline.finished_run import Run
from pipeline.run_folder.workspace import Workspace, open_workspace

FROM_SURFACE = ("surface", "coverage", "report")
FROM_DEPTH = ("depth", "multiview", "refinement", "motion", *FROM_SURFACE)


def without_depth(made: Run, folder: Path) -> Workspace:
    """A copy of a run in `folder`, whose depth and all that follows is still to be made (`reconstruct`, `resume`)."""
    workspace = _before(made, folder, FROM_DEPTH)
    for name in ("depth", "confidence"):
        shutil.rmtree(folder / name)
    return workspace


def without_surface(made: Run, folder: Path) -> Workspace:
    """A copy of a run in `folder`, whose surface and all that follows is still to be made (`reconstruct`, `resume`)."""
    return _before(made, folder, FROM_SURFACE)


def _before(made: Run, folder: Path, stages: tuple[str, ...]) -> Workspace:
    shutil.copytree(made.folder, folder)
    workspace = open_workspace(folder)
    for stage in stages:
        workspace.record["stages"].pop(stage, None)
    workspace.save()
    return workspace
