"""The committed page of the redesign is what its script prints from the record."""

import copy
import json

import pytest

from scripts.pages.rooms_page import PAGE, RECORD, enter, page

RECORDED = json.loads(RECORD.read_text())


def test_the_page_is_what_its_record_says() -> None:
    assert page(RECORDED) == PAGE.read_text(encoding="utf-8"), "run: python scripts/pages/rooms_page.py"


def test_runs_enter_the_record_once() -> None:
    """A run of a seed that is recorded must be the one that is recorded."""
    rows = copy.deepcopy(RECORDED["seeds"])
    first = rows[0]
    run = {"sequence": first["film"], "method": first["method"], "seed": 0, "ate_mm": first["after"]["0"]}
    enter(rows, "after", [run, {**run, "seed": 99, "ate_mm": 1.5}, {**run, "sequence": "another", "ate_mm": 2.0}])
    assert rows[0]["after"] == {**first["after"], "99": 1.5}
    assert rows[1:] == RECORDED["seeds"][1:]
    with pytest.raises(SystemExit, match="not the run that is recorded"):
        enter(rows, "after", [{**run, "ate_mm": 3.0}])
