"""The versions of constraints.txt install on every Python that pyproject.toml names, Debian's 3.11.2 among them."""

import importlib.metadata
import tomllib
from pathlib import Path

from packaging.specifiers import SpecifierSet

ROOT = Path(__file__).parents[1]


def pinned():
    lines = (line.split("#")[0].strip() for line in (ROOT / "constraints.txt").read_text().splitlines())
    return [line.split("==") for line in lines if line]


def test_no_pinned_version_asks_for_a_newer_python():
    oldest = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["requires-python"].removeprefix(">=")
    asked, looked_at = {}, 0
    for name, version in pinned():
        try:
            metadata = importlib.metadata.metadata(name)
        except importlib.metadata.PackageNotFoundError:
            continue  # of another set of extras
        looked_at += metadata["Version"].split("+")[0] == version
        if not SpecifierSet(metadata["Requires-Python"] or "").contains(f"{oldest}.0"):
            asked[name] = metadata["Requires-Python"]
    assert not asked
    assert looked_at > 100
