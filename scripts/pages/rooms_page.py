"""docs/lab/rooms.md from benchmarks/results/rooms.json: results before and after the redesign of November 2026.

    python scripts/pages/rooms_page.py [--before RUNS.json] [--after RUNS.json]

RUNS.json: what `mapper-seeds --json` of the commit before or after wrote; its runs are entered into the record first.
"""

import argparse
import json
import statistics
import textwrap
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

ROOT = Path(__file__).parents[2]
WIDTH = 120
RECORD, PAGE = ROOT / "benchmarks/results/rooms.json", ROOT / "docs/lab/rooms.md"

HEAD = """# Before and after the redesign

**Question.** Did the new folders, and the one kind of feature, retrieval and verified match that submap merging and
loop closing share now, change any result?

{answer}

**Measured** on one machine ({machine[processor]}, {machine[cores]} cores), before: commit {before}, after: {after};
loop closing, and the runs that say so: {loops}, since a review found between the two that
loops which end in the very view where they began were left out. Rendered from `benchmarks/results/rooms.json` by
`python scripts/pages/rooms_page.py`. All films had been in sight of earlier choices: these are figures of a comparison,
not of accuracy.
"""


def answer(record: dict[str, Any]) -> str:
    """The largest changes, in words."""
    changes = [change for row in record["seeds"] for change in changes_of(row)]
    ate = max(map(abs, changes))
    worse = [row for row in record["seeds"] if median_change(row) > spread_before(row)]
    score = max(abs(row["after"]["f_score_percent"] - row["before"]["f_score_percent"]) for row in record["suite"])
    ratios = [row["after"]["ate_mm"] / row["before"]["ate_mm"] - 1 for row in record["joins"]]
    moved = ", ".join(f"{100 * ratio:+.0f} %" for ratio in ratios if abs(ratio) > 0.01) or "none"
    worse_joins = sum(_is_worse(row["before"].values(), row["after"].values()) for row in record["joins_seeds"])
    merged = sum(row["after"]["left"] != row["before"]["left"] for row in record["joins"])
    loops = [(row["film"], row["before"], row["after"]) for row in record["loops"]]
    film, was, now = max(loops, key=lambda one: abs(one[2]["f_score_percent"] - one[1]["f_score_percent"]))
    others = max(abs(b["f_score_percent"] - a["f_score_percent"]) for name, a, b in loops if name != film)
    text = (
        f"Hardly, but for loop closing. "
        f"In {len(changes)} runs of the front end with one seed the ATE changes by at most {ate:.2g} mm; of "
        f"{len(record['seeds'])} medians {len(worse)} got worse by more than the spread of the seeds before. "
        f"In {len(record['suite'])} whole runs the F-score changes by at most {score:.2f} points. Of "
        f"{len(record['joins'])} cut films {merged} are merged otherwise; their ATE changes by more than 1 % in these: "
        f"{moved} (one seed; over five seeds the medians of {worse_joins} of these got worse by more than the spread). "
        f"Closing loops changed most on {film}, whose ATE "
        f"went from {was['ate_mm']:.3f} to {now['ate_mm']:.3f} mm and its F-score from {was['f_score_percent']:.1f} to "
        f"{now['f_score_percent']:.1f} %; on the other {len(loops) - 1} long films the F-score changed by at most "
        f'{others:.2f} points. Its "after" has one correction more than the redesign (below).'
    )
    return textwrap.fill("**Answer.** " + text, WIDTH, break_on_hyphens=False)


def guard(rows: list[dict[str, Any]]) -> list[str]:
    """Byte identity of the two runs that were compared after every step."""
    lines = [
        "\n## Bytes\n",
        "`mesh.ply` and `trajectory.tum`, compared after every step of the redesign; at its end:\n",
    ]
    for row in rows:
        told = "the same" if row["mesh"] and row["trajectory"] else "not the same"
        lines.append(f"- {row['run']}: {told} (commit {row['of']}).")
    return lines


def section(title: str, text: str, columns: Sequence[str], rows: Iterable[Sequence[object]]) -> list[str]:
    """A heading, what stands over the table, and the table."""
    lines = [columns, ["---"] * len(columns), *rows]
    head, rule, *body = ["| " + " | ".join(map(str, line)) + " |" for line in lines]
    return [f"\n## {title}\n", f"{text}\n", head, rule.replace(" ", ""), *body]


