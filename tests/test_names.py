"""Our names: what `haustra` offers, and that no other distribution has the import names of ours."""

import os
import subprocess
import sys
from importlib.metadata import packages_distributions
from pathlib import Path

import pytest

import haustra
from pipeline.cli.shadowing import IMPORT_NAMES, shadowing_distributions

ROOT = Path(__file__).parents[1]
HELP = "import sys; sys.argv = ['haustra', 'export', '--help']; from pipeline.cli.main import main; main()"


@pytest.mark.parametrize("name", haustra.__all__)
def test_public_names_are_there_and_documented(name):
    assert getattr(haustra, name).__name__ == name
    assert f"`{name}`" in haustra.__doc__ or f"`{name}(" in haustra.__doc__


def test_public_names_are_listed_once():
    assert sorted(set(haustra.__all__)) == haustra.__all__
    assert set(haustra._MODULE_OF) == set(haustra.__all__)
    with pytest.raises(AttributeError, match="no attribute 'other'"):
        _ = haustra.other


@pytest.mark.parametrize("name", IMPORT_NAMES)
def test_import_names_are_ours_alone(name):
    owners = packages_distributions().get(name)
    if owners is None:
        pytest.skip(f"the metadata of this environment lists no distribution for '{name}': haustra is not installed")
    assert set(owners) == {"haustra"}


def test_import_names_are_all_that_is_packaged():
    packaged = {path.parent.name for path in ROOT.glob("*/__init__.py")} - {"benchmarks", "tests"}
    assert packaged == set(IMPORT_NAMES)


def test_nothing_shadows_us_here():
    assert shadowing_distributions() == {}


def started(*first: Path, last: tuple[Path, ...] = (), cwd: Path = ROOT) -> subprocess.CompletedProcess[str]:
    """The command in a process of its own, whose import path begins with `first` and has ours and `last` after it."""
    path = os.pathsep.join(map(str, (*first, ROOT, *last)))
    environment = os.environ | {"PYTHONPATH": path, "PYTHONSAFEPATH": "1"}
    return subprocess.run([sys.executable, "-c", HELP], env=environment, cwd=cwd, capture_output=True, text=True)


def distribution(folder: Path, name: str, **files: str) -> Path:
    """A distribution as installed into `folder`: its metadata, with `files` beside METADATA."""
    about = folder / f"{name.replace('-', '_')}-1.0.dist-info"
    about.mkdir(parents=True)
    (about / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {name}\nVersion: 1.0\n")
    for file, text in files.items():
        (about / file.replace("top_level", "top_level.txt")).write_text(text)
    return folder


def test_a_command_starts_where_nothing_shadows_it(tmp_path):
    distribution(tmp_path, "harmless", top_level="harmless\n")
    distribution(tmp_path, "likewise", RECORD="likewise/pipeline/__init__.py,,\npipelines/__init__.py,,\n")
    done = started(tmp_path)
    assert done.returncode == 0, done.stderr
    assert ".ply" in done.stdout


@pytest.mark.parametrize(
    "files", [{"top_level": "completion\nother\n"}, {"RECORD": "completion/__init__.py,,\nother/__init__.py,,\n"}]
)
def test_a_distribution_with_one_of_our_names_is_told(tmp_path, files):
    """As pip leaves it that writes two distributions into one folder: the files are mixed, both are listed."""
    done = started(last=(distribution(tmp_path, "Text-Completion", **files),))
    assert done.returncode == 1
    told = "'completion' is also the import name of the distribution 'Text-Completion'"
    assert done.stderr.startswith(f"error: {told}: ")
    assert done.stderr.count("\n") == 1
    assert done.stdout == ""


def test_a_package_before_ours_on_the_path_is_told(tmp_path):
    (tmp_path / "reconstruction").mkdir()
    (tmp_path / "reconstruction" / "__init__.py").write_text("raise SystemExit('must not be run')\n")
    done = started(tmp_path)
    assert done.returncode == 1
    assert done.stderr.startswith(f"error: 'reconstruction' is also the import name of a package in {tmp_path}: ")
    distribution(tmp_path, "surface-tools", top_level="reconstruction\n")
    assert "the distribution 'surface-tools'" in started(tmp_path).stderr


def test_an_older_copy_of_ours_is_no_other_distribution(tmp_path):
    done = started(last=(distribution(tmp_path, "Haustra", top_level="\n".join(IMPORT_NAMES)),))
    assert done.returncode == 0, done.stderr


def test_figures_leave_the_callers_choice_of_where_to_draw_alone():
    code = (
        "import matplotlib; matplotlib.use('svg'); import pipeline.report.figures, completion.evaluation.plots as p; "
        "p._subplots(2, 2); print(matplotlib.get_backend().lower())"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "svg"
