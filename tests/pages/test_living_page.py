"""The committed page of moving walls is what its script prints from the record."""

import json
from pathlib import Path

from scripts.pages.living_page import RECORD, page

ROOT = Path(__file__).parents[2]


def test_the_page_is_what_its_record_says() -> None:
    committed = (ROOT / "docs/lab/living.md").read_text(encoding="utf-8")
    printed = page(json.loads(RECORD.read_text()))
    assert printed == committed, "run: python scripts/pages/living_page.py > docs/lab/living.md"
