"""The code blocks of docs/extending.md, as the modules and the rows that a reader would write."""

from __future__ import annotations

import re
import sys
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest

PAGE = Path(__file__).parents[2] / "docs" / "extending.md"
BLOCK = re.compile(r"^```python\n# (\S+\.py)(: the row)?\n(.*?)^```", re.MULTILINE | re.DOTALL)


def blocks(row: bool) -> dict[str, str]:
    """File that a block is for: its text; of the blocks that are rows of a table, or of the others."""
    return {path: text for path, is_row, text in BLOCK.findall(PAGE.read_text()) if bool(is_row) == row}


def written(path: str, monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    """The module of a block, importable for this test as if its file were there."""
    module = ModuleType(path.removesuffix(".py").replace("/", "."))
    monkeypatch.setitem(sys.modules, module.__name__, module)
    exec(compile(blocks(row=False)[path], path, "exec"), module.__dict__)
    return module


def add_row(table: dict[Any, Any], path: str, monkeypatch: pytest.MonkeyPatch, *names: dict[str, Any]) -> str:
    """Put the row that the page shows for the table's file into the table for this test; returns its key.

    names: what the row may use, beside the imports that its block begins with.
    """
    *imports, row = blocks(row=True)[path].strip().split("\n")
    known: dict[str, Any] = {}
    for more in names:
        known |= more
    exec("\n".join([*imports, "row = {" + row + "}"]), known)
    ((key, value),) = known["row"].items()
    monkeypatch.setitem(table, key, value)
    return str(key)
