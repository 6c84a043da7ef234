"""docs/lab/kriging.md from the record kriging.json; the words are in kriging_page.txt.

python -m scripts.pages.surface.kriging_page > docs/lab/kriging.md
"""

import json
from pathlib import Path

from benchmarks.common.record import ROOT
from scripts.pages.surface.pose_adjustment_page import page

RECORD, WORDS = ROOT / "benchmarks/results/kriging.json", Path(__file__).with_name("kriging_page.txt")


if __name__ == "__main__":
    # The versions were run on different days, on machines of one kind but not of one speed.
    print(page(json.loads(RECORD.read_text()), WORDS, timed=False), end="")
