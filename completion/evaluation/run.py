"""`haustra evaluate`: depth completion on folders with truth, per frame and in mean, with its protocol beside it."""

import os
from collections.abc import Iterator, Sequence
from contextlib import AbstractContextManager, suppress
from functools import partial
from itertools import groupby
from pathlib import Path
from typing import Any, get_args

import numpy as np
from numpy.typing import NDArray

from completion.data.evaluation_frame import EvaluationFrame
from completion.data.readers import read_evaluation_frames, recognise
from completion.data.sampling_benchmark import SAMPLERS
from completion.evaluation.accumulator import Accumulator
from completion.evaluation.evaluate import (
    FrameResult,
    Protocol,
    evaluate_frames,
    markdown_table,
    mean_errors,
    paper_row,
    write_csv,
)
from completion.evaluation.metrics import Alignment, Averaging
from completion.evaluation.outputs import Outputs
from completion.evaluation.plots import (
    attention_plot,
    calibration_plot,
    comparison_plot,
    sample_frames_plot,
    sweep_plot,
)
from completion.evaluation.predictors import Predictor, load_predictor
from completion.evaluation.uncertainty import ErrorCalibration
from haustra.core.errors import CompletionError
from haustra.core.progress import Progress, ProgressCallback
from haustra.core.text import counted, json_text, write_text


def protocol_of(
    sampler: str, points: int, align: str, averaging: str, seed: int, stride: int, depth_step: float = 0.0
) -> Protocol:
    """A `Protocol`; CompletionError names the known values of a setting that has another."""
    for name, value, known in (
        ("sampler", sampler, tuple(SAMPLERS)),
        ("alignment", align, get_args(Alignment)),
        ("averaging", averaging, get_args(Averaging)),
    ):
        if value not in known:
            raise CompletionError(f"no {name} {value!r}; known: {', '.join(known)}")
    values: dict[str, Any] = {"alignment": align, "averaging": averaging, "depth_step": depth_step}
    return Protocol(sampler=sampler, points=points, seed=seed, stride=stride, **values)


def evaluate(
    folders: Sequence[Path],
    models: Sequence[str],
    protocols: Sequence[Protocol],
    outputs: Outputs,
    kind: str | None,
    progress: Progress,
) -> str:
    """Markdown tables as `evaluated_tables` gives them, below each other."""
    return "\n\n".join(evaluated_tables(folders, models, protocols, outputs, kind, progress))


def evaluated_tables(
    folders: Sequence[Path],
    models: Sequence[str],
    protocols: Sequence[Protocol],
    outputs: Outputs,
    kind: str | None,
    progress: Progress,
) -> Iterator[str]:
    """Markdown tables, one per folder and protocol, a row per model, each as soon as it is made; files as `outputs`
    says, with the names of those that had to be told apart below the tables. What was judged before an error or Ctrl-C
    is kept: in CSV each frame, in JSON each model that was finished, a record for each folder and protocol."""
    folders = [f if f.name not in ("", "..") else f.resolve() for f in folders]  # "." and ".." are no names
    for kind_of, names in (("model", [Path(m).name for m in models]), ("folder", [f.name for f in folders])):
        if len(set(names)) < len(names):
            raise CompletionError(f"two {kind_of}s have the same name, and the tables would not tell them apart")
    outputs.make_way()
    predictors = {model: load_predictor(model) for model in models}  # all of them, before any work
    outputs.check_models(predictors)
    several = len(folders) * len(protocols) > 1
    of_models = several or len(models) > 1
    renamed: list[Path] = []
    records: list[dict[str, Any]] = []
    for folder in folders:
        for protocol in protocols:
            rows, sample_frames = [], {}
            for model, predictor in predictors.items():
                label = _joined(folder.name, model, protocol.sampler, protocol.points)
                csv = outputs.csv and _named(outputs.csv, label, of_models)
                with Accumulator(trajectory=outputs.json is not None) as accumulator:
                    bar = progress.bar(f"{folder.name} {model}", None)
                    try:
                        unit = _run(folder, kind, predictor, protocol, accumulator, bar)
                    except BaseException as error:  # Ctrl-C and a full disk, too
                        kept = _keep_what_was_judged(accumulator, csv)
                        if isinstance(error, CompletionError) and kept:
                            raise CompletionError(f"{error}; {kept}") from error
                        raise
                    if csv:
                        write_csv(csv, accumulator.scores)
                        renamed += [csv] * of_models
                    records.append(_record(folder.name, model, predictor.precision, protocol, accumulator, unit))
                    if outputs.json:
                        _write_json(outputs.json, records)
                rows.append(
                    (_with_gaps(model, accumulator), paper_row(mean_errors(accumulator.scores, protocol), unit))
                )
                sample_frames[Path(model).name] = accumulator.sample_frames()
                renamed += _write_plots(outputs, accumulator, predictor, records[-1], of_models)
            precisions = sorted({p.precision for p in predictors.values() if p.precision})
            about = ", ".join([_frames_told(accumulator, protocol), *precisions])
            yield f"**{folder.name}**: {about}\n\n{markdown_table(rows)}"
            if outputs.compare:
                label = f"{folder.name}_{protocol.sampler}{protocol.points}"
                path = _named(outputs.compare, label, several)
                comparison_plot(path, sample_frames, f"{folder.name}: {about}")
                renamed += [path] * several
    if renamed:
        yield "written, one for each figure: " + ", ".join(map(str, renamed))
    _write_summaries(outputs, records)  # last: it may have too little to show


