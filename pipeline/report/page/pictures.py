"""The pictures of a run's page, which need nothing of its coverage and can be drawn while that is measured."""

import html
from dataclasses import dataclass, replace

import numpy as np

from pipeline.depth.completed_submap import CompletedSubmap
from pipeline.input.frames import Frames
from pipeline.report.figures import path_figure, webp
from pipeline.report.page.keyframe_gallery import Shown, browser_section, choose_shown, data_uri
from pipeline.report.page.scene import finite
from pipeline.surface.fusion_stage import Surface
from pipeline.surface.scale import unit_label
from reconstruction.mesh.rendering import TWO_SUBPIXELS, render_mesh

SIZE = (640, 480)  # px, of the surfaces without script
MOST_STATIC = 3  # submaps, largest first, that have pictures for a browser without scripts


@dataclass(frozen=True)
class PagePictures:
    """The keyframes that the page shows, and as HTML the surfaces without script (`static`) and those keyframes."""

    shown: list[Shown]
    static: str
    browser: str


def draw_pictures(frames: Frames, submaps: list[CompletedSubmap], surfaces: list[Surface]) -> PagePictures:
    """All pictures but the map of coverage."""
    surfaces, shown = finite_surfaces(surfaces), choose_shown(frames, submaps)
    largest = list(zip(submaps, surfaces, strict=True))[:MOST_STATIC]
    static = "".join(_static(frames, *parts) for parts in largest)
    return PagePictures(shown, static, browser_section(shown, submaps, surfaces))


def finite_surfaces(surfaces: list[Surface]) -> list[Surface]:
    """Without faces that have a corner nowhere."""
    return [replace(surface, mesh=finite(surface.mesh)) for surface in surfaces]


def _static(frames: Frames, completed: CompletedSubmap, surface: Surface) -> str:
    """For a browser without scripts or WebGL: the surface from outside and from within, and the path."""
    centres, unit = completed.submap.centres * surface.scale.factor, unit_label(surface.scale.unit)
    seconds = np.array([frames.seconds_of(int(index)) for index in completed.submap.frames])
    path = _image(path_figure(centres, completed.rows, seconds, unit), "png", "camera path")
    if len(surface.mesh.faces) == 0:
        return f"<p>The keyframes of this submap agree on no surface.</p>{path}"
    if len(completed.rows) == 0:  # no place to look from
        outside = render_mesh(surface.mesh, None, *SIZE, cut_away=True, subpixels=TWO_SUBPIXELS)
        return f"{_image(webp(outside), 'webp', 'surface cut open')}{path}"
    middle = completed.submap.scaled(surface.scale.factor).world_from_camera[completed.rows[len(completed.rows) // 2]]
    wide = float(np.degrees(2 * np.arctan(completed.camera.width / 2 / completed.camera.focal[0])))
    outside = render_mesh(surface.mesh, None, *SIZE, cut_away=True, subpixels=TWO_SUBPIXELS)
    inside = render_mesh(surface.mesh, middle, *SIZE, fov_deg=wide, subpixels=TWO_SUBPIXELS)
    return (
        f"{_image(webp(outside), 'webp', 'surface cut open')}{_image(webp(inside), 'webp', 'surface from the camera')}"
        f'<p class="fine">Cut open from outside, and from the middle keyframe\'s place.</p>{path}'
    )


def _image(data: bytes, kind: str, text: str) -> str:
    return f'<img alt="{html.escape(text)}" src="{data_uri(data, kind)}">'
