"""Going on with a run: of the same source, by the same settings but for those that the surface alone depends on."""

from pathlib import Path

from haustra.core.errors import HaustraError
from pipeline.config import Config, beyond_surface
from pipeline.run_folder.earlier_run import RECORD_NAME, forget, is_kept, mend_stopped
from pipeline.run_folder.inputs import changed_inputs, record_inputs
from pipeline.run_folder.lock import RunLock
from pipeline.run_folder.workspace import FIRST_RESULT, REFUSED, Workspace, clear_if_begun, open_workspace

FROM_SURFACE = ("surface", "coverage", "report")  # stages, in their order
OF_SURFACE = ("scale file", "lamp file")  # inputs that no stage before reads


def resume_workspace(root: Path, source: Path, config: Config) -> Workspace:
    """An existing run of the same source and settings, locked, to go on with.

    Where another scale or fusion is given, the surface and what follows are made anew; `made_anew` says why. The record
    then names the source and the settings as they are given now: either may have been moved. A scale that the run has
    and that is not given again is no such wish, and refused as every other setting is.
    """
    if not is_kept(root):  # else the record may still be aside
        open_workspace(root)  # says so if it is none
    lock = RunLock(root)
    try:
        mend_stopped(root)
        workspace = open_workspace(root)  # as the process before left it
        workspace.lock = lock
        if workspace.is_done(FIRST_RESULT):
            forget(root)  # a run that was stopped before it could
        _check_same(workspace, source, config)
        workspace.record.pop(REFUSED, None)
        clear_if_begun(workspace)
        workspace.log.mkdir(exist_ok=True)
    except BaseException:
        lock.release()
        raise
    return workspace


def is_same_run(workspace: Workspace, source: Path, config: Config) -> bool:
    """Whether a run is of this source, these settings and these files; those that look untouched are not read."""
    if workspace.retired_settings or not workspace.config.is_same_work(config):
        return False
    return not changed_inputs(source, config, workspace.record["source"], True)


def _check_same(workspace: Workspace, source: Path, config: Config) -> None:
    root, changed = workspace.root, changed_inputs(source, config, workspace.record["source"])
    if "source" in changed:
        kept = f"; the run that it was to replace is kept: without {root / RECORD_NAME} --resume goes on with that one"
        raise HaustraError(
            f"{root} is a run of another video; --resume needs the same one, --overwrite replaces it"
            + (kept if is_kept(root) else "")
        )
    fixed = workspace.retired_settings
    if fixed:
        raise HaustraError(f"{root} was run with another setting ({fixed[0]}); use --overwrite")
    different = workspace.config.differences(config)
    if None not in (workspace.config.scale_file, config.scale_file):  # one file by another path is the same
        different = [difference for difference in different if not difference.startswith("scale_file:")]
    other = beyond_surface(different, config)
    if other:
        raise HaustraError(f"{root} was run with other settings ({other[0]}); repeat them, or use --overwrite")
    others = [name for name in changed if name not in OF_SURFACE]
    if others:
        raise HaustraError(f"{root} was run with another {others[0]}; its contents have changed since")
    if different or changed:
        if FROM_SURFACE[0] in workspace.record["stages"]:
            workspace.made_anew = different[0] if different else f"the {changed[0]} has changed"
            workspace.set_aside()
        workspace.undo(FROM_SURFACE)
    if different or changed or workspace.record["source"]["path"] != str(source.resolve()):
        workspace.record |= {"source": record_inputs(source, config), "config": config.model_dump(mode="json")}
        workspace.save()
