"""A stage of the run: done already, and loaded, or made now."""

from collections.abc import Callable
from typing import TypeVar

from pipeline.run_folder.malloc import give_back_freed_memory
from pipeline.run_folder.workspace import Workspace

T = TypeVar("T")


def load_or_make(workspace: Workspace, stage: str, load: Callable[[], T], make: Callable[[], None]) -> T:
    """What `load` gives of a finished stage; `make` runs first where it is not finished, writes its artefacts, and
    records it by `Workspace.finish` when they are whole."""
    if not workspace.is_done(stage):
        make()
        give_back_freed_memory()
    return load()
