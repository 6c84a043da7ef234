"""Every record in benchmarks/results that `benchmarks/records.yaml` lists, measured anew with one commit; its pages.

    python -m benchmarks.records --work WORK --data DATA              # all of them, some hours
    python -m benchmarks.records known_poses sensors --work WORK --data DATA
    python -m benchmarks.records --list

DATA holds the data sets (`ctcolon`, `realclips`, `c3vd_paths`). Films are rendered into WORK/films once. A record that
is of this commit already is left; one that was stopped goes on in WORK/COMMIT. When all commands of a record have ended
well it replaces the committed one, and its pages are rendered. A checkout that is changed elsewhere than in records and
the pages of docs/lab is refused: its figures would be of no commit.
"""

import argparse
import json
import shutil
import subprocess
import sys
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import yaml

from benchmarks.common.record import ROOT, environment
from benchmarks.common.runner import run
from haustra.core.errors import HaustraError

LISTED = Path(__file__).with_suffix(".yaml")
RESULTS, PAGES = ROOT / "benchmarks/results", ROOT / "docs/lab"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("names", nargs="*", metavar="NAME", help=", ".join(_listed()["records"]))
    parser.add_argument("--work", type=Path, help="folder for films, runs and unfinished records")
    parser.add_argument("--data", type=Path, help="folder of the data sets")
    parser.add_argument("--list", action="store_true", help="say of which commit each record is, and end")


def measure(arguments: argparse.Namespace) -> None:
    """All records that are named; one that fails is named and ends it."""
    listed = _listed()
    names = arguments.names or list(listed["records"])
    unknown = sorted(set(names) - set(listed["records"]))
    if unknown:
        raise HaustraError(f"no such record: {', '.join(unknown)}; known: {', '.join(listed['records'])}")
    if arguments.list:
        for name in names:
            print(f"{name:16} {', '.join(sorted(commits_of(RESULTS / f'{name}.json'))) or 'not measured'}")
        return
    if arguments.work is None or arguments.data is None:
        raise HaustraError("say where to work and where the data sets are: --work WORK --data DATA")
    measure_all(names, listed, arguments.work.resolve(), arguments.data.resolve())


def _listed() -> dict[str, Any]:
    return dict(yaml.safe_load(LISTED.read_text()))


def measure_all(names: list[str], listed: Mapping[str, Any], work: Path, data: Path) -> None:
    """One record after the other."""
    commit = environment()["commit"]
    if commit.endswith("+"):
        raise HaustraError("the checkout has changes that no commit holds; commit them first")
    for name in names:
        if commits_of(RESULTS / f"{name}.json") == {commit}:
            print(f"{name}: is of this commit")
            continue
        started, asked = time.monotonic(), listed["records"][name]
        suites = {suite: _films(suite, listed["films"][suite], work, data) for suite in asked.get("films", [])}
        begun = work / commit / f"{name}.json"
        begun.parent.mkdir(parents=True, exist_ok=True)
        for command in asked["commands"]:
            _run(command.format(**suites, work=work, data=data, record=begun))
        shutil.copyfile(begun, RESULTS / f"{name}.json")
        for script, page in asked["pages"].items():
            render(script, PAGES / f"{page}.md")
        print(f"{name}: {(time.monotonic() - started) / 60:.0f} min", flush=True)


def commits_of(record: Path) -> set[str]:
    """Of a record's rows, or of the whole of it; empty where there is none."""
    if not record.exists():
        return set()
    read = json.loads(record.read_text())
    rows = [row["commit"] for row in read.get("runs", []) if "commit" in row]
    return set(rows) if rows else {read.get("environment", {}).get("commit", "unknown")}


def render(script: str, page: Path) -> None:
    """A page from its records; it is written when the script has ended well."""
    done = subprocess.run(
        [sys.executable, "-m", f"scripts.pages.{script}_page"], cwd=ROOT, capture_output=True, text=True, check=False
    )
    if done.returncode != 0:
        raise HaustraError(f"the page {page.name} cannot be rendered: {done.stderr.strip().splitlines()[-1]}")
    page.write_text(done.stdout, encoding="utf-8")


def _films(suite: str, options: str, work: Path, data: Path) -> Path:
    """The folder of a suite, rendered where that has not been finished."""
    folder = work / "films" / suite
    finished = folder.with_suffix(".finished")
    if not finished.exists():
        _run(f"haustra phantom {folder} {options.format(data=data)}")
        finished.touch()
    return folder


def _run(command: str) -> None:
    """One command as a shell reads it, from the project's root."""
    print(f"$ {command}", flush=True)
    code = subprocess.run(["bash", "-c", command], cwd=ROOT, check=False).returncode
    if code != 0:
        raise HaustraError(f"exit code {code} of: {command}")


if __name__ == "__main__":
    run(sys.modules[__name__], "benchmarks.records")
