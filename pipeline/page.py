"""`report.html`: one file, no scripts, no network; every picture is inside it."""

import base64
import html
from typing import Any

import numpy as np

from pipeline.coverage import Judgement
from pipeline.dense import DenseSubmap
from pipeline.figures import frame_figure, path_figure, png
from pipeline.frames import Frames
from pipeline.sparse_depth import SparseDepthMaker
from pipeline.surface import Surface
from pipeline.workspace import Workspace, write_text
from reconstruction.pictures import render_mesh

SHOWN_KEYFRAMES = 5

STYLE = """
body { font: 15px/1.5 system-ui, sans-serif; max-width: 1080px; margin: 2em auto; padding: 0 1em; color: #222 }
h1 { font-weight: 600 } h2 { margin-top: 2em; font-weight: 600; font-size: 1.2em }
table { border-collapse: collapse } td, th { padding: .2em 1em .2em 0; text-align: left; vertical-align: top }
img { max-width: 100%; height: auto } .pair { display: flex; gap: 1em; flex-wrap: wrap } .pair img { width: 48% }
.note { color: #666; font-size: .92em }
"""


def write_page(
    frames: Frames,
    dense: list[DenseSubmap],
    surfaces: list[Surface],
    coverage: list[Judgement],
    metrics: dict[str, Any],
    workspace: Workspace,
) -> None:
    """Figures, path, mesh views and sample keyframes of a run; one section for each submap."""
    parts = [f"<h1>{html.escape(workspace.root.name)}</h1>", _summary(metrics)]
    for number, (part, surface, judgement) in enumerate(zip(dense, surfaces, coverage, strict=True)):
        if len(dense) > 1:
            parts.append(f"<h2>Submap {number}</h2>")
        parts += [
            _mesh_views(part, surface),
            coverage_section(judgement),
            _path(frames, part, surface),
            _keyframes(frames, part, surface, workspace),
        ]
    body = "\n".join(parts)
    write_text(
        workspace.report,
        f'<!doctype html><html lang="en"><meta charset="utf-8"><title>{html.escape(workspace.root.name)}</title>'
        f"<style>{STYLE}</style><body>{body}</body></html>\n",
    )


def _summary(metrics: dict[str, Any]) -> str:
    frames = metrics["frames"]
    left_out = ", ".join(f"{n} {why}" for why, n in frames["verdicts"].items() if why != "used") or "none"
    rows = [
        ("source", metrics["source"]),
        ("frames posed", f"{frames['posed']} of {frames['total']} ({len(metrics['submaps'])} submap(s))"),
        ("frames left out before tracking", left_out),
        ("camera", metrics["camera"]),
        ("structure", f"{metrics['mapper']} mapper"),
        ("completion model", metrics["model"]),
    ]
    for number, submap in enumerate(metrics["submaps"]):
        rows += _submap_rows(number, submap)
    rows += [("warning", warning) for warning in metrics["warnings"]]
    rows += [("note", note) for note in frames["notes"]]
    cells = "".join(f"<tr><th>{html.escape(a)}</th><td>{html.escape(str(b))}</td></tr>" for a, b in rows)
    return f"<table>{cells}</table>"


def _submap_rows(number: int, submap: dict[str, Any]) -> list[tuple[str, str]]:
    unit, witness = submap["unit"], submap["evidence"]
    light = f"of {witness['voters']} frames (Spearman {witness['spearman']:.2f} in the median)"
    return [
        (
            f"submap {number}",
            f"{submap['frames']} frames, {submap['keyframes']} keyframes, {submap['points']} points; "
            f"{submap['faces']} triangles, {submap['area']:.4g} {unit}² of surface; "
            f"camera path {submap['path_length']:.4g} {unit}; voxel {submap['voxel_size']:.3g} {unit}",
        ),
        (
            "evidence",
            f"reprojection error {witness['reprojection_px']:.2f} px (mean); triangulation angle "
            f"{witness['angle_deg']:.1f}° (median); nearer is brighter in "
            f"{100 * (1 - witness['contrary']):.0f} % {light}",
        ),
        ("scale", submap["scale"]),
        ("left out", _left_out(submap["contradicted_keyframes"])),
        ("calibration", submap["camera"]["trust"] + _cut(submap["rectified_share"])),
    ]