def _keep_what_was_judged(accumulator: Accumulator, csv: Path | None) -> str:
    """Write the frames judged before an error where a CSV was asked for, and say so; empty where there are none."""
    if not accumulator.scores:
        return ""
    before = f"{counted(len(accumulator.scores), 'frame')} judged before it"
    if csv is None:
        return f"{before} (--csv keeps such)"
    with suppress(Exception):  # the error itself is the one to be told
        write_csv(csv, accumulator.scores)
        return f"{before}: {csv}"
    return f"{before}, which {csv} could not take"


def _write_json(path: Path, records: Sequence[dict[str, Any]]) -> None:
    """Replaced as a whole; a link, a device and a file whose folder is closed are written in place."""
    in_place = path.is_symlink() or (path.exists() and not (path.is_file() and os.access(path.parent, os.W_OK)))
    text = json_text(records) + "\n"
    path.write_text(text) if in_place else write_text(path, text)


def _frames_told(accumulator: Accumulator, protocol: Protocol) -> str:
    """How many frames were judged, how many points they really had where fewer were found, and the protocol."""
    left_out, found = str(accumulator.left_out), [score.points for score in accumulator.scores]
    missing = f" ({left_out})" if left_out else ""
    least, most = min(found), max(found)
    span = str(least) if least == most else f"{least} to {most}"
    had = f" ({span} found in a frame)" if span != str(protocol.points) else ""
    return f"{counted(len(found), 'frame')}{missing}, {protocol.described(had)}"


def _with_gaps(model: str, accumulator: Accumulator) -> str:
    """The model, with the share of pixels that have truth but that it gave no depth: they are in no error."""
    missing = sum(score.errors.missing for score in accumulator.scores)
    known = missing + sum(score.errors.pixels for score in accumulator.scores)
    return f"{model} (no depth at {100 * missing / known:.2g} % of the pixels, in no error)" if missing else model


def _run(
    folder: Path,
    kind: str | None,
    predictor: Predictor,
    protocol: Protocol,
    accumulator: Accumulator,
    bar: AbstractContextManager[ProgressCallback],
) -> str:
    """Judge every frame, one in memory at a time; returns the unit of the truth."""
    unit = ""

    def frames() -> Iterator[EvaluationFrame]:
        nonlocal unit
        for frame in read_evaluation_frames(folder, kind):
            unit = frame.unit
            yield frame

    with bar as advance:
        accumulator.add_all(evaluate_frames(frames(), predictor, protocol, advance, accumulator.left_out))
    if not accumulator.scores:
        layout, left_out = kind or recognise(folder), accumulator.left_out
        if left_out.without_points:
            raise CompletionError(
                f"the sampler {protocol.sampler!r} finds no point with true depth in any of "
                f"{counted(len(left_out.without_points), 'frame')} of {folder}; try --sampler uniform"
            )
        if left_out.without_others:
            given = f"most pixels with true depth are points that are given: {protocol.points} (--points) are too many"
            raise CompletionError(f"in {counted(len(left_out.without_others), 'frame')} of {folder} {given}")
        if left_out.without_truth:
            read = f"{counted(len(left_out.without_truth), 'frame')} of {folder} read as {layout}"
            raise CompletionError(f"{read}, and none has true depth: every pixel has the value that means none")
        raise CompletionError(f"{folder} has no frames, read as {layout}: no picture of that layout lies in it")
    return unit


