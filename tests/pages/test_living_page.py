"""The committed page of films whose wall moves is what its script prints from the records."""

import json
from pathlib import Path

from scripts.pages.living_page import NAMES, RECORDS, page

PAGE = Path(__file__).parents[2] / "docs/lab/living.md"


def test_the_page_is_what_its_records_say() -> None:
    records = (json.loads((RECORDS / name).read_text()) for name in NAMES)
    told = "run: python scripts/pages/living_page.py > docs/lab/living.md"
    assert page(*records) == PAGE.read_text(encoding="utf-8"), told
