"""The committed page of depth and surface is what its script prints from the records."""

from pathlib import Path

from scripts.pages.depth_page import page

ROOT = Path(__file__).parents[2]


def test_the_page_is_what_its_records_say() -> None:
    committed = (ROOT / "docs/lab/depth_and_surface.md").read_text(encoding="utf-8")
    assert page() == committed, "run: python -m scripts.pages.depth_page > docs/lab/depth_and_surface.md"
