"""`haustra view FOLDER`: serve the runs of a folder until Ctrl-C."""

from collections.abc import Callable
from pathlib import Path

from haustra.core.errors import HaustraError
from pipeline.report.server import serve
from pipeline.report.viewer.folder_server import FolderServer
from pipeline.report.viewer.run_list import find_runs


def view_folder(folder: Path, port: int, open_browser: bool, say: Callable[[str], None]) -> None:
    """HaustraError where the folder holds no run."""
    if not folder.is_dir() or not find_runs(folder):
        raise HaustraError(f"{folder} is not a run folder (it has no run.yaml), and no run lies in it")
    serve(lambda: FolderServer(folder, port), port, f"the runs of {folder}", open_browser, say)
