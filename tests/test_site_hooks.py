"""Links of the pages, as the site has them: pages from outside docs/ are pages, other files are text."""

import pytest

from scripts import site_hooks
from scripts.site_hooks import LINK, ROOT, _turned


def turned(text: str, source: str, place: str) -> str:
    return LINK.sub(lambda hit: _turned(hit, ROOT / source, place), text)


@pytest.mark.parametrize(
    ("text", "source", "place", "site"),
    [
        ("[a](../lab/README.md#words)", "docs/guide/fusion.md", "guide/fusion.md", "[a](../lab/README.md#words)"),
        (
            "[a](../../README.md#figures)",
            "docs/guide/fusion.md",
            "guide/fusion.md",
            "[a](../project/readme.md#figures)",
        ),
        ("[a](docs/lab/living.md)", "README.md", "project/readme.md", "[a](../lab/living.md)"),
        ("![p](docs/pictures/demo.png)", "README.md", "project/readme.md", "![p](../pictures/demo.png)"),
        ("[docs/](docs/README.md)", "README.md", "project/readme.md", "[docs/](../README.md)"),
        ("[run](../pipeline/run.py)", "docs/extending.md", "extending.md", "run (`pipeline/run.py`)"),
        ("[pipeline/run.py](../pipeline/run.py)", "docs/extending.md", "extending.md", "pipeline/run.py"),
        ("[w](https://example.org/x)", "README.md", "project/readme.md", "[w](https://example.org/x)"),
        ("[here](#figures)", "README.md", "project/readme.md", "[here](#figures)"),
    ],
)
def test_links_lead_to_the_same_place(text, source, place, site):
    assert turned(text, source, place) == site


def test_a_link_to_nothing_ends_the_build():
    with pytest.raises(FileNotFoundError, match="which is not there"):
        turned("[a](nowhere.md)", "docs/extending.md", "extending.md")


def test_pages_from_outside_are_there():
    assert all((ROOT / source).is_file() for source in site_hooks.PAGES)
