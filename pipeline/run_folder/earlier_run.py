"""The earlier run of a folder whose run is being replaced: kept aside until the new one has a camera path.

Files are renamed, never copied. Whenever a move is stopped, `mend_stopped` undoes it: the record is the last file that
is set aside and the first that comes back, so that where it lies tells how far the move has come.
"""

import os
import shutil
from pathlib import Path

RECORD_NAME = "run.yaml"
KEPT, DROPPED = ".earlier_run", ".removed_run"  # folders in the run folder
LEFT_BY_STOP = (KEPT, DROPPED)


def keep(root: Path, files: list[Path]) -> None:
    """Set the run's files aside, its record last; OSError, and nothing has moved, where one cannot be."""
    (root / KEPT).mkdir()
    try:
        for path in (*files, root / RECORD_NAME):
            os.replace(path, root / KEPT / path.name)
    except OSError:
        bring_back(root)
        raise


def is_kept(root: Path) -> bool:
    """Whether a whole run lies aside."""
    return (root / KEPT / RECORD_NAME).exists()


def bring_back(root: Path) -> None:
    """Move what lies aside back to where it was, the record first."""
    for path in sorted((root / KEPT).iterdir(), key=lambda path: path.name != RECORD_NAME):
        target = root / path.name
        if target.is_dir():  # of the new run, whose record is gone
            shutil.rmtree(target)
        os.replace(path, target)
    (root / KEPT).rmdir()


def forget(root: Path) -> None:
    """Remove the run that lies aside."""
    if (root / KEPT).exists():
        os.replace(root / KEPT, root / DROPPED)  # in one step: half of a run must not be brought back
    shutil.rmtree(root / DROPPED, ignore_errors=True)


def mend_stopped(root: Path) -> None:
    """Undo a move that was stopped: the record lies on one side only while a run lies on both."""
    shutil.rmtree(root / DROPPED, ignore_errors=True)
    if (root / KEPT).exists() and not (is_kept(root) and (root / RECORD_NAME).exists()):
        bring_back(root)
