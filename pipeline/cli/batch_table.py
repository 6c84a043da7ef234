"""What became of each video of a batch: a table for the terminal, `batch.csv` and `batch.json`."""

import csv
import io
import json
from collections import Counter
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Any

from haustra.core.text import counted, write_text
from pipeline.run_folder.workspace import Workspace, write_json

KEPT = "kept"


@dataclass(frozen=True)
class Outcome:
    """One row. Figures are of the largest submap, None where there is no finished run."""

    video: str
    folder: str
    status: str  # done, kept (finished by an earlier call), failed, stopped, not started
    minutes: float | None = None
    posed: int | None = None
    frames: int | None = None
    area: float | None = None
    unit: str | None = None
    covered_percent: float | None = None
    message: str = ""

    @property
    def sentence(self) -> str:
        tail = f": {self.message}" if self.message else ""
        return f"{self.name} {self.status}{tail}"

    @property
    def name(self) -> str:
        """Name of the video, in letters that any file takes: names on disk are bytes."""
        return _printable(Path(self.video).name)


def finished_outcome(video: Path, folder: Path, status: str = KEPT, minutes: float | None = None) -> Outcome:
    """The figures of a finished run."""
    try:
        metrics: dict[str, Any] = json.loads(Workspace(folder).metrics.read_text())
        main = metrics["submaps"][0]
        covered = main["coverage"].get("covered_percent")
        return Outcome(
            str(video),
            str(folder),
            status,
            minutes,
            int(metrics["frames"]["posed"]),
            int(metrics["frames"]["total"]),
            float(main["area"]),
            str(main["unit"]),
            None if covered is None else float(covered),
            "; ".join(metrics["warnings"]),
        )
    except Exception as error:  # noqa: BLE001 # whatever a file may hold
        return Outcome(str(video), str(folder), "failed", minutes, message=f"its metrics.json cannot be read ({error})")


def write_table(outcomes: list[Outcome], output: Path) -> None:
    """`batch.csv` and `batch.json`, each replaced as a whole."""
    names = [field.name for field in fields(Outcome)]
    text = io.StringIO()
    table = csv.DictWriter(text, names, lineterminator="\n")
    table.writeheader()
    table.writerows(asdict(outcome) for outcome in outcomes)
    write_text(output / "batch.csv", _printable(text.getvalue()))
    write_json(output / "batch.json", [asdict(outcome) for outcome in outcomes])


def print_table(outcomes: list[Outcome]) -> None:
    """On standard output; what is said of each video in lines of its own below, where there is room."""
    from rich.console import Console
    from rich.table import Table
    from rich.text import Text  # unlike a string, it holds no markup

    counts = ", ".join(f"{n} {status}" for status, n in Counter(outcome.status for outcome in outcomes).items())
    table = Table(title=f"{counted(len(outcomes), 'video')}: {counts}", title_justify="left")
    names = _told_apart(outcomes)
    for name in ("video", "status", "min", "posed", "area", "seen"):
        table.add_column(name, justify="right" if name in ("min", "posed", "area", "seen") else "left")
    for name, o in zip(names, outcomes, strict=True):
        table.add_row(
            Text(name),
            Text(o.status, style="red" if o.status == "failed" else ""),
            _shown(o.minutes, "{:.1f}"),
            "" if o.posed is None else f"{o.posed}/{o.frames}",
            _shown(o.area, "{:.4g} " + ("mm²" if o.unit == "mm" else "scene units²")),
            _shown(o.covered_percent, "{:.0f} %"),
        )
    console = Console(highlight=False)
    console.print(table)
    for name, o in zip(names, outcomes, strict=True):
        if o.message:
            console.print(Text.assemble((name, "bold"), f": {o.message}"))


def _told_apart(outcomes: list[Outcome]) -> list[str]:
    """The videos' names; with its run folder's where several videos have one name."""
    often = Counter(outcome.name for outcome in outcomes)
    return [o.name if often[o.name] == 1 else f"{o.name} (in {_printable(Path(o.folder).name)})" for o in outcomes]


def _printable(text: str) -> str:
    return text.encode(errors="backslashreplace").decode()


def _shown(value: float | None, form: str) -> str:
    return "" if value is None else form.format(value)
