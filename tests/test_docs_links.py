"""Every relative link, anchor and picture in a markdown file leads somewhere, and every page that code names exists."""

import re
import subprocess
from pathlib import Path
from urllib.parse import unquote

import pytest

ROOT = Path(__file__).parents[1]
LINK = re.compile(r"!?\[[^\]]*\]\(\s*<?([^)\s>]+)>?[^)]*\)")
CODE = re.compile(r"^```.*?^```|`[^`\n]*`", re.MULTILINE | re.DOTALL)
NAMED_PAGE = re.compile(r"\bdocs/[\w/]+\.(?:md|png|jpg)\b")


def tracked(*patterns: str) -> list[Path]:
    """Files of the repository; all that match, where it is no git checkout."""
    listed = subprocess.run(["git", "ls-files", "-co", "--exclude-standard", *patterns], cwd=ROOT, capture_output=True)
    if listed.returncode == 0 and listed.stdout:
        return [ROOT / name for name in listed.stdout.decode().splitlines() if (ROOT / name).exists()]
    found = [path for pattern in patterns for path in ROOT.rglob(pattern)]
    return [path for path in found if not {".venv", "site-packages"} & set(path.parts)]


def links_of(page: Path) -> list[str]:
    return [unquote(link) for link in LINK.findall(CODE.sub("", page.read_text(encoding="utf-8")))]


def anchors_of(page: Path) -> set[str]:
    """Anchors as GitHub makes them from headings: lower case, punctuation dropped, spaces to hyphens."""
    text = re.sub(r"^```.*?^```", "", page.read_text(encoding="utf-8"), flags=re.MULTILINE | re.DOTALL)
    headings = re.findall(r"^#+\s+(.*?)\s*$", text, re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-") for heading in headings}


@pytest.mark.parametrize("page", tracked("*.md"), ids=lambda page: str(page.relative_to(ROOT)))
def test_relative_links_lead_somewhere(page: Path) -> None:
    for link in links_of(page):
        if re.match(r"[a-z]+:", link):
            continue
        name, _, anchor = link.partition("#")
        target = (page.parent / name).resolve() if name else page
        assert target.exists(), f"{page.relative_to(ROOT)}: {link} does not exist"
        if anchor and target.suffix == ".md":
            assert anchor in anchors_of(target), f"{page.relative_to(ROOT)}: no heading for {link}"


def test_pages_named_in_text_and_code_exist() -> None:
    for file in tracked("*.md", "*.py", "*.yaml"):
        for name in NAMED_PAGE.findall(file.read_text(encoding="utf-8")):
            assert (ROOT / name).exists(), f"{file.relative_to(ROOT)} names {name}, which does not exist"


def test_links_and_anchors_are_found(tmp_path: Path) -> None:
    page = tmp_path / "page.md"
    page.write_text("# One heading\n\n[a](gone.md) ![b](x/y.png) [c](#one-heading) `[d](code.md)`\n")
    assert links_of(page) == ["gone.md", "x/y.png", "#one-heading"]
    assert anchors_of(page) == {"one-heading"}
