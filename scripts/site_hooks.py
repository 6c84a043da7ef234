"""Hooks of the site's builder: pages outside docs/ that the pages link become pages too, other files become plain text.

A link to what is not in the repository ends the build.
"""

import re
from pathlib import Path
from typing import Any

ROOT = Path(__file__).parents[1]
# Files outside docs/ that are pages of the site, by the place at which they are.
PAGES = {
    "ARCHITECTURE.md": "project/architecture.md",
    "CONTRIBUTING.md": "project/contributing.md",
    "SECURITY.md": "project/security.md",
    "CHANGELOG.md": "project/changelog.md",
    "benchmarks/README.md": "project/benchmarks.md",
    "completion/weights/MODEL_CARD.md": "project/model_card.md",
    "README.md": "project/readme.md",
}
LINK = re.compile(r"(!?)\[((?:[^\[\]]|\[[^\[\]]*\])*)\]\(([^)\s#]*)(#[^)\s]*)?\)")


def on_files(files: Any, config: Any) -> Any:
    """Add the pages from outside docs/."""
    from mkdocs.structure.files import File

    for source, place in PAGES.items():
        files.append(File.generated(config, place, content=(ROOT / source).read_text()))
    return files


def on_page_markdown(markdown: str, page: Any, **_: Any) -> str:
    """Turn every link of a page towards the site."""
    place = page.file.src_uri
    outside = {there: source for source, there in PAGES.items()}
    source = ROOT / outside.get(place, f"docs/{place}")
    return LINK.sub(lambda hit: _turned(hit, source, place), markdown)


def _turned(hit: re.Match[str], source: Path, place: str) -> str:
    mark, text, target, anchor = hit.group(1), hit.group(2), hit.group(3), hit.group(4) or ""
    if not target or "://" in target or target.startswith("mailto:"):
        return hit.group(0)
    file = (source.parent / target).resolve()
    if not file.exists():
        raise FileNotFoundError(f"{source} links {target}, which is not there")
    name = file.relative_to(ROOT).as_posix()
    if name in PAGES:
        there = PAGES[name]
    elif name == "docs":
        there = "README.md"
    elif name.startswith("docs/") and file.is_file():
        there = name.removeprefix("docs/")
    else:
        return f"{text} (`{name}`)" if name not in text else text
    up = "../" * (len(Path(place).parts) - 1)
    return f"{mark}[{text}]({up}{there}{anchor})"
