"""One command for all records: what is listed exists, a stopped one goes on, a failed one replaces nothing."""

import json

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
            if command.startswith("git show "):
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


SUITE, LIVING = "haustra/phantom/dataset/suite", "haustra/phantom/dataset/living"
VARIED = "benchmarks/coverage_varied_films"
CHOSEN = [f"benchmarks/{name}" for name in ("coverage_films", "exposure_choosing", "diverticula_choosing")]
REPORTED = [f"benchmarks/{name}" for name in ("coverage_reported_films", "exposure_films", "diverticula")]
OF_MAP_DOUBT = [VARIED, "benchmarks/scope_films", "benchmarks/living_choosing", "benchmarks/uneven_films:uneven_a"]


@pytest.mark.parametrize(
    ("chosen", "reported"),
    [
        (CHOSEN, [VARIED, SUITE, *REPORTED]),
        ([*CHOSEN[:2], *OF_MAP_DOUBT], [SUITE, LIVING, REPORTED[0], "benchmarks/uneven_films:uneven_b"]),
    ],
    ids=["surfaces", "doubt of maps"],
)
def test_no_gut_that_something_was_chosen_on_is_reported(chosen, reported):
    assert not _guts(chosen) & _guts(reported)


def _guts(names):
    """Scene and seed of all films of these files, or of the one named after a colon."""
    found = set()
    for name in names:
        file, _, only = name.partition(":")
        films = yaml.safe_load((ROOT / f"{file}.yaml").read_text())
        mine = [film for key, film in films.items() if not only or key == only]
        assert mine
        found |= {(film.get("scene"), film.get("seed")) for film in mine}
    return found
