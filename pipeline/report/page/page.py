"""`report.html`: one file that shows a run in any browser, offline; every picture and script is inside it.

Everything is in the page before a script runs: figures, map, timeline, keyframes. The scripts add the 3-D view and the
rings for missed regions, and show the keyframes one at a time. A content security policy forbids the page to fetch
anything at all.
"""

import base64
import hashlib
import html
import json
from importlib import resources
from typing import Any

import numpy as np

from haustra.core.text import counted, write_text
from pipeline.depth.completed_submap import CompletedSubmap
from pipeline.input.frames import Frames
from pipeline.report.page.keyframe_gallery import MOST_SUBMAPS, Shown, count_sentence
from pipeline.report.page.pictures import PagePictures, draw_pictures, finite_surfaces
from pipeline.report.page.scene import scene_data
from pipeline.report.page.summary import Link, cards, cautions, coverage_section, details, source_name
from pipeline.report.page.timeline import frame_states, timeline_section
from pipeline.run_folder.workspace import Workspace
from pipeline.surface.coverage_stage import CoverageResult
from pipeline.surface.fusion_stage import Surface

MAPS_BUDGET = 1_200_000  # bytes of the maps of coverage, beyond the first
SCRIPTS = ("scene.js", "report.js")
__all__ = ["coverage_section", "write_page"]


def write_page(
    frames: Frames,
    submaps: list[CompletedSubmap],
    surfaces: list[Surface],
    coverage: list[CoverageResult],
    metrics: dict[str, Any],
    workspace: Workspace,
    pictures: PagePictures | None = None,
) -> None:
    """Write the report of a run; pictures: where they are drawn already."""
    pictures = pictures or draw_pictures(frames, submaps, surfaces)
    surfaces, shown = finite_surfaces(surfaces), pictures.shown
    scene, states = scene_data(frames, submaps, surfaces, coverage, shown), frame_states(workspace, submaps)
    data = {
        "submaps": scene,
        "shown": [{"submap": k.submap, "frame": k.frame, "seconds": k.seconds} for k in shown],
        "seconds": states.range,
    }
    name = html.escape(workspace.root.resolve().name)
    page = _asset("report.html")
    for mark, text in {
        "TITLE": name,
        "SOURCE": html.escape(source_name(metrics)),
        "VERSION": html.escape(workspace.record["versions"]["haustra"]),
        "CAUTIONS": cautions(metrics),
        "CARDS": cards(metrics),
        "STATIC": pictures.static,
        "COUNT": html.escape(count_sentence(shown, submaps)),
        "BROWSER": pictures.browser,
        "TIMELINE": timeline_section(states, shown, submaps),
        "COVERAGE": _coverage(coverage, [_links(of["missed"]["regions"], shown) for of in scene]),
        "DETAILS": details(metrics),
        "STYLE": _asset("report.css"),
        "DATA": json.dumps(data, allow_nan=False).replace("<", "\\u003c"),
    }.items():
        page = page.replace(f"<!--{mark}-->", text)
    write_text(workspace.report, _with_scripts(page))


def _with_scripts(page: str) -> str:
    """The page with its scripts inside, and a policy that lets these very scripts run, and nothing be fetched."""
    from plotly.offline import get_plotlyjs

    first, *scripts = [_asset("theme.js"), get_plotlyjs(), "\n".join(_asset(name) for name in SCRIPTS)]
    digests = (base64.b64encode(hashlib.sha256(script.encode()).digest()).decode() for script in (first, *scripts))
    allowed = " ".join(f"'sha256-{digest}'" for digest in digests)
    policy = (
        f"default-src 'none'; script-src {allowed}; style-src 'unsafe-inline'; img-src data: blob:; "
        "base-uri 'none'; form-action 'none'"
    )
    page = page.replace("<!--POLICY-->", f'<meta http-equiv="Content-Security-Policy" content="{policy}">')
    page = page.replace("<!--FIRST_SCRIPT-->", f"<script>{first}</script>")
    return page.replace("<!--SCRIPTS-->", "".join(f"<script>{script}</script>\n" for script in scripts))


def _asset(name: str) -> str:
    return (resources.files("pipeline.report.page") / name).read_text(encoding="utf-8")


def _links(regions: list[dict[str, Any]], shown: list[Shown]) -> dict[int, Link]:
    """Of each region by its number: the keyframe that shows its direction."""
    return {
        of["number"]: Link(f"#keyframe-{of['keyframe']}", shown[of["keyframe"]].frame, of["at"] is not None)
        for of in regions
        if of["keyframe"] is not None
    }


def _coverage(coverage: list[CoverageResult], links: list[dict[int, Link]]) -> str:
    """The first submap and those with a map, as far as there is room for it; the others in words."""
    if len(coverage) == 1:
        return coverage_section(coverage[0], links[0])
    mapped = _mapped(coverage)
    named = [
        coverage_section(coverage[k], links[k]).replace("<h2>Coverage</h2>", f"<h2>Coverage of submap {k}</h2>", 1)
        for k in mapped
    ]
    return "".join(named) + _coverage_in_words({k: of for k, of in enumerate(coverage) if k not in mapped})


def _mapped(coverage: list[CoverageResult]) -> list[int]:
    """Numbers of submaps, largest first, that have a section of their own."""
    sizes = {k: of.picture.stat().st_size for k, of in enumerate(coverage[:MOST_SUBMAPS]) if of.picture}
    total = np.cumsum(list(sizes.values()))
    return sorted({0, *(k for k, so_far in zip(sizes, total, strict=True) if so_far <= MAPS_BUDGET)})


def _coverage_in_words(rest: dict[int, CoverageResult]) -> str:
    """Of submaps, by number, that could not be judged, or whose maps would make the page too large."""
    if not rest:
        return ""
    items = "".join(f"<li>submap {number}: {html.escape(of.sentence)}</li>" for number, of in rest.items())
    without = sum(of.picture is not None for of in rest.values())
    elsewhere = (
        f"<p>To keep this page small, {counted(without, 'further map is', 'further maps are')} in the run folder, as "
        "coverage_*.png; metrics.json lists all missed regions.</p>"
    )
    return f"<h2>Coverage of the other submaps</h2>{elsewhere if without else ''}<ul>{items}</ul>"
