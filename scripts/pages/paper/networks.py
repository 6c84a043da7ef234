"""The page's parts on networks side by side: Table I and Figure 4."""

from dataclasses import replace

from benchmarks.paper.claims import SCENE_NAMES
from benchmarks.paper.intervals import Interval
from benchmarks.paper.judgements import NAMES, PRINTED, named_rivals
from benchmarks.paper.judgements import row as row_of_table_1
from benchmarks.paper.judgements_figures import measured, median_of
from benchmarks.paper.plan import MOST_STEPS, ONE_SCENE, OURS, RIVALS, SCENES, UNTRAINED, Run
from benchmarks.paper.records import Records

FLOORS = {
    "linear": "(linear interpolation)",
    "nearest": "(nearest point)",
    "shipped": "(shipped model, for comparison)",
}


def spread(found: Interval | None, factor: float = 1.0, digits: int = 2) -> str:
    """Mean and 95 % interval in one cell."""
    if found is None:
        return "-"
    value, low, high = (f"{factor * x:.{digits}f}" for x in (found.value, found.low, found.high))
    return f"{value} [{low}, {high}]"


def rows_of_table_1() -> list[tuple[str, Run]]:
    """What is trained, by name, then what needs no training."""
    rows = {NAMES[model]: row_of_table_1(model) for model in OURS} | named_rivals()
    return [*rows.items(), *((name, Run(tuple(SCENES), label)) for label, name in FLOORS.items())]


def table_1(records: Records, figure: str, title: str, factor: float) -> list[str]:
    """All networks on the four scenes, one network for all of them; a size is named where it differs."""
    scenes = " | ".join(SCENE_NAMES.values())
    lines = [f"| {title} | {scenes} | parameters [M] | steps | seeds |", "|---" * (4 + len(SCENES)) + "|"]
    for name, run in rows_of_table_1():
        cells = [spread(records.mean(scene, run, figure), factor) for scene in SCENES]
        found = list(records.of(run).values())
        trained = run.model not in UNTRAINED
        size = f"{found[0]['parameters'] / 1e6:.2f}" if found and trained else ""
        steps = ", ".join(f"{record['steps_done']:,}" for record in found) if trained else ""
        steps = steps.replace(f"{MOST_STEPS:,}", f"{MOST_STEPS:,} (limit)")
        failed = f", {records.failed(run)} without an error" if records.failed(run) else ""
        lines.append(f"| {' | '.join([name, *cells, size, steps, f'{len(found)}{failed}' if trained else ''])} |")
    return lines


def median_frames(records: Records) -> list[str]:
    """abs.REL of the median frame, over all seeds."""
    lines = [f"| abs.REL of the median frame [%] | {' | '.join(SCENE_NAMES.values())} |", "|---" * 5 + "|"]
    for name, run in rows_of_table_1():
        medians = [records.median_frame(scene, run, "abs_rel") for scene in SCENES]
        lines.append(f"| {name} | {' | '.join('-' if m is None else f'{100 * m:.2f}' for m in medians)} |")
    return lines


def seen_in_figure_4() -> list[str]:
    """Sharpness of edges, roughness, and by how much a frame's scale is off, by scene."""
    scenes = " | ".join(SCENE_NAMES.values())
    lines = [f"| steepness at edges; roughness; scale off by | {scenes} |", "|---" * 5 + "|"]
    names = NAMES | FLOORS
    for model in measured():
        cells = []
        for scene in SCENES:
            sharp, rough, off = (median_of(model, scene, figure) for figure in ("sharpness", "roughness", "scale"))
            cells.append(f"{sharp:.2f}; {rough:.2f}; {100 * off:.1f} %")
        lines.append(f"| {names[model]} | {' | '.join(cells)} |")
    return lines


def lead_over_best_rival(records: Records) -> str:
    """abs.REL of the best rival of any size over that of the plain U-Net: least and most of the scenes."""
    ratios = []
    for scene in SCENES:
        found = [known.value for run in named_rivals().values() if (known := records.mean(scene, run, "abs_rel"))]
        ours = records.mean(scene, row_of_table_1(PRINTED), "abs_rel")
        ratios += [min(found) / ours.value] if found and ours else []
    return f"{min(ratios):.1f} to {max(ratios):.1f}"


def cost_of_batches(records: Records) -> str:
    """abs.REL in the colon with batches of all scenes and of one."""
    cells = []
    for model in OURS:
        runs = [row_of_table_1(model), replace(row_of_table_1(model), change=ONE_SCENE)]
        if all(records.of(run) for run in runs):
            both = [spread(records.mean("colon", run, "abs_rel"), 100) for run in runs]
            cells.append(f"{NAMES[model]} {both[0]} %, with batches of one scene {both[1]} %")
    return f"abs.REL in the colon: {'; '.join(cells)}"


def equal_steps(records: Records) -> list[str]:
    """abs.REL where every network has the same number of steps."""
    runs = [(model, Run(tuple(SCENES), model, steps=MOST_STEPS)) for model in ("mscsa-plain", *RIVALS)]
    if not any(records.of(run) for _, run in runs):
        return [f"No training with one number of steps, {MOST_STEPS:,}, for every network is recorded."]
    lines = [f"| abs.REL [%], {MOST_STEPS:,} steps | {' | '.join(SCENE_NAMES.values())} |", "|---" * 5 + "|"]
    for model, run in runs:
        cells = [spread(records.mean(scene, run, "abs_rel"), 100) for scene in SCENES]
        lines.append(f"| {NAMES[model]} | {' | '.join(cells)} |")
    return lines
