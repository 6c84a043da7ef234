"""The committed page on tracks in loop closing is what its script prints from the records."""

import json
from pathlib import Path

from scripts.pages import loop_tracks_page as script

PAGE = Path(__file__).parents[2] / "docs/lab/loop_tracks.md"


def test_the_page_is_what_its_records_say() -> None:
    records = (json.loads(path.read_text()) for path in (script.BEFORE, script.AFTER))
    told = "run: python scripts/pages/loop_tracks_page.py > docs/lab/loop_tracks.md"
    assert script.page(*records) == PAGE.read_text(encoding="utf-8"), told
