"""The programs that a run is exported to as a folder. A new one is a file with its writer and a row here."""

from collections.abc import Callable
from pathlib import Path

from pipeline.finished_run import Run
from pipeline.report.folder_exports.colmap import export_colmap
from pipeline.report.folder_exports.nerfstudio import export_nerfstudio
from pipeline.report.folder_exports.slicer import export_slicer

FOLDER_EXPORTERS: dict[str, Callable[[Run, Path], Path]] = {  # by the name of the option
    "nerfstudio": export_nerfstudio,
    "colmap": export_colmap,
    "slicer": export_slicer,
}
