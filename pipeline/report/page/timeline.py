"""What became of every frame, over the seconds of the video: an SVG that needs no script."""

import html
import json
from collections import Counter
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pipeline.depth.completed_submap import CompletedSubmap
from pipeline.report.page.keyframe_gallery import MOST_SUBMAPS, Shown
from pipeline.run_folder.workspace import Workspace, report_corruption

MOST_COLUMNS = 600
WIDTH = 1000.0  # of the drawing, stretched to the page
VERDICT_LANE, POSED_LANE, KEYFRAME_LANE = (0, 30), (36, 16), (58, 16)  # top and height
HEIGHT = 74
TICKS = 6
HUES = 6  # colours of submaps, then they come again
UNPOSED = -1


@dataclass(frozen=True)
class FrameStates:
    """Every frame that was looked at: seconds, verdict, and the submap that holds its pose (-1: none)."""

    index: NDArray[np.int64]
    seconds: NDArray[np.float64]
    verdicts: list[str]
    submap: NDArray[np.int64]

    @property
    def step(self) -> float:
        """Seconds between frames, in the median; 1 where the times do not tell."""
        between = np.diff(self.seconds)
        return float(np.median(between)) if len(between) and np.median(between) > 0 else 1.0

    @property
    def range(self) -> tuple[float, float]:
        """Seconds from the first frame to the end of the last."""
        return float(self.seconds[0]), float(self.seconds[-1]) + self.step


def frame_states(workspace: Workspace, submaps: list[CompletedSubmap]) -> FrameStates:
    """The state of each frame, from `frames.json` and the poses."""
    with report_corruption(workspace.frames):
        rows = json.loads(workspace.frames.read_text())["frames"]
    index = np.array([row[0] for row in rows], dtype=np.int64)
    submap = np.full(len(rows), UNPOSED)
    for number in reversed(range(len(submaps))):  # the largest, first one has the last word
        submap[np.isin(index, submaps[number].submap.frames)] = number
    return FrameStates(index, np.array([row[1] for row in rows], dtype=float), [row[2] for row in rows], submap)


def timeline_section(states: FrameStates, shown: list[Shown], submaps: list[CompletedSubmap]) -> str:
    """Three lanes: what was judged of the frames, which are posed, which are keyframes."""
    columns = _columns(states)
    count = int(columns.max()) + 1
    width = WIDTH / count
    drawing = _merged([_verdict_column(states, columns == c) for c in range(count)], width)
    drawing += _merged([_posed_column(states, columns == c) for c in range(count)], width)
    drawing += _keyframes(states, shown, submaps)
    start, end = states.range
    seconds = [start + (end - start) * k / (TICKS - 1) for k in range(TICKS)]
    digits = 0 if end - start > 30 else 1 if end - start > 3 else 2
    ticks = "".join(f"<span>{second:.{digits}f} s</span>" for second in seconds)
    return (
        f'<div class="timeline"><div class="lanes"><span>frames</span><span>posed</span><span>keyframes</span></div>'
        f'<div class="film"><svg id="timeline" viewBox="0 0 {WIDTH:g} {HEIGHT}" preserveAspectRatio="none" role="img" '
        f'aria-label="state of every frame over time">{drawing}'
        f'<rect id="cursor" x="-10" y="0" width="2" height="{HEIGHT}"/></svg>'
        f'<div class="ticks">{ticks}</div></div></div>'
        f"{_key(states, submaps)}"
    )


def slug(verdict: str) -> str:
    """A verdict as a class name."""
    return "v-" + "".join(c if c.isalnum() else "-" for c in verdict)


def _columns(states: FrameStates) -> NDArray[np.int64]:
    """(N,) column of each frame; as many columns as frames, until they would be too thin to see."""
    start, end = states.range
    count = min(len(states.seconds), MOST_COLUMNS)
    place = (states.seconds - start + states.step / 2) / (end - start) * count
    return np.clip(place.astype(np.int64), 0, count - 1)


Piece = tuple[str, str, float, float]  # class, text, top, height


