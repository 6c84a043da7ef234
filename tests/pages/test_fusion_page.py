"""The note on fusion is what its records say."""

from benchmarks.common.record import ROOT
from scripts.pages.surface.fusion_page import page


def test_the_page_is_what_its_records_say():
    committed = (ROOT / "docs/lab/fusion.md").read_text(encoding="utf-8")
    assert page() == committed, "run: python -m scripts.pages.surface.fusion_page > docs/lab/fusion.md"
