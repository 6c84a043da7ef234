"""Which runs lie in a folder, and what is said of each before it is opened."""

import json
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import yaml

from pipeline.run_folder.earlier_run import RECORD_NAME
from pipeline.run_folder.workspace import REFUSED
from pipeline.surface.scale import unit_label

DEEPEST = 2  # folders below the one that is shown
MOST_RUNS = 500
BATCH_TABLE = "batch.json"  # as `haustra batch` leaves it


@dataclass(frozen=True)
class RunRow:
    """One line of the list. Figures are None where the run has none yet; `status`: finished, stopped, refused, damaged,
    or failed (a film of a batch that has no run); `words`: why, or the run's warnings."""

    name: str
    status: str
    words: tuple[str, ...] = ()
    posed: int | None = None
    total: int | None = None
    seen_percent: float | None = None
    area: float | None = None
    unit: str = ""
    submaps: int | None = None
    warnings: int = 0
    settings: str = ""
    picture: int | None = None  # number of a frame that stands for the film
    changed: float = 0.0

    def to_dict(self) -> dict[str, Any]:
        return asdict(self)


def find_runs(folder: Path) -> dict[str, Path]:
    """Run folders in a folder, or itself, by the name that the pages call them: their path from there."""
    if (folder / RECORD_NAME).is_file():
        return {folder.resolve().name: folder}
    found: dict[str, Path] = {}
    level = [folder]
    for _ in range(DEEPEST):
        inner = [path for parent in level for path in _folders_in(parent)]
        found |= {path.relative_to(folder).as_posix(): path for path in inner if (path / RECORD_NAME).is_file()}
        level = [path for path in inner if not (path / RECORD_NAME).is_file()]
    return dict(list(found.items())[:MOST_RUNS])


def rows_of(folder: Path) -> list[RunRow]:
    """A row of every run, and of every film of a batch that came to none."""
    runs = find_runs(folder)
    rows = [row_of(name, path) for name, path in runs.items()]
    if runs.get(folder.resolve().name) == folder:
        return rows
    inner = [path for path in _folders_in(folder) if not (path / RECORD_NAME).is_file()]
    return rows + [row for batch in (folder, *inner) for row in _without_run(batch, folder) if row.name not in runs]


def _without_run(batch: Path, folder: Path) -> list[RunRow]:
    """Films that the batch's table says have failed; none where there is no table, or one too damaged to say."""
    table = batch / BATCH_TABLE
    try:
        changed, batch_rows = table.stat().st_mtime, json.loads(table.read_text())
        return [
            RunRow(
                (batch / Path(one["folder"]).name).relative_to(folder).as_posix(),
                "failed",
                (str(one["message"]),),
                changed=changed,
            )
            for one in batch_rows
            if one["status"] == "failed"
        ]
    except (OSError, ValueError, KeyError, TypeError):
        return []


def _folders_in(parent: Path) -> list[Path]:
    """Those that may be read; another user's are passed over."""
    try:
        return [path for path in sorted(parent.iterdir()) if path.is_dir()]
    except OSError:
        return []


def row_of(name: str, folder: Path) -> RunRow:
    """What a run's own files say; a damaged one is a line too."""
    changed = (folder / RECORD_NAME).stat().st_mtime
    try:
        record = yaml.safe_load((folder / RECORD_NAME).read_text())
        stages, settings = record["stages"], _settings(record["config"])
        if "report" not in stages or not (folder / "metrics.json").exists():
            status, words = ("refused", str(record[REFUSED])) if REFUSED in record else ("stopped", _stopped(stages))
            return RunRow(name, status, (words,), settings=settings, changed=changed)
        metrics = json.loads((folder / "metrics.json").read_text())
        return _finished(name, metrics, settings, _middle_keyframe(folder), changed)
    except (OSError, ValueError, KeyError, TypeError, IndexError, AttributeError, yaml.YAMLError):
        return RunRow(name, "damaged", ("its record cannot be read",), changed=changed)


def _finished(name: str, metrics: dict[str, Any], settings: str, picture: int | None, changed: float) -> RunRow:
    main, frames = metrics["submaps"][0], metrics["frames"]
    seen, doubted = main["coverage"], metrics["warnings"]
    return RunRow(
        name,
        "finished",
        tuple(doubted),
        frames["posed"],
        frames["total"],
        seen["covered_percent"] if seen["judged"] else None,
        main["area"],
        unit_label(main["unit"]),
        len(metrics["submaps"]),
        len(doubted),
        settings,
        picture,
        changed,
    )


def _middle_keyframe(folder: Path) -> int | None:
    keyframes = sorted(int(path.stem) for path in (folder / "depth").glob("*.png"))
    return keyframes[len(keyframes) // 2] if keyframes else None


def _stopped(stages: dict[str, Any]) -> str:
    return f"after {list(stages)[-1]}" if stages else "before its first stage was done"


def _settings(config: dict[str, Any]) -> str:
    """What tells two runs of one film apart."""
    return f"{config.get('front_end', '')}, seed {config.get('seed', '')}"
