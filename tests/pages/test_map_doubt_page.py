"""The committed page of maps' doubt is what its script prints, and the pipeline has the record's coefficients."""

import json
from pathlib import Path

import pytest

from pipeline.mapping.map_doubt import coefficients
from scripts.pages.map_doubt_page import OF_COLMAP, READ, RECORD, page

PAGE = Path(__file__).parents[2] / "docs/lab/map_doubt.md"


def test_the_page_is_what_its_record_says() -> None:
    told = "run: python scripts/pages/map_doubt_page.py > docs/lab/map_doubt.md"
    records = (json.loads(record.read_text()) for record in (RECORD, OF_COLMAP))
    assert page(*records, READ) == PAGE.read_text(encoding="utf-8"), told


@pytest.mark.parametrize(("family", "path"), [("odometry", RECORD), ("colmap", OF_COLMAP)])
def test_the_pipeline_has_the_coefficients_of_the_record(family: str, path: Path) -> None:
    record, shipped = json.loads(path.read_text()), coefficients()[family]
    assert record["coefficients"] == {name: shipped[name] for name in record["coefficients"]}
    assert shipped["maps"] == sum(row["role"] == "choosing" for row in record["maps"])
