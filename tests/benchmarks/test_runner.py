"""What all benchmarks share: every entry has its help, records name commit and machine, a stopped table goes on."""

import ast
import json
import runpy
import sys
from pathlib import Path
from types import ModuleType

import pytest

from benchmarks.common.record import RunTable, shown, spread
from benchmarks.common.runner import run
from haustra.core.errors import HaustraError

ROOT = Path(__file__).parents[2] / "benchmarks"
PACKAGES = [folder.name for folder in sorted(ROOT.iterdir()) if (folder / "__main__.py").exists()]


def measurements() -> list[Path]:
    """Files of what `choose` offers in any package, and of the entries that are one file."""
    files = [path for path in ROOT.glob("*.py") if path.name != "__init__.py"]
    for package in PACKAGES:
        for node in ast.walk(ast.parse((ROOT / package / "__main__.py").read_text())):
            if isinstance(node, ast.Call) and getattr(node.func, "id", "") == "choose":
                files += [ROOT / package / f"{name}.py" for name in ast.literal_eval(node.args[2])]
    return [*files, ROOT / "fusion" / "comparison.py", ROOT / "robustness" / "fuzz.py"]


@pytest.mark.parametrize("file", measurements(), ids=lambda file: f"{file.parent.name}-{file.stem}")
def test_every_measurement_can_be_run_and_says_how(file):
    """Read, not imported: some need libraries that do not like each other in one process."""
    tree = ast.parse(file.read_text())
    defined = {node.name for node in tree.body if isinstance(node, ast.FunctionDef)}
    assert {"add_arguments", "measure"} <= defined
    assert "python -m benchmarks." in str(ast.get_docstring(tree))


@pytest.mark.parametrize("package", PACKAGES)
def test_every_package_has_its_help(package, monkeypatch, capsys):
    monkeypatch.setattr(sys, "argv", [package, "--help"])
    with pytest.raises(SystemExit) as ended:
        runpy.run_module(f"benchmarks.{package}", run_name="__main__")
    assert ended.value.code == 0
    assert f"python -m benchmarks.{package}" in capsys.readouterr().out


def test_each_measurement_of_a_package_is_listed_with_its_first_line(monkeypatch, capsys):
    monkeypatch.setattr(sys, "argv", ["loops", "--help"])
    with pytest.raises(SystemExit):
        runpy.run_module("benchmarks.loops", run_name="__main__")
    printed = capsys.readouterr().out
    assert "  joins                Submaps of one film" in printed
    assert "  pose-graph           What closing loops is worth" in printed


def test_a_record_names_commit_and_machine(tmp_path):
    module = ModuleType("measurement", "What it measures.")
    module.add_arguments = lambda parser: parser.add_argument("--runs", type=int, default=2)
    module.measure = lambda arguments: {"runs": [1.5] * arguments.runs}
    run(module, "benchmarks.measurement", ["--runs", "3", "--json", str(tmp_path / "record.json")])
    record = json.loads((tmp_path / "record.json").read_text())
    assert record["runs"] == [1.5, 1.5, 1.5]
    assert set(record["environment"]) == {"commit", "processor", "cores", "python"}


def test_a_known_failure_is_one_sentence():
    module = ModuleType("measurement", "What it measures.")

    def fail(_):
        raise HaustraError("there is no film here")

    module.add_arguments, module.measure = lambda parser: None, fail
    with pytest.raises(SystemExit, match=r"^error: there is no film here$"):
        run(module, "benchmarks.measurement", [])


def test_a_stopped_table_goes_on_where_it_was(tmp_path):
    path = tmp_path / "runs.json"
    table = RunTable(path)
    table.add("loop", 0, {"sfm": {"ate_mm": 0.5}, "odometry": {"ate_mm": 0.25}})
    again = RunTable(path)
    assert again.has("loop", 0, "sfm")
    assert not again.has("loop", 1, "sfm")
    again.add("loop", 1, {"sfm": {"ate_mm": 1.5}})
    assert [row["ate_mm"] for row in RunTable(path).of("loop", "sfm")] == [0.5, 1.5]
    assert all(row["commit"] for row in RunTable(path).runs)


def test_the_measured_table_of_seeds_is_still_read():
    table = RunTable(ROOT / "mapper_seeds.json")
    assert table.has("easy_withdrawal", 0, "odometry")
    assert len(table.of("easy_withdrawal", "sfm")) == 10


def test_a_spread_is_shown_as_median_and_extremes():
    assert shown(spread([3.0, 1.0, 2.0]), ".1f") == "2.0 [1.0, 3.0]"