def _left_out(frames: list[int]) -> str:
    if not frames:
        return "no keyframe: none is contradicted by its neighbours in most of its pixels"
    return f"keyframes {', '.join(map(str, frames))}: their neighbours contradict their depth in most pixels"


def _cut(kept: float) -> str:
    if kept > 0.995:
        return ""
    return f"; the pinhole image of the dense stages shows {100 * kept:.0f} % of the frame"


def _mesh_views(part: DenseSubmap, surface: Surface) -> str:
    if len(surface.mesh.faces) == 0:
        return "<h2>Surface</h2><p>The keyframes of this submap agree on no surface.</p>"
    middle = part.submap.scaled(surface.scale.factor).world_from_camera[part.rows[len(part.rows) // 2]]
    outside = render_mesh(surface.mesh, None, 640, 480)
    wide = float(np.degrees(2 * np.arctan(part.camera.width / 2 / part.camera.focal[0])))
    inside = render_mesh(surface.mesh, middle, 640, 480, fov_deg=wide)
    note = "Only what was seen: holes are places that no keyframe saw well enough."
    return (
        f'<h2>Surface</h2><div class="pair">{_image(png(outside), "mesh from outside")}'
        f'{_image(png(inside), "mesh from the camera")}</div><p class="note">From outside, and from the middle '
        f"keyframe's place. {note}</p>"
    )


def coverage_section(judgement: Judgement) -> str:
    """The unrolled map and the table of what was missed; one sentence where nothing can be judged."""
    record = judgement.record
    if judgement.picture is None:
        reason = judgement.sentence
        return f"<h2>Coverage</h2><p>{html.escape(reason[:1].upper() + reason[1:])}.</p>"
    unit, regions = record["unit"], record["missed_regions"]
    head = ("region", f"area [{unit}²]", f"equivalent diameter [{unit}]", f"arc length [{unit}]", "o'clock")
    rows = [
        "".join(
            f"<td>{value}</td>"
            for value in (
                region["number"],
                f"{region['area']:.3g}",
                f"{region['diameter']:.3g}",
                f"{region['arc']:.3g}",
                "all round" if region["clock"] is None else f"{region['clock']:.1f}",
                f"{region['frame']} ({region['seconds']:.2f} s)",
            )
        )
        for region in regions
    ]
    heads = "".join(f"<th>{title}</th>" for title in (*head, "nearest frame"))
    table = f"<table><tr>{heads}</tr>{''.join(f'<tr>{row}</tr>' for row in rows)}</table>" if rows else ""
    return (
        f"<h2>Coverage</h2><p>{html.escape(judgement.sentence)}</p>"
        f"{_image(judgement.picture.read_bytes(), 'unrolled wall')}{table}"
        '<p class="note">The wall of the visited stretch laid flat. Areas of missed regions are those of a smooth '
        "closing of the surface, which is not part of the mesh. 12 o'clock is the top of the picture where the stretch "
        "begins, carried along without twisting.</p>"
    )


def _path(frames: Frames, part: DenseSubmap, surface: Surface) -> str:
    seconds = np.array([frames.seconds_of(int(index)) for index in part.submap.frames])
    centres = part.submap.centres * surface.scale.factor
    return f"<h2>Camera path</h2>{_image(path_figure(centres, part.rows, seconds, surface.scale.unit), 'camera path')}"


def _keyframes(frames: Frames, part: DenseSubmap, surface: Surface, workspace: Workspace) -> str:
    maker = SparseDepthMaker(part.submap, part.camera, workspace.config.sparse)
    chosen = part.rows[np.unique(np.linspace(0, len(part.rows) - 1, SHOWN_KEYFRAMES).astype(int))] if len(part) else []
    parts = ["<h2>Keyframes</h2>"]
    factor = surface.scale.factor
    for row in chosen:
        keyframe, sparse = part.keyframe(int(row)), maker.sparse_depth(int(row))
        picture = frame_figure(
            keyframe.rgb,
            sparse.scaled(factor),
            keyframe.depth * factor,
            keyframe.confidence,
            surface.scale.unit,
        )
        seconds = frames.seconds_of(keyframe.index)
        parts.append(f"<p>frame {keyframe.index}, {seconds:.2f} s</p>{_image(picture, f'frame {keyframe.index}')}")
    return "\n".join(parts)


def _image(data: bytes, text: str) -> str:
    return f'<img alt="{html.escape(text)}" src="data:image/png;base64,{base64.b64encode(data).decode()}">'
