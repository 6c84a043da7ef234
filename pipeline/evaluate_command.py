"""`haustra evaluate`: depth completion on folders with truth, per frame and in mean, with its protocol beside it."""

import json
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import groupby
from pathlib import Path
from typing import Any, get_args

from completion.calibration import Calibration, calibrate, relative_errors
from completion.errors import CompletionError
from completion.evaluate import (
    FrameResult,
    Protocol,
    evaluate_frames,
    markdown_table,
    mean_errors,
    paper_row,
    write_csv,
)
from completion.infer import error_from_confidence
from completion.metrics import Alignment, Averaging, simcol3d_errors
from completion.predictors import load_predictor
from completion.readers import read_evaluation_frames
from completion.sheets import calibration_plot, contact_sheet, sweep_plot
from completion.sparsify import SAMPLERS
from pipeline.progress import Progress


@dataclass(frozen=True)
class Outputs:
    """Where to write; None writes nothing."""

    csv: Path | None = None
    json: Path | None = None
    sheet: Path | None = None
    sweep: Path | None = None
    calibration: Path | None = None


def protocol_of(sampler: str, points: int, align: str, averaging: str, seed: int, stride: int) -> Protocol:
    """Checked by name, so that a slip is one sentence."""
    for name, value, known in (
        ("sampler", sampler, tuple(SAMPLERS)),
        ("alignment", align, get_args(Alignment)),
        ("averaging", averaging, get_args(Averaging)),
    ):
        if value not in known:
            raise CompletionError(f"no {name} {value!r}; known: {', '.join(known)}")
    values: dict[str, Any] = {"alignment": align, "averaging": averaging}
    return Protocol(sampler=sampler, points=points, seed=seed, stride=stride, **values)


def evaluate(
    folders: Sequence[Path],
    models: Sequence[str],
    protocols: Sequence[Protocol],
    outputs: Outputs,
    kind: str | None,
    progress: Progress,
) -> str:
    """Markdown tables, one per folder and protocol, a row per model; files as `outputs` says."""
    predictors = {model: load_predictor(model) for model in models}  # all of them, before any work
    tables: list[str] = []
    records: list[dict[str, Any]] = []
    for folder in folders:
        frames = list(read_evaluation_frames(folder, kind))
        if not frames:
            raise CompletionError(f"{folder} has no frames")
        for protocol in protocols:
            rows = []
            for model, predictor in predictors.items():
                with progress.bar(f"{folder.name} {model}", len(frames)) as advance:
                    results = list(evaluate_frames(frames, predictor, protocol, advance))
                record = _record(folder.name, model, protocol, results, frames[0].unit)
                records.append(record)
                rows.append((model, paper_row(mean_errors(results, protocol), frames[0].unit)))
                _write_pictures(outputs, results, record, len(folders) * len(models) * len(protocols) > 1)
            tables.append(f"**{folder.name}**: {len(results)} frames, {protocol}\n\n{markdown_table(rows)}")
    if outputs.calibration:
        found = {_label(r): Calibration(**r["calibration"]) for r in records if r["calibration"]}
        if not found:
            raise CompletionError("none of these models predicts its own error: nothing to calibrate")
        calibration_plot(outputs.calibration, found)
    if outputs.json:
        outputs.json.write_text(json.dumps(records, indent=1) + "\n")
    if outputs.sweep:
        sweep_plot(
            outputs.sweep, _curves(records), f"{len(records[0]['frames'])} frames; {protocols[0].averaging} mean"
        )
    return "\n\n".join(tables)


def _record(folder: str, model: str, protocol: Protocol, results: Sequence[FrameResult], unit: str) -> dict[str, Any]:
    """Everything about one figure, for JSON."""
    sure = [(r, r.confidence) for r in results if r.confidence is not None]
    pairs = (relative_errors(r.prediction, r.truth, error_from_confidence(c)) for r, c in sure)
    simcol = simcol3d_errors((result.prediction, result.truth) for result in results)
    return {
        "folder": folder,
        "model": model,
        "unit": unit,
        "protocol": protocol.model_dump(),
        "mean": mean_errors(results, protocol).to_dict(),
        "simcol3d": simcol.__dict__,
        "calibration": calibrate(pairs).to_dict() if sure else None,
        "points": {"least": min(r.points for r in results), "most": max(r.points for r in results)},
        "frames": [{"frame": r.name, "points": r.points, **r.errors.to_dict()} for r in results],
    }


def _write_pictures(outputs: Outputs, results: Sequence[FrameResult], record: dict[str, Any], several: bool) -> None:
    """CSV and contact sheet; with several figures each file's name says which it is."""
    protocol = record["protocol"]
    label = _label(record)
    if outputs.csv:
        write_csv(_named(outputs.csv, label, several), results)
    if outputs.sheet:
        title = f"{record['folder']}, {record['model']}: {Protocol(**protocol)}"
        contact_sheet(_named(outputs.sheet, label, several), results, title, record["unit"])


def _label(record: dict[str, Any]) -> str:
    protocol = record["protocol"]
    model = Path(record["model"]).name
    return f"{record['folder']}_{model}_{protocol['sampler']}{protocol['points']}"


def _named(path: Path, label: str, several: bool) -> Path:
    return path.with_name(f"{path.stem}_{label}{path.suffix}") if several else path


def _curves(records: Sequence[dict[str, Any]]) -> dict[str, dict[int, float]]:
    """abs.REL by points for each (folder, model, sampler)."""

    def key(record: dict[str, Any]) -> str:
        return f"{record['folder']}, {record['model']}, {record['protocol']['sampler']}"

    ordered = sorted(records, key=lambda record: (key(record), record["protocol"]["points"]))
    return {
        name: {record["protocol"]["points"]: record["mean"]["abs_rel"] for record in group}
        for name, group in groupby(ordered, key)
    }
