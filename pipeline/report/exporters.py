"""What a finished run is exported as: its mesh, by `MESH_FORMATS`, or the whole run, by `EXPORTERS`.

A new format of whole runs is a file with its writer and a row of `EXPORTERS` (docs/extending.md).
"""

import shutil
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

from haustra.core.errors import HaustraError
from reconstruction.mesh.formats import MESH_FORMATS

Exporter = Callable[[Path, Path], Path]  # (run folder, file to write) -> the file


def _rerun(run: Path, target: Path) -> Path:
    from pipeline.report.rerun_export import export_rerun

    return export_rerun(run, target)


# By the file's suffix. What needs a package that is not always installed is imported as it is called.
EXPORTERS: dict[str, Exporter] = {
    ".rrd": _rerun,
}


def export_run(run: Path, target: Path, max_error: float | None = None, texture: bool = False) -> str:
    """Write a finished run in the format of `target`'s suffix and say what was written.

    max_error, texture: of a mesh, as `export_mesh` has them.
    """
    suffix = target.suffix.lower()
    if suffix in EXPORTERS:
        if max_error is not None or texture:
            raise HaustraError(f"{target.name}: --max-error and --texture are for {_listed(tuple(MESH_FORMATS))} only")
        return str(EXPORTERS[suffix](run, target))
    if suffix not in MESH_FORMATS:
        raise HaustraError(f"{target.name}: a run is exported as {described_formats()}")
    from pipeline.report.mesh_export import export_mesh

    return export_mesh(run, target, max_error, texture)


def export_folder(run: Path, target: Path, program: str) -> str:
    """Write a finished run's first submap as a folder for a program of `FOLDER_EXPORTERS`, and say what was written.

    What an error or Ctrl-C leaves half written goes, with the folders made for it: it would look whole, and refuse the
    same command.
    """
    from pipeline.finished_run import open_run
    from pipeline.report.folder_exports.keyframe_views import empty_folder
    from pipeline.report.folder_exports.registry import FOLDER_EXPORTERS

    finished = open_run(run)
    made = [folder for folder in (target, *target.parents) if not folder.exists()]  # the innermost first
    empty_folder(target)
    try:
        return str(FOLDER_EXPORTERS[program](finished, target))
    except BaseException:
        for left in target.iterdir():
            shutil.rmtree(left) if left.is_dir() else left.unlink()
        for folder in made:
            with suppress(OSError):  # somebody else's file may lie in it by now
                folder.rmdir()
        raise


def described_formats() -> str:
    """The suffixes of both tables, for help and refusals."""
    return f"{_listed(tuple(MESH_FORMATS))} (the mesh), or {_listed(tuple(EXPORTERS))} (the whole run)"


def _listed(suffixes: tuple[str, ...]) -> str:
    *first, last = suffixes
    return f"{', '.join(first)} or {last}" if first else last
