"""docs/lab/paper.md from benchmarks/results/paper/*.json: the paper's claims beside our records.

The words are in paper_page.txt; every figure that we measured comes from the records.

python -m scripts.pages.paper_page > docs/lab/paper.md
"""

from pathlib import Path
from string import Template

from benchmarks.paper.claims import SCENE_NAMES, claims, finding, verdict
from benchmarks.paper.intervals import Interval
from benchmarks.paper.plan import BODIES, CHANGES, NORMALISATIONS, READINGS, RESIDUAL, ROWS, STEPS, UNTRAINED
from benchmarks.paper.published import TABLE_2, reduction
from benchmarks.paper.records import Records

WORDS = Path(__file__).with_name("paper_page.txt")
FULL = "mscsa-early-fusion"  # on which choices of training were changed one at a time


def spread(found: Interval | None, factor: float = 1.0, digits: int = 2) -> str:
    """Mean and 95 % interval in one cell."""
    if found is None:
        return "-"
    value, low, high = (f"{factor * x:.{digits}f}" for x in (found.value, found.low, found.high))
    return f"{value} [{low}, {high}]"


def row(records: Records, scene: str, label: str, model: str, change: str = "") -> str:
    """One network's cells: RMSE, abs.REL (mean and median frame), MAE, delta 1, delta 2, seeds."""
    seeds = len(records.of(scene, model, change))
    median = records.median_frame(scene, model, "abs_rel", change)
    cells = [
        label,
        spread(records.mean(scene, model, "rmse", change)),
        spread(records.mean(scene, model, "abs_rel", change), 100),
        "-" if median is None else f"{100 * median:.2f}",
        spread(records.mean(scene, model, "mae", change)),
        spread(records.mean(scene, model, "delta_1", change), 1, 4),
        str(seeds) if model not in UNTRAINED else "",
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
    names = {"linear": "(linear interpolation)", "nearest": "(nearest point)", "shipped": "(model of `reconstruct`)"}
    lines += [row(records, scene, names[label], label) for label in UNTRAINED]
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
                found = records.reduction(scene, of[name], of[beside], figure)
                cells.append("-" if found is None else spread(found[0], 100, 1))
            lines.append(f"| {' | '.join(cells)} |")
    return lines


def normalisations(records: Records) -> list[str]:
    """The full network on the U-Net, changed in one thing."""
    columns = ["normalisation", "abs.REL [%]", "RMSE [mm]", "MSC's depth [%]", "in training mode [%]", "companions [%]"]
    lines = [f"| {' | '.join([*columns, 'seeds'])} |", "|---" * (len(columns) + 1) + "|"]
    for label, model in NORMALISATIONS.items():
        runs = records.of("colon", model)
        effects = [effect for run in runs.values() if (effect := run["scenes"]["colon"]["batch_statistics"])]
        means = [
            f"{100 * sum(effect[key] for effect in effects) / len(effects):.2f}" if effects else "-"
            for key in ("abs_rel", "companions")
        ]
        figures = [spread(records.mean("colon", model, "abs_rel"), 100), spread(records.mean("colon", model, "rmse"))]
        own = spread(records.mean("colon", model, "msc_abs_rel"), 100, 1)
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
        measured, findings = [], []
        for of in claim.compared[:1]:
            claimed = reduction(of.scene, of.row, of.beside, of.figure)
            for body in BODIES:
                found = finding(records, of, body)
                measured += [f"{body}: {spread(found[0], 100, 1)} %"] if found else []
                findings += [f"{body}: {verdict(found, claimed)}"] if found else []
        found_text = "; ".join(findings) or "not measured"
        lines.append(f"| {claim.text} | {claim.own} | {'; '.join(measured)} | {found_text} |")
    return lines


def provenance(records: Records) -> list[str]:
    """Commits, machine and time of the records."""
    trained = [record for record in records.records if record["model"] not in UNTRAINED]
    if not trained:
        return ["No training is recorded yet."]
    commits = sorted({record["environment"]["commit"][:7] for record in records.records})
    machines = sorted({record["environment"]["processor"] for record in records.records})
    timed = [seconds for record in trained if (seconds := record["processor_seconds_a_step"])]
    return [
        f"{len(trained)} trainings of {STEPS} steps of 10 frames are recorded,",
        f"{sum(timed) / len(timed):.2f} s of one core a step (`{', '.join(machines)}`), commits {', '.join(commits)}.",
    ]


def page(records: Records) -> str:
    """The whole page."""
    tables = [[*table_2(records, scene), "", *reductions(records, scene), ""] for scene in TABLE_2]
    parts = {
        "provenance": provenance(records),
        "sentences": sentences(records),
        "table_2": [line for lines in tables for line in lines][:-1],
        "normalisations": normalisations(records),
        "changes": changes(records),
    }
    words = Template(WORDS.read_text(encoding="utf-8"))
    return words.substitute({name: "\n".join(lines) for name, lines in parts.items()})


if __name__ == "__main__":
    print(page(Records.read()), end="")
