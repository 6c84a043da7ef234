"""`report.html`: one file that shows a run in any browser, offline; every picture and script is inside it.

Everything is in the page before a script runs: figures, map, timeline, keyframes. The scripts add the 3-D view and
show the keyframes one at a time. A content security policy forbids the page to fetch anything at all.
"""

import base64
import hashlib
import html
import json
from dataclasses import replace
from importlib import resources
from typing import Any

import numpy as np

from pipeline.depth.completed_submap import CompletedSubmap
from pipeline.input.frames import Frames
from pipeline.report.figures import path_figure, webp
from pipeline.report.page.keyframe_gallery import MOST_SUBMAPS, browser_section, choose_shown, count_sentence, data_uri
from pipeline.report.page.scene import finite, scene_data
from pipeline.report.page.summary import Link, cards, cautions, coverage_section, details
from pipeline.report.page.timeline import frame_states, timeline_section
from pipeline.run_folder.workspace import Workspace, write_text
from pipeline.surface.coverage_stage import CoverageResult
from pipeline.surface.fusion_stage import Surface
from reconstruction.mesh.rendering import render_mesh

MAPS_BUDGET = 1_200_000  # bytes of the maps of coverage, beyond the first
MOST_STATIC = 3  # submaps, largest first, that have pictures for a browser without scripts
SCRIPTS = ("scene.js", "report.js")
__all__ = ["coverage_section", "write_page"]


def write_page(
    frames: Frames,
    submaps: list[CompletedSubmap],
    surfaces: list[Surface],
    coverage: list[CoverageResult],
    metrics: dict[str, Any],
    workspace: Workspace,
) -> None:
    """Write the report of a run."""
    surfaces = [replace(surface, mesh=finite(surface.mesh)) for surface in surfaces]
    shown = choose_shown(frames, submaps)
    frame_of = np.array([keyframe.frame for keyframe in shown])

    def link(frame: int) -> str:
        return f"#keyframe-{int(np.abs(frame_of - frame).argmin()) if len(frame_of) else 0}"

    states = frame_states(workspace, submaps)
    data = {
        "submaps": scene_data(frames, submaps, surfaces, coverage, shown),
        "shown": [{"submap": k.submap, "frame": k.frame, "seconds": k.seconds} for k in shown],
        "seconds": states.range,
    }
    name = html.escape(workspace.root.resolve().name)
    page = _asset("report.html")
    for mark, text in {
        "TITLE": name,
        "SOURCE": html.escape(str(metrics["source"])),
        "VERSION": html.escape(workspace.record["versions"]["haustra"]),
        "CAUTIONS": cautions(metrics),
        "CARDS": cards(metrics),
        "STATIC": "".join(_static(frames, *parts) for parts in list(zip(submaps, surfaces, strict=True))[:MOST_STATIC]),
        "COUNT": html.escape(count_sentence(shown, submaps)),
        "BROWSER": browser_section(shown, submaps, surfaces),
        "TIMELINE": timeline_section(states, shown, submaps),
        "COVERAGE": _coverage(coverage, link),
        "DETAILS": details(metrics),
        "STYLE": _asset("report.css"),
        "DATA": json.dumps(data, allow_nan=False).replace("<", "\\u003c"),
    }.items():
        page = page.replace(f"<!--{mark}-->", text)
    write_text(workspace.report, _with_scripts(page))


def _with_scripts(page: str) -> str:
    """The page with its scripts inside, and a policy that lets these very scripts run, and nothing be fetched."""
    from plotly.offline import get_plotlyjs

    scripts = [get_plotlyjs(), "\n".join(_asset(name) for name in SCRIPTS)]
    digests = (base64.b64encode(hashlib.sha256(script.encode()).digest()).decode() for script in scripts)
    allowed = " ".join(f"'sha256-{digest}'" for digest in digests)
    policy = (
        f"default-src 'none'; script-src {allowed}; style-src 'unsafe-inline'; img-src data: blob:; "
        "base-uri 'none'; form-action 'none'"
    )
    page = page.replace("<!--POLICY-->", f'<meta http-equiv="Content-Security-Policy" content="{policy}">')
    return page.replace("<!--SCRIPTS-->", "".join(f"<script>{script}</script>\n" for script in scripts))


def _asset(name: str) -> str:
    return (resources.files("pipeline.report.page") / name).read_text(encoding="utf-8")


def _coverage(coverage: list[CoverageResult], link: Link) -> str:
    mapped = _count_mapped(coverage)
    sections = [coverage_section(result, link) for result in coverage[:mapped]]
    if len(coverage) == 1:
        return sections[0]
    named = [
        section.replace("<h2>Coverage</h2>", f"<h2>Coverage of submap {k}</h2>", 1)
        for k, section in enumerate(sections)
    ]
    return "".join(named) + _coverage_in_words(coverage[mapped:], mapped)


def _count_mapped(coverage: list[CoverageResult]) -> int:
    """Of how many submaps, largest first, the page has room for the map."""
    sizes = [result.picture.stat().st_size if result.picture else 0 for result in coverage[:MOST_SUBMAPS]]
    return max(1, int((np.cumsum(sizes) <= MAPS_BUDGET).sum()))


def _coverage_in_words(rest: list[CoverageResult], first: int) -> str:
    """Of the smaller submaps, whose maps would make the page too large."""
    if not rest:
        return ""
    items = "".join(
        f"<li>submap {number}: {html.escape(result.sentence)}</li>" for number, result in enumerate(rest, start=first)
    )
    return (
        f"<h2>Coverage of smaller submaps</h2><p>To keep this page small, maps are shown of the {first} largest of "
        f"{first + len(rest)} submaps, and keyframes of at most {MOST_SUBMAPS}. The other maps are coverage_*.png in "
        f"the run folder; metrics.json lists all missed regions.</p><ul>{items}</ul>"
    )


def _static(frames: Frames, completed: CompletedSubmap, surface: Surface) -> str:
    """For a browser without scripts or WebGL: the surface from outside and from within, and the path."""
    centres, unit = completed.submap.centres * surface.scale.factor, surface.scale.unit
    seconds = np.array([frames.seconds_of(int(index)) for index in completed.submap.frames])
    path = _image(path_figure(centres, completed.rows, seconds, unit), "png", "camera path")
    if len(surface.mesh.faces) == 0:
        return f"<p>The keyframes of this submap agree on no surface.</p>{path}"
    if len(completed.rows) == 0:  # no place to look from
        outside = render_mesh(surface.mesh, None, 640, 480, cut_away=True)
        return f"{_image(webp(outside), 'webp', 'surface cut open')}{path}"
    middle = completed.submap.scaled(surface.scale.factor).world_from_camera[completed.rows[len(completed.rows) // 2]]
    wide = float(np.degrees(2 * np.arctan(completed.camera.width / 2 / completed.camera.focal[0])))
    outside = render_mesh(surface.mesh, None, 640, 480, cut_away=True)
    inside = render_mesh(surface.mesh, middle, 640, 480, fov_deg=wide)
    return (
        f"{_image(webp(outside), 'webp', 'surface cut open')}{_image(webp(inside), 'webp', 'surface from the camera')}"
        f'<p class="fine">Cut open from outside, and from the middle keyframe\'s place.</p>{path}'
    )


def _image(data: bytes, kind: str, text: str) -> str:
    return f'<img alt="{html.escape(text)}" src="{data_uri(data, kind)}">'
