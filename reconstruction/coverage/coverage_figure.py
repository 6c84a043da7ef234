"""`coverage.png`: unrolled map with numbered missed regions, its confidence, and coverage along the lumen."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from reconstruction.coverage.coverage import Coverage, Segment
from reconstruction.coverage.unrolled_map import MISSED, NOT_JUDGED, UNMEASURED, UnrolledMap

MISSED_COLOUR = (0.10, 0.35, 0.95)  # RGB in [0,1], as below; no tissue is blue
UNMEASURED_COLOUR = (0.72, 0.80, 0.95)
NOT_JUDGED_COLOUR = (0.88, 0.88, 0.88)
SEEN_COLOUR = (0.73, 0.44, 0.36)  # of the bars; on the map seen wall has its own colours
SEEN_BRIGHT = 235  # grey level that the 95th percentile of the seen wall is brightened to
WIDTH, HEIGHT = 13.0, 7.6  # inches
CLOCK = {0: "12", 3: "3", 6: "6", 9: "9", 12: "12"}  # ticks of the angle's axis, hours


def draw_coverage(
    coverage: Coverage, unrolled_map: UnrolledMap, segments: list[Segment], listed: int, path: Path | str
) -> None:
    """Write the figure to `path` (PNG); the first `listed` regions carry their number, counted from 1."""
    # Here and not above: importing them takes half a second, which a run's first stages need not wait for.
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(WIDTH, HEIGHT), layout="constrained")
    FigureCanvasAgg(figure)
    wall, trust, bars = figure.subplots(3, 1, sharex=True, height_ratios=(3.2, 1.6, 1.1))
    unit = "mm" if coverage.unit == "mm" else f"{coverage.unit} units"
    _show(wall, unrolled_map, _wall_colours(unrolled_map))
    _mark_regions(wall, coverage, unrolled_map, listed)
    wall.set_title(
        f"{100 * coverage.share:.1f} % of the wall seen over {coverage.length:.3g} {unit}, "
        f"{100 * coverage.whole.unmeasured_share:.1f} % without being measured (pale); blue: missed; grey: not judged",
        loc="left",
    )
    shown = _show(trust, unrolled_map, np.where(unrolled_map.state == NOT_JUDGED, np.nan, unrolled_map.confidence))
    figure.colorbar(shown, ax=trust, label="confidence", pad=0.01)
    _draw_bars(bars, segments)
    bars.set_xlabel(f"arc length along the lumen [{unit}], growing the way the camera looked")
    for panel in (wall, trust):
        panel.set_yticks([np.pi * hour / 6 for hour in CLOCK], list(CLOCK.values()))
        panel.set_ylabel("o'clock")
    figure.savefig(path, dpi=110)


def _show(panel: Any, unrolled_map: UnrolledMap, values: NDArray[Any]) -> Any:
    """Draw values (A,B) or colours (A,B,3) with arc length to the right and angle down."""
    low, high = unrolled_map.arc_edges[[0, -1]]
    return panel.imshow(
        np.swapaxes(values, 0, 1),
        extent=(low, high, 2 * np.pi, 0),
        aspect="auto",
        interpolation="nearest",
        cmap="magma",
        vmin=0,
        vmax=1,
    )


def _wall_colours(unrolled_map: UnrolledMap) -> NDArray[np.float64]:
    """RGB (A,B,3) in [0,1]: seen cells in their colours, brightened by one factor; all others in their state's."""
    seen = unrolled_map.colour.max(axis=2)[unrolled_map.state != NOT_JUDGED]
    lit = seen[seen > 0]
    gain = max(1.0, SEEN_BRIGHT / max(1.0, float(np.percentile(lit, 95)))) if len(lit) else 1.0
    image = np.minimum(unrolled_map.colour * gain / 255, 1)
    image[unrolled_map.state == MISSED] = MISSED_COLOUR
    image[unrolled_map.state == UNMEASURED] = UNMEASURED_COLOUR
    image[unrolled_map.state == NOT_JUDGED] = NOT_JUDGED_COLOUR
    return image


def _mark_regions(panel: Any, coverage: Coverage, unrolled_map: UnrolledMap, listed: int) -> None:
    """Number each listed region at that of its cells which is nearest to its centre."""
    arc = (unrolled_map.arc_edges[1:] + unrolled_map.arc_edges[:-1]) / 2
    angle = (unrolled_map.angle_edges[1:] + unrolled_map.angle_edges[:-1]) / 2
    for number, region in enumerate(coverage.regions[:listed]):
        rows, columns = np.nonzero(unrolled_map.region == number)
        here = (region.clock or 12.0) * np.pi / 6  # where it goes all round, any of its cells will do
        if len(rows):
            turn = np.abs((angle[columns] - here + np.pi) % (2 * np.pi) - np.pi) * coverage.radius
            best = np.argmin(np.hypot(arc[rows] - region.arc, turn))
            place = arc[rows[best]], angle[columns[best]]
        else:
            place = region.arc, here % (2 * np.pi)
        panel.annotate(
            str(number + 1),
            place,
            ha="center",
            va="center",
            fontsize=9,
            color="white",
            bbox={"boxstyle": "circle,pad=0.2", "facecolor": "black", "edgecolor": "white", "linewidth": 0.8},
        )


def _draw_bars(panel: Any, segments: list[Segment]) -> None:
    """Stacked bars per segment: measured, unmeasured and missed share, with the seen share in per cent."""
    for segment in segments:
        width = segment.end - segment.start
        measured, bare = 100 * (segment.share - segment.unmeasured_share), 100 * segment.unmeasured_share
        panel.bar(segment.start, measured, width, align="edge", color=SEEN_COLOUR, edgecolor="white")
        panel.bar(segment.start, bare, width, measured, align="edge", color=UNMEASURED_COLOUR)
        panel.bar(
            segment.start, 100 - 100 * segment.share, width, 100 * segment.share, align="edge", color=MISSED_COLOUR
        )
        panel.text(
            segment.start + width / 2,
            50 * segment.share,
            f"{100 * segment.share:.0f} %",
            ha="center",
            va="center",
            color="white",
        )
    panel.set_ylim(0, 100)
    panel.set_ylabel("seen [%]")
