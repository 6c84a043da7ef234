"""Keyframes as small pictures side by side: image, sparse points, completed depth, confidence."""

import base64
import html
import io
from collections.abc import Iterable, Iterator
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from haustra.core.threads import prefetched, workers
from pipeline.depth.completed_submap import CompletedSubmap
from pipeline.depth.sparse_depth import SparseDepth, SparseDepthMaker
from pipeline.input.frames import Frames
from pipeline.surface.fusion_stage import Surface
from pipeline.surface.scale import unit_label

MOST_KEYFRAMES = 60
MOST_SUBMAPS = 12  # largest first, that have keyframes and maps of coverage
LONG_SIDE = 360  # px
BUDGET = 4_000_000  # bytes of all pictures, before base64 adds a third
QUALITIES = (82, 65, 45, 25)  # of WebP, tried until the budget is kept
DEPTH_MAP, CONFIDENCE_MAP = cv2.COLORMAP_TURBO, cv2.COLORMAP_MAGMA
NOTHING = (38, 34, 30)  # BGR, where there is no depth
BAR_STOPS = 12
DOT = 36  # radius of a sparse point, sixteenths of a pixel
RANGE_SAMPLES = 12  # keyframes from which a submap's colour range is taken

Image = NDArray[np.uint8]


@dataclass(frozen=True)
class Shown:
    """A keyframe that the page shows: `row` in its submap."""

    submap: int
    row: int
    frame: int
    seconds: float


def choose_shown(frames: Frames, submaps: list[CompletedSubmap], most: int = MOST_KEYFRAMES) -> list[Shown]:
    """At most `most` keyframes, evenly over those of the largest submaps, in the order of submaps and frames."""
    every = [
        Shown(number, int(row), index := int(completed.submap.frames[row]), frames.seconds_of(index))
        for number, completed in enumerate(submaps[:MOST_SUBMAPS])
        for row in completed.rows
    ]
    if not every:
        return []
    chosen = np.unique(np.linspace(0, len(every) - 1, most).round().astype(int))
    return [every[int(place)] for place in chosen]


@dataclass(frozen=True)
class Panels:
    """One keyframe's four pictures, encoded, and how many sparse points there are."""

    pictures: tuple[bytes, bytes, bytes, bytes]
    points: int


def browser_section(shown: list[Shown], submaps: list[CompletedSubmap], surfaces: list[Surface]) -> str:
    """Every shown keyframe as an article. Without script they stand in a list; with it, one at a time is seen."""
    ranges = {k: _depth_range(submaps[k], surfaces[k].scale.factor) for k in sorted({k.submap for k in shown})}
    panels = _within_budget(shown, submaps, surfaces, ranges)
    several = len(submaps) > 1
    parts = [_legend(number, limits, surfaces[number].scale.unit) for number, limits in ranges.items()]
    for number, (keyframe, panel) in enumerate(zip(shown, panels, strict=True)):
        where = f", submap {keyframe.submap}" if several else ""
        title = f"frame {keyframe.frame} · {keyframe.seconds:.2f} s{where}"
        titles = ("image", f"{panel.points} sparse points", "completed depth", "confidence")
        figures = "".join(
            f'<figure><img alt="{name} of frame {keyframe.frame}" src="{data_uri(picture, "webp")}">'
            f"<figcaption>{name}</figcaption></figure>"
            for name, picture in zip(titles, panel.pictures, strict=True)
        )
        parts.append(
            f'<article class="keyframe" id="keyframe-{number}"><h3>{html.escape(title)}</h3>'
            f'<div class="panels">{figures}</div></article>'
        )
    return "\n".join(parts)


def data_uri(data: bytes, kind: str) -> str:
    """Bytes of a picture as the text of an attribute."""
    return f"data:image/{kind};base64,{base64.b64encode(data).decode()}"


def _within_budget(
    shown: list[Shown],
    submaps: list[CompletedSubmap],
    surfaces: list[Surface],
    ranges: dict[int, tuple[float, float]],
) -> list[Panels]:
    """All pictures at the best quality that keeps the page small, however noisy the video is."""
    panels: list[Panels] = []
    for quality in QUALITIES:
        panels = list(_draw(shown, submaps, surfaces, ranges, quality))
        if sum(len(picture) for panel in panels for picture in panel.pictures) <= BUDGET:
            break
    return panels


def _draw(
    shown: list[Shown],
    submaps: list[CompletedSubmap],
    surfaces: list[Surface],
    ranges: dict[int, tuple[float, float]],
    quality: int,
) -> Iterator[Panels]:
    makers = {k: SparseDepthMaker(submaps[k].submap, submaps[k].camera) for k in sorted({one.submap for one in shown})}

    def drawn(keyframe: Shown) -> Panels:
        completed, factor = submaps[keyframe.submap], surfaces[keyframe.submap].scale.factor
        views, limits = completed.keyframe(keyframe.row), ranges[keyframe.submap]
        sparse = makers[keyframe.submap].sparse_depth(keyframe.row).scaled(factor)
        known, image = views.depth > 0, np.ascontiguousarray(views.rgb[..., ::-1])
        pictures = (
            _small(image),
            draw_sparse(_small(image), sparse, image.shape[1], limits),
            painted(_small(views.depth * factor, cv2.INTER_NEAREST), limits, DEPTH_MAP),
            painted(_small(np.where(known, views.confidence, -1), cv2.INTER_NEAREST), (0.0, 1.0), CONFIDENCE_MAP),
        )
        encoded = [_webp(picture, quality) for picture in pictures]
        return Panels((encoded[0], encoded[1], encoded[2], encoded[3]), len(sparse.depth))

    yield from prefetched(drawn, shown, workers(), workers())