def suite(rows: list[dict[str, Any]]) -> list[str]:
    """ATE and F-score of whole runs."""

    def cells(row: dict[str, Any]) -> list[str]:
        before, after = row["before"], row["after"]
        return [
            row["film"],
            f"{before['posed']}, {after['posed']} of {before['total']}",
            _both(row, "ate_mm", 4),
            _both(row, "f_score_percent", 2),
            "the same" if all(row["same_bytes"].values()) else "differ",
            row["of"],
        ]

    return section(
        "Whole runs",
        "`reconstruct FILM --front-end odometry --seed 0`, then `haustra compare`; one seed. F-score at 1 mm.",
        ("film", "frames posed", "ATE before, after (mm)", "F-score before, after (%)", "bytes", "commit after"),
        map(cells, rows),
    )


def _both(row: dict[str, Any], key: str, digits: int) -> str:
    """A figure before, and after."""
    return ", ".join(f"{row[when][key]:.{digits}f}" for when in ("before", "after"))


def changes_of(row: dict[str, Any]) -> list[float]:
    """ATE after less ATE before, mm, of the seeds that ran at both commits."""
    before, after = row["before"], row["after"]
    return [after[seed] - before[seed] for seed in before if seed in after]


def summary_before(row: dict[str, Any]) -> dict[str, Any]:
    """Number of seeds, median and extremes before; of most of its runs an earlier record keeps only these."""
    found = row.get("before_summary", {"seeds": 0})
    return found if found["seeds"] > len(row["before"]) else summary(row["before"])


def summary(ate: dict[str, float]) -> dict[str, Any]:
    """Number of seeds, median and extremes of an ATE for each seed."""
    values = list(ate.values())
    return {"seeds": len(values), "median": statistics.median(values), "min": min(values), "max": max(values)}


def median_change(row: dict[str, Any]) -> float:
    """Of the seeds that ran at both commits, mm; positive is worse."""
    both = row["before"].keys() & row["after"].keys()
    before, after = (statistics.median(row[when][seed] for seed in both) for when in ("before", "after"))
    return float(after - before)


def spread_before(row: dict[str, Any]) -> float:
    """From the best seed to the worst, mm."""
    found = summary_before(row)
    return float(found["max"] - found["min"])


def seeds(rows: list[dict[str, Any]]) -> list[str]:
    """Front end alone, seed by seed."""

    def cells(row: dict[str, Any]) -> list[str]:
        before, after, same = summary_before(row), summary(row["after"]), changes_of(row)
        shown = [f"{of['median']:.4f} ({of['min']:.4f}-{of['max']:.4f})" for of in (before, after)]
        most = f"{_mm(max(map(abs, same), default=0.0))} ({len(same)} seeds)"
        number = f"{before['seeds']}, {after['seeds']}"
        return [row["film"], row["method"], number, *shown, _mm(median_change(row)), most]

    return section(
        "The front end alone, seed by seed",
        textwrap.fill(
            "`python -m benchmarks.reconstruction mapper-seeds FILMS --methods odometry odometry-fast --seeds 10`. "
            "COLMAP's mappers, which the redesign did not touch, were not run again. The last two columns are of seeds "
            "that ran at both commits.",
            WIDTH,
        ),
        (
            *("film", "method", "seeds before, after", "ATE before: median (least-most), mm", "after"),
            *("change of the median (mm)", "largest change of a seed (mm)"),
        ),
        map(cells, rows),
    )


def _mm(change: float) -> str:
    return "none" if change == 0 else f"{change:.2g}"


def enter(rows: list[dict[str, Any]], when: str, runs: list[dict[str, Any]]) -> None:
    """Runs of `mapper-seeds` into the record; when: before or after."""
    for row in rows:
        mine = {
            str(run["seed"]): run["ate_mm"]
            for run in runs
            if (run["sequence"], run["method"]) == (row["film"], row["method"]) and "ate_mm" in run
        }
        for seed in mine.keys() & row[when].keys():
            if mine[seed] != row[when][seed]:
                raise SystemExit(f"{row['film']}, {row['method']}, seed {seed}: not the run that is recorded {when}")
        row[when] = dict(sorted((row[when] | mine).items(), key=lambda item: int(item[0])))