def _verdict_column(states: FrameStates, mine: NDArray[np.bool_]) -> tuple[Piece, ...]:
    """A column split by the verdicts of its frames; the used ones at the bottom."""
    counts = Counter(states.verdicts[k] for k in np.flatnonzero(mine))
    top, height = VERDICT_LANE
    pieces, place = [], float(top)
    for verdict, n in sorted(counts.items(), key=lambda item: (item[0] == "used", item[0])):
        share = height * n / counts.total()
        pieces.append((slug(verdict), verdict, round(place, 2), round(share, 2)))
        place += share
    return tuple(pieces)


def _posed_column(states: FrameStates, mine: NDArray[np.bool_]) -> tuple[Piece, ...]:
    """A column split by what became of its frames; the posed ones at the bottom, above them those that were used."""
    posed, total, (top, height) = states.submap[mine & (states.submap != UNPOSED)], int(mine.sum()), POSED_LANE
    if not total:
        return ()
    lost = sum(states.verdicts[k] == "used" for k in np.flatnonzero(mine & (states.submap == UNPOSED)))
    share, place, pieces = height * len(posed) / total, float(top + height), []
    if len(posed):
        number, place = int(np.bincount(posed).argmax()), place - share
        pieces.append((f"s-{number % HUES}", f"posed in submap {number}", place, round(share, 2)))
    if lost:
        share = height * lost / total
        pieces.append(("s-none", "used, but not posed", place - share, round(share, 2)))
    return tuple(pieces)


def _merged(columns: list[tuple[Piece, ...]], width: float) -> str:
    """Neighbouring columns of the same make-up become one rectangle a piece."""
    parts, first = [], 0
    for place in range(1, len(columns) + 1):
        if place < len(columns) and columns[place] == columns[first]:
            continue
        x, w = first * width, (place - first) * width
        parts += [
            f'<rect class="{name}" x="{x:.2f}" y="{y:g}" width="{w:.2f}" height="{h:g}">'
            f"<title>{html.escape(text)}</title></rect>"
            for name, text, y, h in columns[first]
        ]
        first = place
    return "".join(parts)


def _keyframes(states: FrameStates, shown: list[Shown], submaps: list[CompletedSubmap]) -> str:
    """A thin mark for every keyframe, at most one a column, and a thick one for those that the page shows."""
    start, end = states.range
    top, height = KEYFRAME_LANE
    when = dict(zip(states.index.tolist(), states.seconds.tolist(), strict=True))
    every = {int(completed.submap.frames[row]) for completed in submaps for row in completed.rows}
    places = {round((when[f] - start) / (end - start) * MOST_COLUMNS) for f in every}
    thin = "".join(
        f'<rect class="thin" x="{p * WIDTH / MOST_COLUMNS:.2f}" y="{top + 5}" width="1" height="{height - 10}"/>'
        for p in sorted(places)
    )
    thick = "".join(
        f'<rect class="shown" data-keyframe="{number}" x="{(k.seconds - start) / (end - start) * WIDTH:.2f}" '
        f'y="{top}" width="4" height="{height}"><title>frame {k.frame}, {k.seconds:.2f} s</title></rect>'
        for number, k in enumerate(shown)
    )
    return thin + thick


def _key(states: FrameStates, submaps: list[CompletedSubmap]) -> str:
    counts = Counter(states.verdicts)
    items = [(slug(verdict), f"{verdict} ({n})") for verdict, n in counts.most_common()]
    sizes = [len(completed.submap.frames) for completed in submaps]
    items += [(f"s-{n % HUES}", f"posed, submap {n} ({size})") for n, size in enumerate(sizes[:MOST_SUBMAPS])]
    if sizes[MOST_SUBMAPS:]:
        items.append((f"s-{MOST_SUBMAPS % HUES}", f"posed, smaller submaps ({sum(sizes[MOST_SUBMAPS:])})"))
    unposed = sum(1 for v, s in zip(states.verdicts, states.submap) if v == "used" and s == UNPOSED)
    if unposed:
        items.append(("s-none", f"used, but not posed ({unposed})"))
    swatches = "".join(f'<span><i class="{name}"></i>{html.escape(text)}</span>' for name, text in items)
    return f'<p class="key">{swatches}</p>'
