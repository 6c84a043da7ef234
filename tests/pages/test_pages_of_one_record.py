"""Committed pages are what their scripts print of their records."""

import json
import runpy
from pathlib import Path

import pytest

from scripts.pages import (
    blind_page,
    completion_page,
    known_poses_page,
    lens_page,
    points_page,
    robustness_page,
    sensors_page,
)

LAB = Path(__file__).parents[2] / "docs/lab"


@pytest.mark.parametrize(
    ("script", "name"),
    [
        (blind_page, "blind_stretch"),
        (known_poses_page, "known_poses"),
        (sensors_page, "sensors"),
        (robustness_page, "robustness"),
        (points_page, "points"),
    ],
    ids=["blind", "poses", "sensors", "robustness", "points"],
)
def test_the_page_is_what_its_record_says(script, name) -> None:
    printed = script.page(json.loads(script.RECORD.read_text()))
    told = f"run: python scripts/pages/{script.__name__.split('.')[-1]}.py > docs/lab/{name}.md"
    assert printed == (LAB / f"{name}.md").read_text(encoding="utf-8"), told


def test_the_page_on_unknown_lenses_is_what_its_records_say() -> None:
    told = "run: python scripts/pages/lens_page.py > docs/lab/unknown_lens.md"
    assert lens_page.page() == (LAB / "unknown_lens.md").read_text(encoding="utf-8"), told


def test_the_page_on_completion_is_what_its_records_say() -> None:
    told = "run: python -m scripts.pages.completion_page > docs/lab/completion.md"
    assert completion_page.page() == (LAB / "completion.md").read_text(encoding="utf-8"), told


@pytest.mark.parametrize("name", ["hovering", "pose_adjustment", "kriging", "photometric"])
def test_a_page_on_two_versions_is_what_its_record_says(name, capsys) -> None:
    script = f"scripts.pages.surface.{name}_page"
    runpy.run_module(script, run_name="__main__")
    told = f"run: python -m {script} > docs/lab/{name}.md"
    assert capsys.readouterr().out == (LAB / f"{name}.md").read_text(encoding="utf-8"), told
