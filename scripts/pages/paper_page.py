"""docs/lab/paper.md from benchmarks/results/paper/*.json: the paper's claims beside our records.

The words are in paper_page.txt; every figure that we measured comes from the records.

python -m scripts.pages.paper_page > docs/lab/paper.md
"""

import json
from dataclasses import replace
from pathlib import Path
from string import Template

from benchmarks.paper.claims import SCENE_NAMES, claims, finding, verdict
from benchmarks.paper.intervals import Interval
from benchmarks.paper.judgements import NAMES, features_higher, percent, points
from benchmarks.paper.judgements import row as row_of_table_1
from benchmarks.paper.plan import (
    BODIES,
    CHANGES,
    MOST_STEPS,
    NORMALISATIONS,
    ONE_SCENE,
    OTHER_PARAMETERS,
    OURS,
    PAPER_LENGTH,
    PAPER_STEPS,
    POINT_COUNTS,
    READINGS,
    RESIDUAL,
    RIVALS,
    ROWS,
    SCENES,
    STEPS,
    UNTRAINED,
    Run,
)
from benchmarks.paper.published import TABLE_2, reduction
from benchmarks.paper.records import FIGURES, Records

WORDS = Path(__file__).with_name("paper_page.txt")
FLOORS = {"linear": "(linear interpolation)", "nearest": "(nearest point)", "shipped": "(model of `reconstruct`)"}
FULL = "mscsa-early-fusion"  # on which choices of training were changed one at a time


def spread(found: Interval | None, factor: float = 1.0, digits: int = 2) -> str:
    """Mean and 95 % interval in one cell."""
    if found is None:
        return "-"
    value, low, high = (f"{factor * x:.{digits}f}" for x in (found.value, found.low, found.high))
    return f"{value} [{low}, {high}]"


def row(records: Records, scene: str, label: str, model: str, change: str = "", steps: int = STEPS) -> str:
    """One network's cells: RMSE, abs.REL (mean and median frame), MAE, delta 1, seeds."""
    run = Run((scene,), model, change=change, steps=steps)
    median = records.median_frame(scene, run, "abs_rel")
    cells = [
        label,
        spread(records.mean(scene, run, "rmse")),
        spread(records.mean(scene, run, "abs_rel"), 100),
        "-" if median is None else f"{100 * median:.2f}",
        spread(records.mean(scene, run, "mae")),
        spread(records.mean(scene, run, "delta_1"), 1, 4),
        str(len(records.of(run))) if model not in UNTRAINED else "",
    ]
    return f"| {' | '.join(cells)} |"


COLUMNS = "| RMSE [mm] | abs.REL [%] | median frame [%] | MAE [mm] | delta 1 | seeds |\n|---|---|---|---|---|---|---|"


def table_2(records: Records, scene: str) -> list[str]:
    """Four rows of each body, the paper's own, residual rows and what needs no training."""
    lines = [f"### {SCENE_NAMES[scene].capitalize()}", "", f"| {scene.replace('_', ' ')} {COLUMNS}"]
    for body, models in BODIES.items():
        lines += [row(records, scene, f"{body}: {name}", model) for name, model in zip(ROWS, models, strict=True)]
    if scene == "colon":
        lines += [row(records, scene, f"U-Net, {name}: full, residual", model) for name, model in RESIDUAL.items()]
    lines += [row(records, scene, name, label) for label, name in FLOORS.items()]
    return lines


def reductions(records: Records, scene: str) -> list[str]:
    """Full below the baseline, and below MSC alone, by body."""
    bodies = " | ".join(BODIES)
    lines = [f"| {SCENE_NAMES[scene]}: reduction [%] | paper | {bodies} |", "|---" * (2 + len(BODIES)) + "|"]
    for name, beside in (("+SA", "baseline"), ("+MSC", "baseline"), ("full", "baseline"), ("full", "+MSC")):
        for figure, title in (("abs_rel", "abs.REL"), ("rmse", "RMSE"), ("mae", "MAE")):
            cells = [f"{title} of {name} below {beside}", f"{100 * reduction(scene, name, beside, figure):.1f}"]
            for models in BODIES.values():
                of = dict(zip(ROWS, models, strict=True))
                found = records.reduction(scene, Run((scene,), of[name]), Run((scene,), of[beside]), figure)
                cells.append("-" if found is None else spread(found[0], 100, 1))
            lines.append(f"| {' | '.join(cells)} |")
    return lines


