"""Gallery: one image of all scenes in rows, with depth and events."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from haustra.core.errors import PhantomError
from haustra.phantom.config import CameraConfig, EventsConfig, PhantomConfig
from haustra.phantom.dataset.scenes import scene_config
from haustra.phantom.dataset.script import write_script
from haustra.phantom.imaging.render import Frame, Phantom
from haustra.phantom.timeline import EVENTS

Image = NDArray[np.uint8]
SIDE = 224  # px of one frame
COLUMNS = 6
GAP = 4  # px between frames
LABEL_PX = 26  # height of a row's label
ROWS: tuple[tuple[str, str, tuple[int, ...]], ...] = (
    ("colon", "colon", (1, 2, 3)),
    ("small intestine", "small_intestine", (1, 2, 3)),
    ("ccd: two materials under two lights", "ccd", (0, 1, 2, 3)),
    ("csd: poor light, rich vessels", "csd", (1, 2, 3)),
)


def write_gallery(target: Path, progress: Callable[[int, int], None] | None = None) -> Path:
    """Render the gallery into an image file; `progress(done, total)` counts phantoms."""
    if target.suffix.lower() not in (".png", ".jpg"):
        raise PhantomError(f"{target}: the gallery is a .png or a .jpg file")
    total, done = sum(len(seeds) for _, _, seeds in ROWS) + 1, 0
    sheets: list[Image] = []
    truth: list[Image] = []
    for label, scene, seeds in ROWS:
        frames: list[Frame] = []
        for seed, count in zip(seeds, _shares(COLUMNS, len(seeds))):
            frames += _views(_small(scene_config(scene, seed)), count)
            done += 1
            if progress:
                progress(done, total)
        sheets.append(_labelled(label, [frame.image for frame in frames]))
        truth = truth or [_coloured(frame.depth) for frame in frames]
    sheets.insert(1, _labelled("the first row's depth, 5 to 100 mm (darkest: farther, or no wall)", truth))
    sheets.append(_labelled("red-out, water jet, bubbles, tool, peristalsis, then all is well again", _events()))
    if progress:
        progress(total, total)
    target.parent.mkdir(parents=True, exist_ok=True)
    target.write_bytes(cv2.imencode(target.suffix.lower(), np.vstack(sheets)[..., ::-1])[1].tobytes())
    return target


def _small(config: PhantomConfig) -> PhantomConfig:
    """The config at SIDE px."""
    return replace(config, camera=replace(config.camera, width=SIDE, height=SIDE))


def _shares(total: int, parts: int) -> list[int]:
    """`total` split into whole parts that differ by at most 1."""
    return [total // parts + (part < total % parts) for part in range(parts)]


def _views(config: PhantomConfig, count: int) -> Iterator[Frame]:
    """`count` frames spread over one video."""
    phantom = Phantom(config)
    world_from_camera = write_script(phantom).world_from_camera
    for place in np.linspace(0.1, 0.9, count):
        index = int(place * (len(world_from_camera) - 1))
        yield next(phantom.film(world_from_camera[index : index + 1]))


def _events() -> list[Image]:
    """The middle of each event, and one frame without any."""
    config = scene_config("colon", 4)
    lens = CameraConfig("OPENCV_FISHEYE", SIDE, SIDE, 110.0)
    imaging = replace(config.imaging, border="octagon", text=True)
    motion = replace(config.motion, frames=200, speed_mm=0.3)
    config = replace(config, camera=lens, imaging=imaging, motion=motion, events=EventsConfig(1, 1, 1, 1, 1))
    phantom = Phantom(config)
    script = write_script(phantom)
    film = list(phantom.film(script.world_from_camera, script.timeline, script.wall))
    middles = {slot.kind: (slot.first + slot.last) // 2 for slot in script.timeline}
    return [film[middles[kind]].image for kind in EVENTS] + [film[-1].image]


def _coloured(depth: NDArray[np.float32]) -> Image:
    """Depth (H,W) mm as colours on a log scale from 5 to 100 mm; black without depth."""
    near, far = np.log(5.0), np.log(100.0)
    part = (np.log(np.maximum(depth, 1e-3)) - near) / (far - near)
    picture = cv2.applyColorMap((255 * (1 - np.clip(part, 0, 1))).astype(np.uint8), cv2.COLORMAP_TURBO)[..., ::-1]
    return np.where(depth[..., None] > 0, picture, 0).astype(np.uint8)


def _labelled(label: str, images: list[Image]) -> Image:
    """Images beside each other under a line of text."""
    gap = np.full((SIDE, GAP, 3), 255, np.uint8)
    row = np.hstack([part for image in images for part in (image, gap)])
    head = np.full((LABEL_PX, row.shape[1], 3), 255, np.uint8)
    cv2.putText(head, label, (2, LABEL_PX - 8), cv2.FONT_HERSHEY_SIMPLEX, 0.5, (40, 40, 40), 1, cv2.LINE_AA)
    return np.vstack([head, row])
