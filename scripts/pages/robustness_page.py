"""docs/lab/robustness.md from benchmarks/results/robustness.json.

python scripts/pages/robustness_page.py > docs/lab/robustness.md
"""

import json
from collections import Counter
from pathlib import Path
from typing import Any

RECORD = Path(__file__).parents[2] / "benchmarks/results/robustness.json"
HEAD = """# Damaged and strange films

- **Question:** What becomes of films that are damaged, or stored in a strange but right way?
- **Command:** `python -m benchmarks.robustness --inputs {count} --json robustness.json` on commit {commit}; {machine},
  {cores} cores. Rendered by `python scripts/pages/robustness_page.py > docs/lab/robustness.md`.
- **Inputs:** 60 frames of the demo clip at 240 px, drawn by number. Those of even number are damaged in one or two
  ways; those of odd number are whole, and a player shows them rightly. Each goes through the whole of `reconstruct`.
- **Faults:** {faults} of {count}: any exception but a sentence, a process that died, or more time than the limit.
- **Wrong without a word:** {wrong} of the {whole} whole ones: another clock, or the other hand.
- **Whole ones reconstructed:** {rightly} of {whole}.

A result of a damaged film is not thereby a good one: of the results {dark} have a submap that contradicts its lamp,
which the run says.

| input | drawn | reconstructed | refused with a sentence | fault or wrong |
|---|---|---|---|---|"""


def page(record: dict[str, Any]) -> str:
    """The page, as committed."""
    outcomes = record["outcomes"]
    whole = [one for one in outcomes if one.get("whole")]
    ends = Counter(one["end"] for one in outcomes)
    about = record["environment"]
    head = HEAD.format(
        count=len(outcomes),
        commit=" and ".join(sorted({one["commit"][:7] for one in outcomes})),
        machine=about["processor"],
        cores=about["cores"],
        faults=ends["fault"],
        wrong=ends["wrong"],
        whole=len(whole),
        rightly=sum(one["end"] == "reconstructed" for one in whole),
        dark=sum(bool(one.get("dark")) for one in outcomes),
    )
    rows = []
    for name in sorted({what for one in outcomes for what in one.get("done", [])}):
        mine = Counter(one["end"] for one in outcomes if name in one.get("done", []))
        bad = mine["fault"] + mine["wrong"]
        rows.append(f"| {name} | {mine.total()} | {mine['reconstructed']} | {mine['sentence']} | {bad} |")
    return "\n".join([head, *rows]) + "\n\nAn input that is damaged in two ways counts in two rows.\n"


if __name__ == "__main__":
    print(page(json.loads(RECORD.read_text())), end="")
