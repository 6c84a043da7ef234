"""The page's figures: cards and cautions at its head, coverage's table, and every detail at its foot."""

import html
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from haustra.core.text import counted
from pipeline.report.cautions import left_out
from pipeline.report.page.keyframe_gallery import data_uri
from pipeline.report.page.scene import clock_words
from pipeline.surface.coverage_stage import CoverageResult, likely, share_seen
from pipeline.surface.scale import unit_label

STRUCTURE = {"odometry": "visual odometry", "global": "COLMAP, all frames at once", "incremental": "COLMAP, one by one"}
MOST_OPEN = 4  # cautions that are not folded


@dataclass(frozen=True)
class Link:
    """The article of a keyframe, its frame, and whether a ring in its picture marks the direction that is asked for."""

    address: str
    frame: int
    has_ring: bool


def _unmeasured(seen: dict[str, Any]) -> str:
    """Of a run that was made before wall in plain view was told apart, nothing."""
    share = seen.get("unmeasured_percent")
    return "" if share is None else f"; {share:.0f} % in view, but not measured"


def cards(metrics: dict[str, Any]) -> str:
    """The handful of figures that a reader looks for first; of the largest submap where there are several."""
    frames, main = metrics["frames"], metrics["submaps"][0]
    unit, seen = main["unit"], main["coverage"]
    word = unit_label(unit)
    several = len(metrics["submaps"]) > 1
    where = f", largest of {len(metrics['submaps'])} submaps" if several else ""
    of_one = where if any(one["scale"] != main["scale"] for one in metrics["submaps"]) else ""
    if seen["judged"]:
        regions = seen["missed_regions"]
        items = [
            (
                "wall seen",
                share_seen(seen),
                f"over {seen['stretch']:.3g} {word} of visited lumen{where}{_unmeasured(seen)}",
            ),
            (
                "missed regions",
                str(len(regions)),
                f"of {seen['listed_from']:.2g} {word} and more{likely(regions)}{where}; "
                f"{seen['smaller_regions']} smaller",
            ),
        ]
    else:
        items = [("wall seen", "not judged", seen["reason"] + where)]
    items += [
        (
            "frames posed",
            f"{frames['posed']} of {frames['total']}",
            f"{counted(main['keyframes'], 'keyframe')} completed{where}",
        ),
        ("camera path", _figure(main["path_length"]), f"{word}{where}"),
        ("surface", _figure(main["area"]), f"{word}², {main['faces']:,} triangles{where}"),
        ("scale", "mm" if unit == "mm" else "unknown", main["scale"] + of_one),
    ]
    return '<section class="cards">' + "".join(_card(*item) for item in items) + "</section>"


def _figure(value: float) -> str:
    """Three digits, or whole numbers; no exponent."""
    return f"{value:,.0f}" if value >= 100 else f"{value:.3g}"


def _card(title: str, figure: str, note: str) -> str:
    small = " words" if not figure[:1].isdigit() else ""
    return (
        f'<div class="card"><h3>{html.escape(title)}</h3><p class="figure{small}">{html.escape(figure)}</p>'
        f"<p>{html.escape(note)}</p></div>"
    )


def source_name(metrics: dict[str, Any]) -> str:
    """The film's name alone: a report is passed on, and folders may name a patient, too."""
    return Path(str(metrics["source"])).name


def cautions(metrics: dict[str, Any]) -> str:
    """What must not be overlooked, above everything else; then what is only good to know. Of many cautions, as a film
    in ten submaps has, the rest are counted and folded, so that the surface is not pushed off the page."""
    said = [_box("caution", text) for text in metrics["warnings"]]
    notes = [_box("note", text) for text in metrics["frames"]["notes"]]
    shown = MOST_OPEN if len(said) > MOST_OPEN + 1 else len(said)
    rest = "".join(said[shown:])
    more = f"<summary>{len(said) - shown} more cautions</summary>"
    folded = f'<details class="caution">{more}{rest}</details>' if rest else ""
    return "".join([*said[:shown], folded, *notes])


def _box(kind: str, text: str) -> str:
    return f'<p class="{kind}" role="note">{html.escape(text)}</p>'


def details(metrics: dict[str, Any]) -> str:
    """Every figure with its unit, as a table."""
    frames = metrics["frames"]
    unused = ", ".join(f"{n} {why}" for why, n in frames["verdicts"].items() if why != "used") or "none"
    rows = [
        ("source", source_name(metrics)),
        ("frames posed", f"{frames['posed']} of {frames['total']} in {counted(len(metrics['submaps']), 'submap')}"),
        ("frames left out before tracking", unused),
        ("camera", metrics["camera"]),
        ("path and points", STRUCTURE.get(metrics["mapper"], metrics["mapper"])),
        ("completion model", metrics["model"]),
    ]
    for number, submap in enumerate(metrics["submaps"]):
        rows += _submap_rows(number, submap)
    rows += [(f"loops of submap {n}", _loops(record)) for n, record in enumerate(metrics.get("loops", []))]
    rows += [(f"time of stage: {one['stage']}", _time_of_stage(one)) for one in metrics.get("profile", [])]
    cells = "".join(f"<tr><th>{html.escape(a)}</th><td>{html.escape(str(b))}</td></tr>" for a, b in rows)
    return f'<table class="facts">{cells}</table>'


def _time_of_stage(one: dict[str, Any]) -> str:
    return (
        f"{one['seconds']:.1f} s, {one['cpu_seconds']:.1f} s of processor time; peak memory until its end "
        f"{one['peak_mib']:.0f} MiB"
    )