def normalisations(records: Records) -> list[str]:
    """The full network on the U-Net, changed in one thing."""
    columns = ["normalisation", "abs.REL [%]", "RMSE [mm]", "MSC's depth [%]", "in training mode [%]", "companions [%]"]
    lines = [f"| {' | '.join([*columns, 'seeds'])} |", "|---" * (len(columns) + 1) + "|"]
    for label, model in NORMALISATIONS.items():
        run = Run(("colon",), model)
        runs = records.of(run)
        effects = [effect for run in runs.values() if (effect := run["scenes"]["colon"]["batch_statistics"])]
        means = [
            f"{100 * sum(effect[key] for effect in effects) / len(effects):.2f}" if effects else "-"
            for key in ("abs_rel", "companions")
        ]
        figures = [spread(records.mean("colon", run, "abs_rel"), 100), spread(records.mean("colon", run, "rmse"))]
        own = spread(records.mean("colon", run, "msc_abs_rel"), 100, 1)
        lines.append(f"| {' | '.join([label, *figures, own, *means, str(len(runs))])} |")
    return lines


def changes(records: Records) -> list[str]:
    """Choices of training, one at a time."""
    lines = [f"| early fusion, full, colon {COLUMNS}", row(records, "colon", "as above", FULL)]
    lines += [row(records, "colon", change, FULL, change) for change in CHANGES]
    return lines + [row(records, "colon", label, model) for label, model in READINGS.items()]


def sentences(records: Records) -> list[str]:
    """Each sentence beside what the paper's own tables say and what we find on each body."""
    lines = ["| the paper's sentence | its own tables | ours | finding |", "|---|---|---|---|"]
    for claim in claims():
        measured, findings = [], [claim.seen] if claim.seen else []
        if claim.judge and (judged := claim.judge(records)):
            measured, findings = [judged[0]], [judged[1]]
        for of in claim.compared[:1]:
            claimed = reduction(of.scene, of.row, of.beside, of.figure)
            for body in BODIES:
                found = finding(records, of, body)
                measured += [f"{body}: {spread(found[0], 100, 1)} %"] if found else []
                findings += [f"{body}: {verdict(found, claimed)}"] if found else []
        found_text = "; ".join(findings) or "not measured"
        lines.append(f"| {claim.text} | {claim.own} | {'; '.join(measured)} | {found_text} |")
    return lines


def table_1(records: Records, figure: str, title: str, factor: float) -> list[str]:
    """All networks on the four scenes, one network for all of them; a size is named where it differs."""
    scenes = " | ".join(SCENE_NAMES.values())
    lines = [f"| {title} | {scenes} | parameters [M] | steps | seeds |", "|---" * (4 + len(SCENES)) + "|"]
    rows = [(NAMES[model], row_of_table_1(model)) for model in (*OURS, *RIVALS)]
    rows += [(f"{NAMES[m]}, as many parameters", row_of_table_1(m, "same-parameters")) for m in OTHER_PARAMETERS]
    rows += [(f"{NAMES[m]}, {ONE_SCENE}", replace(row_of_table_1(m), change=ONE_SCENE)) for m in OURS]
    rows = [(name, run) for name, run in rows if records.of(run) or records.failed(run)]
    rows += [(name, Run(tuple(SCENES), label)) for label, name in FLOORS.items()]
    for name, run in rows:
        cells = [spread(records.mean(scene, run, figure), factor) for scene in SCENES]
        found = list(records.of(run).values())
        trained = run.model not in UNTRAINED
        size = f"{found[0]['parameters'] / 1e6:.2f}" if found and trained else ""
        steps = ", ".join(f"{record['steps_done']:,}" for record in found) if trained else ""
        failed = f", {records.failed(run)} zero everywhere" if records.failed(run) else ""
        lines.append(f"| {' | '.join([name, *cells, size, steps, f'{len(found)}{failed}' if trained else ''])} |")
    return lines


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


