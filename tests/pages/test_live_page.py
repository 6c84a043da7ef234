"""The lab note on live sessions is what its records say."""

from pathlib import Path

from scripts.pages.live_page import page


def test_the_note_is_rendered_from_its_records():
    assert (Path(__file__).parents[2] / "docs/lab/live.md").read_text() == page()
