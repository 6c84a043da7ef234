"""One command for all records: what is listed exists, a stopped one goes on, a failed one replaces nothing."""

import json
from fnmatch import fnmatch

import pytest
import yaml

from benchmarks import records
from benchmarks.common.record import ROOT
from benchmarks.common.runner import run

LISTED = yaml.safe_load(records.LISTED.read_text())


def test_every_record_that_is_listed_has_its_films_page_and_a_known_command():
    for name, asked in LISTED["records"].items():
        assert set(asked.get("films", [])) <= set(LISTED["films"])
        assert any("{record}" in command for command in asked["commands"]), name
        for command in asked["commands"]:
            if command.startswith("git "):
                continue
            program = command.split()[1:3]
            module = program[1] if program[0] == "-m" else program[0].removesuffix(".py").replace("/", ".")
            path = ROOT / module.replace(".", "/")
            assert path.with_suffix(".py").exists() or (path / "__main__.py").exists(), command
        for script, page in asked["pages"].items():
            assert (ROOT / f"scripts/pages/{script.replace('.', '/')}_page.py").exists()
            assert (ROOT / f"docs/lab/{page}.md").exists()


@pytest.fixture
def bench(tmp_path, monkeypatch):
    """A project of one record; commands are counted in a file."""
    monkeypatch.setattr(records, "RESULTS", tmp_path / "results")
    monkeypatch.setattr(records, "render", lambda script, page: (tmp_path / "pages").open("a").write(script))
    monkeypatch.setattr(records, "environment", lambda: {"commit": "new"})
    records.RESULTS.mkdir()
    (tmp_path / "measured.json").write_text(json.dumps({"runs": [{"commit": "new"}]}))
    listed = {"films": {}, "records": {"one": {"commands": [], "pages": {"one": "one"}}}}

    def measure(*commands):
        listed["records"]["one"]["commands"] = ["cp {data}/measured.json {record}", "echo x >> {work}/count", *commands]
        records.measure_all(["one"], listed, tmp_path, tmp_path)

    return tmp_path, measure


def test_a_record_is_measured_once_a_commit_and_its_page_rendered(bench):
    folder, measure = bench
    (records.RESULTS / "one.json").write_text(json.dumps({"runs": [{"commit": "old"}]}))
    measure()
    measure()
    assert records.commits_of(records.RESULTS / "one.json") == {"new"}
    assert (folder / "count").read_text() == "x\n"
    assert (folder / "pages").read_text() == "one"


def test_a_command_that_fails_is_named_and_the_record_stays(bench):
    folder, measure = bench
    (records.RESULTS / "one.json").write_text(json.dumps({"runs": [{"commit": "old"}]}))
    with pytest.raises(records.HaustraError, match="exit code 3 of: exit 3"):
        measure("exit 3")
    assert records.commits_of(records.RESULTS / "one.json") == {"old"}
    assert not (folder / "pages").exists()


def test_a_changed_checkout_is_refused(bench, monkeypatch):
    monkeypatch.setattr(records, "environment", lambda: {"commit": "new+"})
    with pytest.raises(records.HaustraError, match="no commit holds"):
        bench[1]()


def test_an_unknown_name_and_missing_folders_are_one_sentence():
    for argv, said in ((["nothing"], "no such record: nothing"), (["points"], "--work WORK --data DATA")):
        with pytest.raises(SystemExit, match=said):
            run(records, "benchmarks.records", argv)


CHOSEN = ("choosing", "burnt_choosing", "pouches_choosing")
REPORTED = ("reported", "varied", "burnt", "pouches", "suite")


def test_no_gut_that_a_surface_was_chosen_on_is_reported():
    assert not _guts(f"{{{name}}}/*" for name in CHOSEN) & _guts(f"{{{name}}}/*" for name in REPORTED)


@pytest.mark.parametrize("record", ["map_doubt", "map_doubt_colmap"])
def test_no_gut_and_no_path_that_the_doubt_of_maps_was_chosen_on_is_reported(record):
    (command,) = LISTED["records"][record]["commands"]
    choosing, reported = command.partition("--choosing ")[2].partition(" --maps")[0].split(" --reported ")
    kinds = [of.split() for of in (choosing, reported)]
    assert not _guts(kinds[0]) & _guts(kinds[1])
    assert not _recordings(kinds[0]) & _recordings(kinds[1])
    assert "{data}/ctcolon" not in kinds[0]


def _films(arguments):
    """Settings of the films that arguments such as `{suite}/*` or `{living}/{{a,b}}_*` of a listed command name."""
    found = []
    for argument in arguments:
        suite, _, pattern = argument.partition("/")
        if suite == "{data}":
            continue
        options = LISTED["films"][suite.strip("{}")].split()
        file = options[options.index("--config") + 1] if "--config" in options else None
        of_package = "living" if "--living-suite" in options else "suite"
        films = yaml.safe_load((ROOT / (file or f"haustra/phantom/dataset/{of_package}.yaml")).read_text())
        mine = [film for name, film in films.items() if any(fnmatch(name, p) for p in _alternatives(pattern))]
        assert mine, argument
        found += mine
    return found


def _alternatives(pattern):
    """Patterns that a shell makes of one with braces, which `str.format` wants doubled."""
    head, brace, rest = pattern.replace("{{", "{").replace("}}", "}").partition("{")
    if not brace:
        return [head]
    within, _, tail = rest.partition("}")
    return [head + one + end for one in within.split(",") for end in _alternatives(tail)]


def _guts(arguments):
    return {(film.get("scene"), film.get("seed")) for film in _films(arguments)}


def _recordings(arguments):
    return {film["motion"]["recording"] for film in _films(arguments) if "recording" in film.get("motion", {})}
