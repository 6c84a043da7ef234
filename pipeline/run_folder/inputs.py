"""What a run depends on outside its folder: the source, and the files that its settings name."""

import hashlib
from contextlib import suppress
from pathlib import Path
from typing import Any

from pipeline.config import Config
from pipeline.run_folder.lock import NAME as LOCK_NAME

OF_PARTS = "parts:"  # begins a folder's digest
PART, PARTS = 4096, (0.0, 0.25, 0.5, 0.75, 1.0)  # bytes of each file, and how far into it
LEFT_BY_BROWSERS = ("Thumbs.db", "desktop.ini", "@eaDir")
PARTIAL = ".partial"

Record = dict[str, Any]  # as under `source` in run.yaml: path, sha256 and stamps, the two by the input's name


def record_inputs(source: Path, config: Config) -> Record:
    """The inputs as they are now."""
    files = inputs_of(source, config)
    stamps = {name: _stamp(path) for name, path in files.items()}  # before the digests: a later change shows
    return {
        "path": str(source.resolve()),
        "sha256": {name: digest(path) for name, path in files.items()},
        "stamps": {name: stamp for name, stamp in stamps.items() if stamp is not None},
    }


def changed_inputs(source: Path, config: Config, record: Record, trust_stamps: bool = False) -> list[str]:
    """Names of the inputs that are not those of the record. Where `trust_stamps`, a file of the same size and time of
    change is not read again."""
    files, then = inputs_of(source, config), record["sha256"]
    stamps = record.get("stamps", {}) if trust_stamps else {}

    def is_same(name: str) -> bool:
        if name not in files or name not in then:
            return False
        untouched = name in stamps and stamps[name] == _stamp(files[name])
        return untouched or _is_same_content(files[name], then[name])

    return [name for name in sorted(then.keys() | files.keys()) if not is_same(name)]


def inputs_of(source: Path, config: Config) -> dict[str, Path]:
    named = {"camera file": config.camera, "scale file": config.scale_file, "model file": config.model}
    named |= {"poses": config.poses.file, "hand-eye transform": config.poses.hand_eye}
    named |= {"depth folder": config.sensor.folder, "stereo calibration": config.stereo.calibration}
    lamp = config.lamp_file
    named |= {"right eye": config.stereo.right, "lamp file": None if lamp is None else str(lamp)}
    if source.is_dir():
        named["camera file"] = str(source / "camera.json") if config.camera == "auto" else config.camera
    files = {name: Path(path) for name, path in named.items() if path is not None}
    return {"source": source} | {
        name: path for name, path in files.items() if path.is_file() or name in ("poses", "depth folder", "right eye")
    }


def _is_same_content(path: Path, recorded: str) -> bool:
    if path.is_dir() and not recorded.startswith(OF_PARTS):
        return _digest_of_sizes(path) == recorded
    return digest(path) == recorded


def _digest_of_folder(folder: Path) -> str:
    sha = hashlib.sha256()
    locked = {path.parent for path in folder.rglob(LOCK_NAME)} - {folder}
    runs = {path for path in locked if (path / "run.yaml").is_file()}
    for path in sorted(folder.rglob("*")):
        parts = path.relative_to(folder).parts
        foreign = any(part.startswith(".") or part in LEFT_BY_BROWSERS for part in parts) or path.suffix == PARTIAL
        if foreign or not path.is_file() or not runs.isdisjoint(path.parents):
            continue
        size = path.stat().st_size
        sha.update(f"{path.relative_to(folder)} {size}\n".encode(errors="surrogateescape"))
        with suppress(PermissionError), path.open("rb") as file:
            for share in PARTS:
                file.seek(int(share * max(0, size - PART)))
                sha.update(file.read(PART))
    return OF_PARTS + sha.hexdigest()


def _digest_of_sizes(folder: Path) -> str:
    """As runs of version 0.1 have it: of the names and sizes of all files."""
    sha = hashlib.sha256()
    for path in sorted(folder.rglob("*")):
        if path.is_file():
            sha.update(f"{path.relative_to(folder)} {path.stat().st_size}\n".encode())
    return sha.hexdigest()


def _stamp(path: Path) -> list[int] | None:
    """Size and time of change of a file; none of a folder, whose time says nothing about what is in it."""
    if path.is_dir():
        return None
    state = path.stat()
    return [state.st_size, state.st_mtime_ns]


def digest(source: Path) -> str:
    """SHA-256 of a file; of a folder, of its files' names and sizes, and of parts of each, since pictures that are not
    compressed have one size. Runs in the folder, and what file browsers leave in it, do not belong to it."""
    if source.is_dir():
        return _digest_of_folder(source)
    sha = hashlib.sha256()
    with source.open("rb") as file:
        while block := file.read(1 << 20):
            sha.update(block)
    return sha.hexdigest()
