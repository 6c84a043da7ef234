"""The committed page of depth and surface is what its script prints from the record."""

import json
from pathlib import Path

from scripts.pages.depth_page import RECORD, page

ROOT = Path(__file__).parents[2]


def test_the_page_is_what_its_record_says() -> None:
    committed = (ROOT / "docs/lab/depth_and_surface.md").read_text(encoding="utf-8")
    printed = page(json.loads(RECORD.read_text()))
    assert printed == committed, "run: python scripts/pages/depth_page.py > docs/lab/depth_and_surface.md"
