"""The committed page of settings is what its script prints from the configuration's fields."""

import os
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).parents[2]


def test_settings_page_is_up_to_date() -> None:
    printed = subprocess.run(
        [sys.executable, "scripts/settings_page.py"],
        cwd=ROOT,
        env=os.environ | {"PYTHONPATH": str(ROOT)},
        capture_output=True,
        text=True,
        check=True,
    ).stdout
    committed = (ROOT / "docs" / "reference" / "settings.md").read_text(encoding="utf-8")
    assert printed == committed, "run: python scripts/settings_page.py > docs/reference/settings.md"
