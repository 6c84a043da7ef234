"""Real and path-traced data beside the checkout, which is never committed."""

from pathlib import Path

import pytest

SHARED_DATA = Path(__file__).parents[3] / "shared" / "data"


def shared(name: str) -> Path:
    """A folder of real data beside the checkout; skips where it is absent."""
    folder = SHARED_DATA / name
    if not folder.is_dir():
        pytest.skip(f"real data '{name}' is not beside this checkout (../shared/data)")
    return folder