def _submap_rows(number: int, submap: dict[str, Any]) -> list[tuple[str, str]]:
    unit, check = unit_label(submap["unit"]), submap["evidence"]
    light = (
        f"of the {check['voters']} frames with enough points (rank correlation of brightness with distance: "
        f"{check['spearman']:.2f} in the median, -1 at best)"
    )
    return [
        (
            f"submap {number}",
            f"{submap['frames']} frames, {submap['keyframes']} keyframes, {submap['points']} points; "
            f"{submap['faces']} triangles, {submap['area']:.4g} {unit}² of surface; "
            f"camera path {submap['path_length']:.4g} {unit}; voxel {submap['voxel_size']:.3g} {unit}",
        ),
        (
            "checks",
            f"reprojection error {check['reprojection_px']:.2f} px (mean); triangulation angle "
            f"{check['angle_deg']:.1f}° (median); nearer wall is darker, against the endoscope's own light, in "
            f"{100 * check['contrary']:.0f} % {light}",
        ),
        *_doubt_rows(submap.get("doubt")),
        ("scale", submap["scale"]),
        ("left out", left_out(submap["contradicted_keyframes"])),
        *_opened_rows(submap.get("opened_area_share", 0.0)),
        ("calibration", submap["camera"]["trust"] + _cut(submap["rectified_share"])),
    ]


def _doubt_rows(doubt: dict[str, Any] | None) -> list[tuple[str, str]]:
    """Of submaps of odometry that are long enough."""
    if doubt is None:
        return []
    sentence = f"{100 * doubt['probability']:.0f} %; what speaks most against it: {doubt['heaviest']}"
    return [("probability that this map is wrong", sentence)]


def _opened_rows(share: float) -> list[tuple[str, str]]:
    """Where spots of the surface were left open."""
    if not share:
        return []
    return [
        (
            "left open",
            f"{100 * share:.2f} % of the surface, small dark spots with a much darker middle and a bright rim: "
            "they may be mouths of pouches, or dark tissue or residue (fusion.open_dark_spots)",
        )
    ]


def _loops(record: dict[str, Any]) -> str:
    """What loop closing did, by the numbers of the frames that show the same place."""
    pairs = ", ".join(f"{first} and {second}" for first, second in record["loops"])
    joined = f"merged from {len(record['members'])} submaps; " if len(record["members"]) > 1 else ""
    if pairs:
        return joined + f"closed between frames {pairs}"
    if record["supported"]:
        return f"{joined}{record['supported']} found; the path fulfils them already, or see the warnings"
    return joined + "none: no revisited place was confirmed by two matches"


def _cut(kept: float) -> str:
    if kept > 0.995:
        return ""
    return f"; the pinhole image of the dense stages shows {100 * kept:.0f} % of the frame"


def coverage_section(result: CoverageResult, links: Mapping[int, Link]) -> str:
    """The unrolled map and the table of what was missed; one sentence where nothing can be judged. links: of regions by
    number, the keyframe that shows their direction."""
    record = result.record
    if result.picture is None:
        reason = result.sentence
        return f"<h2>Coverage</h2><p>{html.escape(reason[:1].upper() + reason[1:])}.</p>"
    unit = unit_label(record["unit"])
    head = ("region", f"area [{unit}²]", f"equivalent diameter [{unit}]", f"place along the lumen [{unit}]", "o'clock")
    rows = [
        "".join(
            f"<td>{value}</td>"
            for value in (
                region["number"],
                f"{region['area']:.3g}",
                f"{region['diameter']:.3g}",
                f"{region['arc']:.3g}",
                clock_words(region).removesuffix(" o'clock"),
                f"{100 * region['probability']:.0f} %" if "probability" in region else "",
                f"{region['frame']} ({region['seconds']:.2f} s)",
                _shown_in(region["number"], links.get(region["number"])),
            )
        )
        for region in record["missed_regions"]
    ]
    heads = "".join(f"<th>{title}</th>" for title in (*head, "hidden", "nearest frame", "keyframe to look at"))
    table = f"<table><tr>{heads}</tr>{''.join(f'<tr>{row}</tr>' for row in rows)}</table>" if rows else ""
    return (
        f"<h2>Coverage</h2><p>{html.escape(result.sentence)}.</p>"
        f'<img class="map" alt="unrolled wall" src="{data_uri(result.picture.read_bytes(), "png")}">'
        f'<div class="wide">{table}</div>'
        '<p class="fine">The wall of the visited stretch laid flat. Areas of missed regions are those of a smooth '
        "closing of the surface, which is not part of the mesh. 12 o'clock is the top of the picture where the stretch "
        f"begins, carried along without twisting. {_meanings(record)}"
        "Look before you believe one. The nearest frame is that of the camera nearest to the region, of those that "
        "pointed towards it; the keyframe to look at is one close to it that has the direction of the region in its "
        "picture. With JavaScript a ring marks that direction; a fold often hides the region there.</p>"
    )


def _meanings(record: dict[str, Any]) -> str:
    """What ± and the column of probabilities mean, in a run that has them."""
    error = (
        "± is the typical error (root mean square) on rendered films whose lens was given, not a limit: about a third "
        "are off by more, and through measured colonoscopes the percentage was mostly too low. "
    )
    hidden = (
        "Hidden: how likely it is that at least half of the region is in no frame, by how far it reaches from the "
        "measured surface; fitted on rendered films, on regions over 5 mm. "
    )
    text = error if "covered_error_points" in record else ""
    text += hidden if any("probability" in region for region in record["missed_regions"]) else ""
    tested = "docs/lab/coverage.md of the project says how that was tested; on real colons nobody has measured it. "
    return text + tested if text else ""


def _shown_in(region: int, link: Link | None) -> str:
    if link is None:
        return ""
    outside = "" if link.has_ring else ", not in the picture"
    return f'<a class="goto" data-region="{region}" href="{html.escape(link.address)}">frame {link.frame}</a>{outside}'
