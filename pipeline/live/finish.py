"""What a live session leaves: its record, its recording, and the ordinary run made of that."""

import json
import shutil
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from haustra.core.errors import HaustraError
from haustra.core.progress import Progress
from pipeline.config import Config, read_recorded
from pipeline.finished_run import Run
from pipeline.run import reconstruct
from pipeline.run_folder.creating import UNFINISHED_START
from pipeline.run_folder.earlier_run import RECORD_NAME, forget, is_kept, mend_stopped
from pipeline.run_folder.lock import RunLock
from pipeline.run_folder.workspace import (
    LIVE_FILM,
    LIVE_FOLDER,
    LIVE_RECORD,
    remove_run,
    report_corruption,
    write_json,
)


@dataclass(frozen=True)
class LiveRecord:
    """`live.json`: what was looked at, where it is recorded, with which settings, and the session's figures."""

    source: str
    recording: Path
    config: Config
    figures: dict[str, Any]


def take_folder(folder: Path, overwrite: bool) -> RunLock:
    """The folder of a session, made and locked; HaustraError for one that holds another, unless `overwrite`.

    What it holds stays until `begin_record`."""
    if folder.exists() and not folder.is_dir():
        raise HaustraError(f"the output {folder} is a file; give a folder")
    if (folder / LIVE_FOLDER).exists() and not (folder / LIVE_RECORD).exists():
        raise HaustraError(f"{folder / LIVE_FOLDER} is there and of no session; give another output folder")
    taken = (RECORD_NAME, LIVE_RECORD, LIVE_FILM)
    if any((folder / name).exists() for name in taken) or is_kept(folder):
        if not overwrite:
            is_session = (folder / LIVE_RECORD).exists()  # others cannot be finished from here
            ways = "--resume finishes it" if is_session else "give another folder (-o)"
            raise HaustraError(f"{folder} already holds a session or run; {ways}, --overwrite replaces it")
    elif folder.exists() and any(path.name not in UNFINISHED_START for path in folder.iterdir()):
        raise HaustraError(f"the folder {folder} is not empty and holds no run; give another output folder")
    try:
        folder.mkdir(parents=True, exist_ok=True)
        lock = RunLock(folder)
    except OSError as error:
        raise HaustraError(f"cannot create the output folder {folder}: {error.strerror}") from error
    remove_scratch(folder)
    return lock


def begin_record(folder: Path, source: str, recording: Path, config: Config) -> None:
    """The record of a session in a folder that was taken; an earlier session or run in it goes."""
    mend_stopped(folder)
    if (folder / RECORD_NAME).exists():
        remove_run(folder)
    forget(folder)
    write_record(folder, LiveRecord(source, recording, config, {}))


def write_record(folder: Path, record: LiveRecord) -> None:
    """Replace `live.json`."""
    values = {"source": record.source, "recording": str(record.recording.resolve())}
    write_json(folder / LIVE_RECORD, values | {"config": record.config.model_dump(mode="json"), **record.figures})


def remove_scratch(folder: Path) -> None:
    """Remove the keyframes that a session kept for its own use."""
    shutil.rmtree(folder / LIVE_FOLDER, ignore_errors=True)


def read_record(folder: Path) -> LiveRecord:
    """HaustraError where the folder holds no session."""
    path = folder / LIVE_RECORD
    if not path.exists():
        raise HaustraError(f"{folder} holds no live session: it has no {LIVE_RECORD}")
    with report_corruption(path):
        values = json.loads(path.read_text())
        recording = Path(values.pop("recording"))
        if not recording.exists() and (folder / recording.name).exists():  # the folder was moved
            recording = folder / recording.name
        return LiveRecord(values.pop("source"), recording, read_recorded(values.pop("config")), values)


def finish_run(folder: Path, progress: Progress) -> Run:
    """The run of what was recorded, gone on with where it was begun already; the session's scratch is removed.

    HaustraError where nothing was recorded."""
    record = read_record(folder)
    if not record.recording.exists():
        raise HaustraError(f"nothing was recorded of {record.source}")
    resume = (folder / RECORD_NAME).exists()
    run = reconstruct(record.recording, folder, record.config, resume=resume, progress=progress)
    remove_scratch(folder)
    return run
