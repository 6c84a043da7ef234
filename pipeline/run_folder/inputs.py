"""What a run depends on outside its folder: the source, and the files that its settings name."""

import hashlib
from pathlib import Path
from typing import Any

from pipeline.config import Config

Record = dict[str, Any]  # as under `source` in run.yaml: path, sha256 and stamps, the two by the input's name


def record_inputs(source: Path, config: Config) -> Record:
    """The inputs as they are now."""
    files = _inputs(source, config)
    stamps = {name: _stamp(path) for name, path in files.items()}  # before the digests: a later change shows
    return {
        "path": str(source.resolve()),
        "sha256": {name: digest(path) for name, path in files.items()},
        "stamps": {name: stamp for name, stamp in stamps.items() if stamp is not None},
    }


def changed_inputs(source: Path, config: Config, record: Record, trust_stamps: bool = False) -> list[str]:
    """Names of the inputs that are not those of the record. Where `trust_stamps`, a file of the same size and time of
    change is not read again."""
    files, then = _inputs(source, config), record["sha256"]
    stamps = record.get("stamps", {}) if trust_stamps else {}

    def is_same(name: str) -> bool:
        if name not in files or name not in then:
            return False
        untouched = name in stamps and stamps[name] == _stamp(files[name])
        return untouched or digest(files[name]) == then[name]

    return [name for name in sorted(then.keys() | files.keys()) if not is_same(name)]


def _inputs(source: Path, config: Config) -> dict[str, Path]:
    named = {"camera file": config.camera, "scale file": config.scale_file, "model file": config.model}
    named |= {"poses": config.poses.file, "hand-eye transform": config.poses.hand_eye}
    named |= {"depth folder": config.sensor.folder, "stereo calibration": config.stereo.calibration}
    named |= {"right eye": config.stereo.right}
    if source.is_dir():
        named["camera file"] = str(source / "camera.json") if config.camera == "auto" else config.camera
    files = {name: Path(path) for name, path in named.items() if path is not None}
    return {"source": source} | {
        name: path for name, path in files.items() if path.is_file() or name in ("poses", "depth folder", "right eye")
    }


def _stamp(path: Path) -> list[int] | None:
    """Size and time of change of a file; none of a folder, whose time says nothing about what is in it."""
    if path.is_dir():
        return None
    state = path.stat()
    return [state.st_size, state.st_mtime_ns]


def digest(source: Path) -> str:
    """SHA-256 of a video; of an image folder, of its file names and sizes."""
    sha = hashlib.sha256()
    if source.is_dir():
        for path in sorted(source.rglob("*")):
            if path.is_file():
                sha.update(f"{path.relative_to(source)} {path.stat().st_size}\n".encode())
        return sha.hexdigest()
    with source.open("rb") as file:
        while block := file.read(1 << 20):
            sha.update(block)
    return sha.hexdigest()