def joins(rows: list[dict[str, Any]], strangers: dict[str, Any], seeds: list[dict[str, Any]]) -> list[str]:
    """Merging of cut films."""
    return [
        *section(
            "Merging of cut films",
            "`python -m benchmarks.loops joins`: frames are cut out of the middle; are the two maps merged?",
            ("film", "frames cut out", "maps left before, after", "ATE of the largest before, after (mm)"),
            ((row["film"], row["gap"], _both(row, "left", 0), _both(row, "ate_mm", 4)) for row in rows),
        ),
        f"\nOf {strangers['pairs']} pairs of parts of different films, merged: {strangers['false_before']} before, "
        f"{strangers['false_after']} after.",
        "\nThose whose ATE changed by more than 1 %, with seeds 0 to 4: ATE, mm, median (least-most).\n",
        "| film | frames cut out | before | after |\n|---|---|---|---|",
        *(
            f"| {of['film']} | {of['gap']} | {_seeds_shown(of['before'])} | {_seeds_shown(of['after'])} |"
            for of in seeds
        ),
    ]


def _is_worse(before: Iterable[float], after: Iterable[float]) -> bool:
    was = sorted(before)
    return statistics.median(after) - statistics.median(was) > was[-1] - was[0]


def _seeds_shown(of: dict[str, float]) -> str:
    return f"{statistics.median(of.values()):.4f} ({min(of.values()):.4f}-{max(of.values()):.4f})"


def loops(rows: list[dict[str, Any]]) -> list[str]:
    """Loop closing on films that go out and back."""

    def cells(row: dict[str, Any]) -> list[str]:
        counts = [
            ", ".join(f"{row[when][key]} ({row[when][false]})" for when in ("before", "after"))
            for key, false in (("links", "false_links"), ("kept", "false_kept"))
        ]
        figures = (("ate_mm", 3), ("end_to_start_mm", 3), ("f_score_percent", 2))
        return [row["film"], *counts, *(_both(row, key, digits) for key, digits in figures)]

    return section(
        "Loop closing",
        "`python -m benchmarks.loops pose-graph --surface` on films of `benchmarks/loops.yaml`, 600 frames each, one "
        "seed. False: by\nthe true poses.",
        (
            *("film", "verified loops (false) before, after", "accepted (false) before, after"),
            *("ATE with loops (mm)", "end to start (mm)", "F-score (%)"),
        ),
        map(cells, rows),
    )


def walks(rows: list[dict[str, Any]]) -> list[str]:
    """Files that one has to open for one change, or along one way."""

    def cells(row: dict[str, Any]) -> list[object]:
        note = f" ({row['note']})" if "note" in row else ""
        return [row["walk"], f"{row['before']}{note}", row["now"], f"`{row['shown_by']}`"]

    columns = ("walk", "before", "now", "shown by")
    return section(
        "Walks", "Files of one way through the code, or that one addition touches.", columns, map(cells, rows)
    )


def reading(told: dict[str, Any]) -> list[str]:
    """Questions to a reader who has only the tree at hand."""
    right = sum(guess == answer for _, guess, answer in told["rows"])
    text = (
        f"{right} of {len(told['rows'])} files were found at the first guess, by the names in the tree. The reader was "
        f"{told['reader']}. {told['after'][0].upper()}{told['after'][1:]}."
    )
    cells = []
    for question, guess, answer in told["rows"]:
        if not (ROOT / answer).is_file():
            raise SystemExit(f"{answer} is gone: {question}")
        cells.append((question, f"`{guess}`", "there" if guess == answer else f"`{answer}`"))
    return section("Where is it?", textwrap.fill(text, WIDTH), ("question", "first guess", "where it is"), cells)


def page(record: dict[str, Any]) -> str:
    """The page, as committed."""
    commits = record["commits"]
    head = HEAD.format(
        answer=answer(record),
        machine=record["machine"],
        before=commits["before"],
        after=commits["after"],
        loops=commits["after (loops)"],
    )
    lines = (
        guard(record["bytes"])
        + suite(record["suite"])
        + seeds(record["seeds"])
        + joins(record["joins"], record["strangers"], record["joins_seeds"])
        + loops(record["loops"])
        + walks(record["walks"])
        + reading(record["reading"])
    )
    return head + "\n".join(lines) + "\n"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    for when in ("before", "after"):
        parser.add_argument(f"--{when}", type=Path, help=f"runs of mapper-seeds {when} the redesign")
    arguments = parser.parse_args()
    record = json.loads(RECORD.read_text())
    for when, path in vars(arguments).items():
        if path is not None:
            enter(record["seeds"], when, json.loads(path.read_text())["runs"])
            RECORD.write_text(json.dumps(record, indent=1) + "\n")
    PAGE.write_text(page(record))


if __name__ == "__main__":
    main()
