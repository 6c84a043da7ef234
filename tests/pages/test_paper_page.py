"""The committed page of the paper's claims is what its script prints from the records."""

from pathlib import Path

from benchmarks.paper.records import Records
from scripts.pages.paper.page import page

ROOT = Path(__file__).parents[2]


def test_the_page_is_what_its_records_say() -> None:
    committed = (ROOT / "docs/lab/paper.md").read_text(encoding="utf-8")
    assert page(Records.read()) == committed, "run: python -m scripts.pages.paper.page > docs/lab/paper.md"
