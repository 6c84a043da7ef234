"""docs/lab/photometric.md from the record photometric.json, beside kriging.json's rows of the version before it; the
words are in photometric_page.txt.

python -m scripts.pages.surface.photometric_page > docs/lab/photometric.md
"""

import json
from pathlib import Path
from typing import Any

from benchmarks.common.record import ROOT
from scripts.pages.surface import kriging_page
from scripts.pages.surface.hovering_page import rows_of
from scripts.pages.surface.pose_adjustment_page import page

RECORD, WORDS = ROOT / "benchmarks/results/photometric.json", Path(__file__).with_name("photometric_page.txt")


def both_versions(record: dict[str, Any], earlier: dict[str, Any]) -> dict[str, Any]:
    """`record`, and before it the latest rows that an earlier record has of its films, as those of `before`."""
    now, latest = rows_of(record, "now"), rows_of(earlier, "now")
    before = [latest[film] | {"method": latest[film]["method"].replace("now", "before", 1)} for film in now]
    return record | {"runs": before + list(now.values())}


if __name__ == "__main__":
    records = (json.loads(path.read_text()) for path in (RECORD, kriging_page.RECORD))
    print(page(both_versions(*records), WORDS, timed=False), end="")