def _write_summaries(outputs: Outputs, records: Sequence[dict[str, Any]]) -> None:
    """Write the plots that cover all records: sweep and calibration."""
    if outputs.sweep:
        judged = {record["folder"]: counted(len(record["frames"]), "frame") for record in records}
        counts = "; ".join(f"{folder}: {number}" for folder, number in judged.items())
        sweep_plot(outputs.sweep, _curves(records), f"{counts}; {Protocol(**records[0]['protocol']).conditions}")
    if outputs.calibration:
        found = {_label(r): ErrorCalibration(**r["calibration"]) for r in records if r["calibration"]}
        if not found:
            raise CompletionError("these frames have too few pixels with true depth to calibrate the predicted error")
        calibration_plot(outputs.calibration, found, {_label(r): r["strata"] for r in records if r["strata"]})


def _record(
    folder: str, model: str, precision: str | None, protocol: Protocol, accumulator: Accumulator, unit: str
) -> dict[str, Any]:
    """Errors of one folder, model and protocol, with all settings, for JSON."""
    calibration, simcol = accumulator.calibration(), accumulator.simcol3d()
    return {
        "folder": folder,
        "model": model,
        "precision": precision,
        "unit": unit,
        "protocol": protocol.model_dump(),
        "mean": mean_errors(accumulator.scores, protocol).to_dict(),
        "simcol3d": simcol.__dict__ if simcol else None,
        "calibration": calibration.to_dict() if calibration else None,
        "strata": {name: stratum.to_dict() for name, stratum in accumulator.strata().items()},
        "points": {
            "least": min(r.points for r in accumulator.scores),
            "most": max(r.points for r in accumulator.scores),
        },
        "left_out": accumulator.left_out.without_truth,
        "without_points": accumulator.left_out.without_points,
        "without_others": accumulator.left_out.without_others,
        "frames": [{"frame": r.name, "points": r.points, **r.errors.to_dict()} for r in accumulator.scores],
    }


def _write_plots(
    outputs: Outputs, accumulator: Accumulator, predictor: Predictor, record: dict[str, Any], several: bool
) -> list[Path]:
    """Write plots of one record; with several records return the files, whose names then tell them apart."""
    label = _label(record)
    title = f"{record['folder']}, {record['model']}: {Protocol(**record['protocol'])}"
    sheet, attention = (path and _named(path, label, several) for path in (outputs.sheet, outputs.attention))
    if sheet:
        sample_frames_plot(sheet, accumulator.sample_frames(), title, record["unit"])
    frames = (
        _attention(predictor, accumulator.sample_frames()) if attention else []
    )  # asked of the models that have one
    if attention and frames:
        attention_plot(attention, frames, title)
    return [path for path in (sheet, attention if frames else None) if path and several]


def _attention(
    predictor: Predictor, sample_frames: Sequence[FrameResult]
) -> list[tuple[FrameResult, NDArray[np.floating], NDArray[np.floating]]]:
    """Each frame with its features before and after structure awareness; empty for a model that has none."""
    from completion.networks.channel_attention import attention_features

    frames = []
    for frame in sample_frames:
        found = predictor.network and attention_features(
            predictor.network, partial(predictor, frame.rgb, frame.sparse, None)
        )
        if found:
            frames.append((frame, found[0].numpy(), found[1].numpy()))
    return frames


def _label(record: dict[str, Any]) -> str:
    protocol = record["protocol"]
    return _joined(record["folder"], record["model"], protocol["sampler"], protocol["points"])


def _joined(folder: str, model: str, sampler: str, points: int) -> str:
    """What tells the files of one record from those of others."""
    return f"{folder}_{Path(model).name}_{sampler}{points}"


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
