"""The README's tables are those of their record, and no page excuses a figure by its age."""

import json
import re
from pathlib import Path

import pytest

from benchmarks import table
from benchmarks.common.record import spread

ROOT = Path(__file__).parents[1]
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]
MOST_LINES = 120
OLD = (
    r"earlier (version|commit|state|figure)s?|\bof before\b|\bolder\b|not measured (anew|again)|version before"
    r"|figures? (is|are) (old|outdated)|no longer (hold|true)|previous (version|figure)s?|out of date|\bstale\b"
)


def test_the_readme_holds_the_tables_of_the_record():
    text = (ROOT / "README.md").read_text()
    between = text.split(table.BEGIN)[1].split(table.END)[0].strip()
    assert between == table.render(json.loads(table.RECORD.read_text()))


def test_every_row_of_the_record_is_one_that_is_measured():
    record = json.loads(table.RECORD.read_text())["rows"]
    assert set(record) <= set(table.ROWS)
    for row in record.values():
        assert {"command", "commit", "processor", "cores", "python", "seeds", "figures"} <= set(row)
        assert all(len(of["values"]) == len(row["seeds"]) for of in row["figures"].values())


def test_a_spread_is_shown_where_there_are_seeds():
    figures = {"posed": [5, 5], "total": [5, 5], "ate_mm": [0.1, 0.3], "f_score": [80, 90], "precision": [1, 1]}
    figures = {name: spread([float(v) for v in values]) for name, values in (figures | {"recall": [2, 2]}).items()}
    record = {"rows": {"demo": {"commit": "abcdefghij", "seeds": [0, 1], "figures": figures}}}
    row = table.render(record).splitlines()[-1]
    assert "| 5 (5-5) of 5 | 0.200 (0.100-0.300) | 85.0 (80.0-90.0) |" in row
    assert row.endswith("| abcdefg, 2 |")


def test_a_changed_checkout_is_refused_and_known_rows_are_kept(tmp_path, monkeypatch):
    asked = []
    row = table.Row("a", "runs", "command", None, lambda seed: asked.append(seed) or {"x": 1.0})
    monkeypatch.setattr(table, "ROWS", {"demo": row, "ctcolon": row})
    monkeypatch.setattr(table, "_line", lambda *_: "")
    here = {"commit": "abc", "processor": "p", "cores": 1, "python": "3"}
    monkeypatch.setattr(table, "environment", lambda: here)
    record = {"rows": {"demo": {**here, "seeds": [0, 1]}}}
    table.measure_rows(["demo", "ctcolon"], [0, 1], record, tmp_path / "table.json")
    assert asked == [0, 1]
    assert json.loads((tmp_path / "table.json").read_text())["rows"]["ctcolon"]["figures"]["x"]["values"] == [1, 1]
    monkeypatch.setattr(table, "environment", lambda: here | {"commit": "abc+"})
    with pytest.raises(SystemExit, match="changes that no commit holds"):
        table.measure_rows(["demo"], [0], record, tmp_path / "table.json")


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_no_page_calls_a_figure_old(page):
    """What is not measured is taken out."""
    text = " ".join(page.read_text().split())
    found = [text[max(0, hit.start() - 60) : hit.end() + 40] for hit in re.finditer(OLD, text, re.IGNORECASE)]
    assert not found


def test_the_readme_is_short():
    assert len((ROOT / "README.md").read_text().splitlines()) <= MOST_LINES