def _depth_range(completed: CompletedSubmap, factor: float) -> tuple[float, float]:
    """One colour range for the whole submap, so that neighbouring keyframes can be compared; output units."""
    step = max(1, len(completed) // RANGE_SAMPLES)
    return colour_range((completed.depth(int(row))[0] for row in completed.rows[::step]), factor)


def painted(values: NDArray[np.float32], limits: tuple[float, float], colours: int) -> Image:
    """(H,W) to BGR by a colour map; what is not known (depth 0, confidence below 0) stays dark."""
    low, high = limits
    levels = np.clip((values - low) / (high - low) * 255, 0, 255).astype(np.uint8)
    picture = cv2.applyColorMap(levels, colours)
    missing = values <= 0 if colours == DEPTH_MAP else values < 0
    picture[missing] = NOTHING
    return picture


def draw_sparse(image: Image, sparse: SparseDepth, width: int, limits: tuple[float, float]) -> Image:
    """Dots in the colours of the dense depth on the darkened image, `width` px wide before it was reduced."""
    canvas, low, high = image // 3, *limits
    levels = np.clip((sparse.depth - low) / (high - low) * 255, 0, 255).astype(np.uint8)
    colours = cv2.applyColorMap(levels.reshape(-1, 1), DEPTH_MAP).reshape(-1, 3) if len(levels) else []
    scale = image.shape[1] / width
    for (x, y), colour in zip(sparse.pixels * scale - 0.5, colours):
        centre = (round(16 * float(x)), round(16 * float(y)))  # sixteenths of a pixel
        cv2.circle(canvas, centre, DOT, [int(c) for c in colour], -1, cv2.LINE_AA, shift=4)
    return canvas


def _small(image: NDArray, interpolation: int = cv2.INTER_AREA) -> NDArray:
    height, width = image.shape[:2]
    scale = min(1.0, LONG_SIDE / max(height, width))
    if scale == 1.0:
        return image
    size = (max(1, round(width * scale)), max(1, round(height * scale)))
    return cv2.resize(image.astype(np.float32) if image.ndim == 2 else image, size, interpolation=interpolation)


def _webp(picture: Image, quality: int) -> bytes:
    """BGR to WebP; OpenCV's has no `method`, which at 2 takes half the time for a twentieth more bytes."""
    from PIL import Image as Picture

    buffer = io.BytesIO()
    Picture.fromarray(np.ascontiguousarray(picture[..., ::-1])).save(buffer, "WEBP", quality=quality, method=2)
    return buffer.getvalue()


def _legend(number: int, limits: tuple[float, float], unit: str) -> str:
    """The two colour bars of a submap's keyframes."""
    low, high = limits
    word = unit_label(unit)
    return (
        f'<div class="legend" data-submap="{number}">{_bar(DEPTH_MAP, f"{low:.3g}", f"depth [{word}]", f"{high:.3g}")}'
        f"{_bar(CONFIDENCE_MAP, '0', 'confidence', '1')}</div>"
    )


def _bar(colours: int, low: str, title: str, high: str) -> str:
    return (
        f'<div class="bar"><span class="ramp" style="background:{ramp(colours)}"></span>'
        f"<span>{low}</span><span>{title}</span><span>{high}</span></div>"
    )


def ramp(colours: int) -> str:
    """A colour map from its low to its high end, as CSS paints it."""
    stops = cv2.applyColorMap(np.linspace(0, 255, BAR_STOPS).astype(np.uint8).reshape(-1, 1), colours).reshape(-1, 3)
    return f"linear-gradient(90deg,{','.join(f'#{r:02x}{g:02x}{b:02x}' for b, g, r in stops.tolist())})"


def colour_range(depths: Iterable[NDArray[np.float32]], factor: float) -> tuple[float, float]:
    """Depths (0 = none) at the two ends of the colours, times `factor`; 0 and 1 where none is known."""
    known = [depth[depth > 0] for depth in depths]
    if not sum(map(len, known)):
        return 0.0, 1.0
    low, high = np.percentile(np.concatenate(known), [1, 98]) * factor
    return float(low), float(max(high, low * 1.01))


def count_sentence(shown: Iterable[Shown], submaps: list[CompletedSubmap]) -> str:
    """How many of how many keyframes are in the page."""
    count, total = len(list(shown)), sum(len(completed) for completed in submaps)
    where = f" over the {MOST_SUBMAPS} largest of {len(submaps)} submaps" if len(submaps) > MOST_SUBMAPS else ""
    return f"all {total} keyframes" if count == total else f"{count} of {total} keyframes, evenly spread{where}"
