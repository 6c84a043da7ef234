"""A fresh run folder, or one whose run is to be replaced."""

import importlib.metadata
import platform
from pathlib import Path
from typing import Any

from haustra.core.errors import HaustraError
from haustra.core.text import PARTIAL, check_name
from pipeline.config import Config, beyond_surface
from pipeline.run_folder.earlier_run import LEFT_BY_STOP, RECORD_NAME, forget, is_kept, keep, mend_stopped
from pipeline.run_folder.inputs import changed_inputs, inputs_of, record_inputs
from pipeline.run_folder.lock import NAME as LOCK_NAME
from pipeline.run_folder.lock import RunLock
from pipeline.run_folder.workspace import (
    CLEARING,
    FIRST_RESULT,
    LIVE_FILM,
    LIVE_FOLDER,
    LIVE_RECORD,
    REFUSED,
    Workspace,
    clear_if_begun,
    files_of,
    open_workspace,
)

PACKAGES = ("haustra", "numpy", "torch", "pycolmap", "open3d", "gtsam", "opencv-python-headless", "av")
# All that a live session, or a stop before the first record, leaves.
UNFINISHED_START = (LOCK_NAME, RECORD_NAME + PARTIAL, LIVE_RECORD, LIVE_FILM, LIVE_FOLDER, *LEFT_BY_STOP)


def create_workspace(root: Path, source: Path, config: Config, overwrite: bool) -> Workspace:
    """A fresh run folder, locked; refuses one that holds a run already unless `overwrite`.

    A run that is replaced is kept until the new one has a camera path: where that is refused before, the folder is as
    it was.
    """
    check_name(root.resolve())
    if root.exists() and not root.is_dir():
        raise HaustraError(f"the output {root} is a file; give a folder")
    workspace = Workspace(root)
    foreign_files = root.exists() and any(path.name not in UNFINISHED_START for path in root.iterdir())
    if foreign_files and not workspace.record_path.exists() and not is_kept(root):
        raise HaustraError(f"the folder {root} is not empty and holds no run; give another output folder")
    try:
        root.mkdir(parents=True, exist_ok=True)
        workspace.lock = RunLock(root)
    except OSError as error:
        raise HaustraError(f"cannot create the output folder {root}: {error.strerror}") from error
    try:
        mend_stopped(root)
        _fill(workspace, source, config, overwrite)
    except BaseException:
        workspace.lock.release()
        raise
    return workspace


def _fill(workspace: Workspace, source: Path, config: Config, overwrite: bool) -> None:
    """The record comes before anything else, and says so while an earlier run is being removed: whenever this is
    stopped, the folder is a run that can be gone on with or overwritten. A run that finished no stage, or was refused
    before it had a camera path, is in nobody's way, unless it was to replace an earlier one: the command is given
    again, corrected."""
    root, replaced = workspace.root, workspace.record_path.exists()
    record = _record_in(root) if replaced else None
    in_the_way = replaced and (is_kept(root) or not _is_in_nobodys_way(record))
    if in_the_way and not overwrite:
        raise HaustraError(f"{root} already holds a run; {_ways_on(root, source, config)}")
    if replaced:
        _check_survives(workspace, source, config)
    workspace.record |= {
        "source": record_inputs(source, config),  # before the earlier run goes: this may fail
        "versions": _versions(),
        "config": config.model_dump(mode="json"),
    }
    if in_the_way and (record is None or FIRST_RESULT in record["stages"]):
        forget(root)  # kept by a run that has come to a result since
        keep(root, [path for path in files_of(workspace) if path.parent == root and path.exists()])
    elif replaced:
        workspace.record[CLEARING] = True
    workspace.save()
    clear_if_begun(workspace)
    workspace.log.mkdir(exist_ok=True)


def _check_survives(workspace: Workspace, source: Path, config: Config) -> None:
    """HaustraError for an input that is one of the files of the run that would be replaced."""
    files = [path.resolve() for path in files_of(workspace)]
    for name, path in inputs_of(source, config).items():
        path = path.resolve()
        if any(path.is_relative_to(one) for one in files):
            raise HaustraError(
                f"the {name} {path} is one of the files of the run {workspace.root}, which would be replaced; give "
                "another output folder (-o)"
            )


def _ways_on(root: Path, source: Path, config: Config) -> str:
    """What can be done about a run that is in the way: of another film it cannot be gone on with, nor with other
    settings."""
    try:
        before = open_workspace(root)
        other, inputs = before.config.differences(config), before.record["source"]
    except HaustraError:  # a damaged record
        return "--overwrite replaces it"
    if "source" in changed_inputs(source, config, inputs, trust_stamps=True):
        if inputs["path"] == str(source.resolve()):
            return f"{source} has changed since: give another folder (-o), or --overwrite to replace the run"
        return f"it is of another source, {inputs['path']}: give another folder (-o), or --overwrite to replace it"
    if not other:
        return "add --resume to go on with it or --overwrite to redo it"
    if not beyond_surface(other, config):
        return f"add --resume to make its surface anew ({other[0]}), or --overwrite to redo all of it"
    return f"its settings were others ({other[0]}), so --overwrite redoes it, and --resume goes on with those alone"


def _record_in(root: Path) -> dict[str, Any] | None:
    """The record of a run; None where it is damaged, and what the run had come to cannot be told."""
    try:
        return open_workspace(root).record
    except HaustraError:
        return None


def _is_in_nobodys_way(record: dict[str, Any] | None) -> bool:
    if record is None:
        return False
    return not record["stages"] or (REFUSED in record and FIRST_RESULT not in record["stages"])


def _versions() -> dict[str, str]:
    versions = {"python": platform.python_version()}
    for name in PACKAGES:
        try:
            versions[name] = importlib.metadata.version(name)
        except importlib.metadata.PackageNotFoundError:
            versions[name] = "not installed"
    return versions
