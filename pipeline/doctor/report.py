"""The whole text: findings of the machine, the self-test, and what may be told of a run."""

import re
from pathlib import Path
from typing import Any

import yaml

from haustra.core.errors import HaustraError
from pipeline.doctor import machine
from pipeline.doctor.machine import Finding
from pipeline.doctor.self_test import self_test

HIDDEN = "(hidden)"  # in place of paths and of names of files: they may name a patient
SUFFIXES = {".json", ".yaml", ".yml", ".txt", ".xml", ".ini", ".csv", ".mp4", ".safetensors", ".png", ".jpg", ".dcm"}
SHORTEST_NAME = 4  # letters of a folder's name that is hidden where it stands alone, too
ADVICE = (
    "For a bug report: this text, the command, and what the command printed. This text holds no path, no file name and "
    "no picture. The command and its output do hold names of films and folders, which may be a patient's: replace "
    "them. `haustra doctor RUN` adds settings and counts of a run. Send no film of a patient."
)


def examine(folder: Path, with_test: bool = True) -> list[Finding]:
    """All findings; folder: where runs would be written."""
    found = [*machine.versions(), *machine.processor(), machine.memory(), machine.disk(folder)]
    found += machine.libraries()
    if any(finding.verdict == "fault" for finding in found):
        return [*found, Finding("self-test", "left out", "note", "mend what is marked with ! first")]
    found += [machine.ffmpeg(), machine.gpu()]
    return found + (self_test() if with_test else [])


def facts_of_run(run: Path) -> str:
    """Settings, finished stages, counts and warnings of a run as YAML, without paths and names of files."""
    record = _read(run / "run.yaml")
    facts: dict[str, Any] = {name: record.get(name) for name in ("versions", "config")}
    facts["refused"] = record.get("refused")
    facts["stages"] = {name: _counts(stage) for name, stage in (record.get("stages") or {}).items()}
    if (run / "metrics.json").exists():
        metrics = _read(run / "metrics.json")
        facts["metrics"] = {name: metrics.get(name) for name in ("frames", "warnings")}
    given = [str(record.get("source", {}).get("path", "")), str(run.resolve()), *_strings(record.get("config"))]
    names = {name for text in given for name in _names(text)}
    shown = _without({name: value for name, value in facts.items() if value}, names)
    return yaml.safe_dump(shown, sort_keys=False, allow_unicode=True)


def _strings(value: Any) -> list[str]:
    if isinstance(value, dict):
        return [text for part in value.values() for text in _strings(part)]
    return [value] if isinstance(value, str) else []


def _names(text: str) -> list[str]:
    """What a path is made of: its parts, with and without their suffix; nothing of a text that is no path."""
    if not ("/" in text or "\\" in text or Path(text).suffix in SUFFIXES):
        return []
    parts = [part for part in re.split(r"[/\\]", text) if len(part) >= SHORTEST_NAME]
    return [*parts, *(Path(part).stem for part in parts), text]


def _read(path: Path) -> dict[str, Any]:
    """JSON is YAML."""
    try:
        record = yaml.safe_load(path.read_text())
    except (OSError, ValueError, yaml.YAMLError) as error:
        raise HaustraError(f"{path} is missing or damaged") from error
    if not isinstance(record, dict):
        raise HaustraError(f"{path} is damaged")
    return record


def _counts(stage: Any) -> Any:
    """What a stage recorded, without its lists of numbers."""
    if not isinstance(stage, dict):
        return stage
    short = (str, int, float, bool)
    return {
        name: value
        for name, value in stage.items()
        if isinstance(value, short)
        or (isinstance(value, list) and len(value) <= 20 and all(isinstance(v, short) for v in value))
    }


def _without(value: Any, names: set[str]) -> Any:
    """The same with every path and every one of the names hidden."""
    if isinstance(value, dict):
        return {name: _without(part, names) for name, part in value.items()}
    if isinstance(value, list):
        return [_without(part, names) for part in value]
    if not isinstance(value, str):
        return value
    for name in sorted(names, key=len, reverse=True):
        value = value.replace(name, HIDDEN)
    return " ".join(HIDDEN if _names(word) else word for word in value.split(" "))
