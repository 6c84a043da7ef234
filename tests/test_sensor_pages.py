"""The committed pages of blind stretches and of true poses are what their scripts print from the records."""

import json
from pathlib import Path

import pytest

from scripts import blind_page, known_poses_page

LAB = Path(__file__).parents[1] / "docs/lab"


@pytest.mark.parametrize(
    ("script", "name"), [(blind_page, "blind_stretch"), (known_poses_page, "known_poses")], ids=["blind", "poses"]
)
def test_the_page_is_what_its_record_says(script, name) -> None:
    printed = script.page(json.loads(script.RECORD.read_text()))
    told = f"run: python scripts/{script.__name__.split('.')[-1]}.py > docs/lab/{name}.md"
    assert printed == (LAB / f"{name}.md").read_text(encoding="utf-8"), told