def figure_5(records: Records) -> list[str]:
    """Errors by the number of uniform and of feature points."""
    lines = ["| points | of 25,600 px | abs.REL, uniform [%] | abs.REL, features [%] | features instead of uniform |"]
    lines += ["|---|---|---|---|---|"]
    for count in POINT_COUNTS:
        uniform, features = (points(count, sampler) for sampler in ("uniform", "features"))
        cells = [spread(records.mean("colon", run, "abs_rel"), 100) for run in (uniform, features)]
        found = features_higher(records, count)
        higher = f"{percent(found)} higher" if found else "-"
        share = f"{count / 256:.2g} %"
        lines.append(f"| {count:,} | {share} | {' | '.join(cells)} | {higher} |")
    return lines


def sa_change() -> list[str]:
    """What SA adds to the features that it is given."""
    lines = [
        "| scene | network | added, of the features' norm | of it one map | largest weight |",
        "|---|---|---|---|---|",
    ]
    for scene, models in json.loads(FIGURES.read_text())["sa_change"].items():
        for model, of in models.items():
            cells = (
                f"{100 * of['added']:.0f} % | {100 * of['one_map']:.1f} % | {of['largest_weight']:.2f} of equal ones"
            )
            lines.append(f"| {SCENE_NAMES[scene]} | {NAMES[model]} | {cells} |")
    return lines


def keypoints() -> str:
    """SIFT keypoints of a judged frame: median and range."""
    of = json.loads(FIGURES.read_text())["keypoints"]
    return f"{of['median']:.0f} ({of['least']}-{of['most']})"


def length(records: Records) -> list[str]:
    """The paper's number of steps beside ours."""
    done = [model for model in PAPER_LENGTH if records.of(Run(("colon",), model, steps=PAPER_STEPS))]
    if not done:
        return [f"No training of {PAPER_STEPS:,} steps is recorded."]
    lines = [f"| colon {COLUMNS}"]
    for model in done:
        for steps in (STEPS, PAPER_STEPS):
            lines.append(row(records, "colon", f"`{model}`, {steps:,} steps", model, steps=steps))
    return lines


def provenance(records: Records) -> list[str]:
    """Commits, machines and number of the records."""
    trained = [record for record in records.records if record["model"] not in UNTRAINED]
    commits = sorted({record["environment"]["commit"][:7] for record in records.records})
    on = {record["environment"].get("gpu") or record["environment"]["processor"] for record in trained}
    counts = {
        name: sum(name in (r["environment"].get("gpu"), r["environment"]["processor"]) for r in trained) for name in on
    }
    machines = ", ".join(f"{counts[name]} on `{name}`" for name in sorted(on))
    return [f"{len(trained)} trainings are recorded: {machines}; commits {', '.join(commits)}."]


def page(records: Records) -> str:
    """The whole page."""
    tables = [[*table_2(records, scene), "", *reductions(records, scene), ""] for scene in TABLE_2]
    parts = {
        "provenance": provenance(records),
        "sentences": sentences(records),
        "table_2": [line for lines in tables for line in lines][:-1],
        "normalisations": normalisations(records),
        "changes": changes(records),
        "table_1": [*table_1(records, "abs_rel", "abs.REL [%]", 100), "", *table_1(records, "rmse", "RMSE [mm]", 1)],
        "equal_steps": equal_steps(records),
        "figure_5": figure_5(records),
        "length": length(records),
        "sa_change": sa_change(),
        "keypoints": [keypoints()],
        "steps": [f"{STEPS:,}"],
        "most_steps": [f"{MOST_STEPS:,}"],
    }
    words = Template(WORDS.read_text(encoding="utf-8"))
    return words.substitute({name: "\n".join(lines) for name, lines in parts.items()})


if __name__ == "__main__":
    print(page(Records.read()), end="")
