"""What became of each video of a batch: a table for the terminal, `batch.csv` and `batch.json`."""

import csv
import io
import json
from collections import Counter
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Any

from pipeline.workspace import Workspace, write_json, write_text


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
        return f"{Path(self.video).name} {self.status}{tail}"


def finished_outcome(video: Path, folder: Path, status: str = "kept", minutes: float | None = None) -> Outcome:
    """The figures of a finished run."""
    try:
        metrics: dict[str, Any] = json.loads(Workspace(folder).metrics.read_text())
        main = metrics["submaps"][0]
        return Outcome(
            str(video),
            str(folder),
            status,
            minutes,
            metrics["frames"]["posed"],
            metrics["frames"]["total"],
            main["area"],
            main["unit"],
            main["coverage"].get("covered_percent"),
            "; ".join(metrics["warnings"]),
        )
    except (OSError, ValueError, KeyError, IndexError) as error:
        return Outcome(str(video), str(folder), "failed", minutes, message=f"its metrics.json cannot be read ({error})")


def write_table(outcomes: list[Outcome], output: Path) -> None:
    """`batch.csv` and `batch.json`, each replaced as a whole."""
    names = [field.name for field in fields(Outcome)]
    text = io.StringIO()
    table = csv.DictWriter(text, names, lineterminator="\n")
    table.writeheader()
    table.writerows(asdict(outcome) for outcome in outcomes)
    write_text(output / "batch.csv", text.getvalue())
    write_json(output / "batch.json", [asdict(outcome) for outcome in outcomes])


def print_table(outcomes: list[Outcome]) -> None:
    """On standard output."""
    from rich.console import Console
    from rich.table import Table

    counts = ", ".join(f"{n} {status}" for status, n in Counter(outcome.status for outcome in outcomes).items())
    table = Table(title=f"{len(outcomes)} videos: {counts}", title_justify="left")
    for name in ("video", "status", "min", "posed", "area", "seen", "message"):
        table.add_column(name, justify="right" if name in ("min", "posed", "area", "seen") else "left")
    for o in outcomes:
        table.add_row(
            Path(o.video).name,
            f"[red]{o.status}[/red]" if o.status == "failed" else o.status,
            _shown(o.minutes, "{:.1f}"),
            "" if o.posed is None else f"{o.posed}/{o.frames}",
            _shown(o.area, "{:.4g} " + ("mm²" if o.unit == "mm" else "units²")),
            _shown(o.covered_percent, "{:.0f} %"),
            _plain(o.message),
        )
    Console(highlight=False).print(table)


def _plain(text: str) -> str:
    """Brackets in a message are no markup."""
    from rich.markup import escape

    return escape(text)


def _shown(value: float | None, form: str) -> str:
    return "" if value is None else form.format(value)
