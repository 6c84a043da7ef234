"""Rows of the benchmark of coverage: both methods, what a film is, and films that cannot be judged."""

import json

from benchmarks import coverage
from benchmarks.common.runner import run
from haustra.core.errors import HaustraError
from reconstruction.evaluation.coverage_metrics import CoverageErrors, JudgedRegion

ERRORS = CoverageErrors(
    0.8, 0.75, 60.0, 4, 3, 5, 2, 5.0, 200.0, 190.0, (6.0,), 0.2, 0.05, (JudgedRegion(0.2, 0.5, True),)
)


def test_each_film_has_a_row_for_each_method(tmp_path, monkeypatch):
    monkeypatch.setattr(coverage, "of_true_depth", lambda film: coverage.figures_of(ERRORS))
    monkeypatch.setattr(coverage, "of_a_run", lambda film, keep: {"failed": "no tube"})
    record, film = tmp_path / "coverage.json", tmp_path / "suite" / "one"
    film.mkdir(parents=True)
    for _ in range(2):  # what is there is not measured again
        run(coverage, "benchmarks.coverage", [str(film), "--role", "looked at", "--json", str(record)])
    true, found = json.loads(record.read_text())["runs"]
    assert (true["method"], true["role"], true["suite"]) == ("true depth", "looked at", "suite")
    assert round(true["error_points"], 6) == 5
    assert (true["found"], true["false"], true["area_of_true"]) == (3, 2, 0.95)
    assert true["regions"] == [{"reach_radii": 0.2, "probability": 0.5, "is_true": True}]
    assert (found["method"], found["failed"]) == ("reconstruct", "no tube")


def test_a_run_that_fails_has_its_sentence(tmp_path, monkeypatch):
    def fail(*_, **__):
        raise HaustraError("no frame is sharp")

    monkeypatch.setattr(coverage, "reconstruct", fail)
    assert coverage.of_a_run(tmp_path, None) == {"failed": "no frame is sharp"}
