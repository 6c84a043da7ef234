"""docs/lab/unknown_lens.md from benchmarks/results/unknown_lens.json, and unknown_lens_eeaa424.json beside it.

python scripts/pages/lens_page.py > docs/lab/unknown_lens.md
"""

import json
import statistics
from pathlib import Path
from typing import Any

from pipeline.frontend.lens_guess import CLOSE

RECORDS = Path(__file__).parents[2] / "benchmarks/results"
SIX = "eeaa424"  # the last commit that refined six numbers of the mean colonoscope
STARTS = NARROW, MEAN, FILM = "100 degrees", "mean colonoscope", "by the first frames"
# Films by whose tables the rule was found; the lenses of scope_03 and scope_13 are two of the 18 in the mean.
CHOSEN_ON = ("scope_03", "scope_13", "events", "ctcolon", "flexure", "loop", "easy_withdrawal", "low_texture")
CHOSEN_ON = (*CHOSEN_ON, "polyp_pan.mp4", "gastrolab_normal.mp4")
BEYOND_USE = 0.2  # of the width, RMS

HEAD = """# What an unknown lens is guessed to be

- **Question:** From which guess does `--camera auto` find the lens: from the mean of EndoMapper's 18 colonoscopes (a
  fisheye of some 130 degrees across, with one radial term), or from 100 degrees with two radial terms?
- **Answer:** Either, by the film: both are tried on its first frames, and the one that fits them better is taken
  (`pipeline/frontend/lens_guess.py`; of two within 5 % the mean, by judgement; so close here: {close}). On {right}
  of {count} films the one that was taken posed no fewer frames in no more maps, with an ATE no more than a tenth above
  the other's; of the {reported} reported on, {right_reported}.
  With no tenth allowed it is {strict} of {count}. Where there is truth, its lens was nearer the true one on {nearer} of
  {known} films.
- **Command:** `haustra phantom SCOPES --suite --config benchmarks/scope_films.yaml`, then
  `python -m benchmarks.reconstruction unknown-lens --end 12 FILMS SCOPES/* --json {record}` at {commit} on one machine
  ({machine}); rendered by `python scripts/pages/lens_page.py > docs/lab/unknown_lens.md`.
- **Films:** those marked had been looked at when the rule was made; the others are reported on. One seed each. All but
  two are rendered. Nearly all that take the mean were filmed through lenses that have a part in it, one in 18 each:
  endoscope 3 (scope_03, a), 9 (b) and 13 (scope_13, c); no real film is held out. So the mean is shown to be a good
  start for scopes like those of EndoMapper, and for no others.

Frames posed (in so many maps), ATE RMSE of the largest after Sim(3), and off: RMS shift of what the true lens sees, as
a share of the width. "Beyond use": more than {beyond:.0f} %, as where radial terms run away at the rim. Scores: as the
rule has them. Real films have no truth.

| film | from 100 degrees | from the mean | scores | taken |
|---|---|---|---|---|"""

READ = """
The mean is of whole pictures; a crop shows a narrower part: from the mean the map of the CT colon, a pinhole of 90
degrees, does not even begin. Where the first frames tell nothing, a picture whose corners are masked, as those of
colonoscopes are, is tracked from the mean, and any other from 100 degrees. A live session, which has no first frames to
try on, goes by the corners alone.
"""


REFINED_HEAD = """
## What is refined

The mean's lens is refined from the film: one focal length and one radial term (COLMAP's `SIMPLE_RADIAL_FISHEYE`), which
follow the radius of each of the 18 colonoscopes to 3 pixels of 1440 (RMS; a test says so), and only by a map that is
wrong with a [probability](map_doubt.md) below 20 %. Else it stays the guess. *Six numbers*: two focal lengths and four
terms (`OPENCV_FISHEYE`), by any map that determines them, commit {six}. *Two, without doubt*: commit {two}, the same
command. Both differ in both, so the table says nothing of either alone. They start from the mean; off and ATE as above.
The lens's centre stays the picture's middle. Decided on d and e of `living_choosing.yaml`, `varied_scope_*`,
`varied_fisheye_flexures` and `wide_d`, which are not here, and on scope_03, which is.

| film | six numbers | two, without doubt |
|---|---|---|"""


def _cell(run: dict[str, Any]) -> str:
    if not run["submaps"]:
        return "none"
    parts = [f"{_posed(run)} of {run['usable']} in {run['submaps']}"]
    if "ate_mm" in run:
        parts.append(f"{run['ate_mm']:.3f} mm")
        parts.append("off beyond use" if run["lens_off"] > BEYOND_USE else f"off {100 * run['lens_off']:.1f} %")
    else:
        parts.append("determined" if run["determined"] else "not determined")
    return ", ".join(parts)


def _are_close(by: dict[str, dict[str, Any]]) -> bool:
    low, high = sorted(by[FILM]["scores"].values())
    return bool(0 < high <= CLOSE * low)


def _is_no_worse(run: dict[str, Any], other: dict[str, Any], slack: float) -> bool:
    """Frames posed, maps and ATE, where there is truth, up to `slack` times the other's."""
    if not other["submaps"]:
        return True
    near = run["submaps"] and run.get("ate_mm", 0.0) <= slack * other.get("ate_mm", 0.0)
    return bool(near and _posed(run) >= _posed(other) and run["submaps"] <= other["submaps"])


def _posed(run: dict[str, Any]) -> int:
    """Frames; maps that were not merged may share some, which the record counts twice."""
    return int(min(run["posed"], run["usable"]))


def guesses(record: dict[str, Any]) -> str:
    """The page up to the section on what is refined."""
    films: dict[str, dict[str, dict[str, Any]]] = {}
    for run in record["runs"]:
        films.setdefault(run["sequence"], {})[run["method"]] = run
    right, strict, nearer, known, rows = [], 0, 0, 0, []
    for name, by in sorted(films.items(), key=lambda item: item[0] in CHOSEN_ON):
        scores = by[FILM]["scores"]
        taken = NARROW if max(scores, key=lambda guess: scores[guess]).startswith("100") else MEAN
        other = MEAN if taken == NARROW else NARROW
        if _is_no_worse(by[taken], by[other], 1.1):
            right.append(name)
        strict += _is_no_worse(by[taken], by[other], 1.0)
        if "lens_off" in by[taken]:
            known += 1
            nearer += by[taken]["lens_off"] <= by[other].get("lens_off", float("inf"))
        told = ", ".join(f"{guess}: {score:.0f}" for guess, score in scores.items())
        film = name.removesuffix(".mp4") + (" (rule made on)" if name in CHOSEN_ON else "")
        rows.append(f"| {film} | {_cell(by[NARROW])} | {_cell(by[MEAN])} | {told} | {taken} |")
    about = record["environment"]
    head = HEAD.format(
        count=len(films),
        right=len(right),
        strict=strict,
        nearer=nearer,
        known=known,
        right_reported=len(set(right) - set(CHOSEN_ON)),
        reported=len(set(films) - set(CHOSEN_ON)),
        record="RECORD.json",
        commit=about["commit"][:7],
        machine=f"{about['processor']}, {about['cores']} cores",
        beyond=100 * BEYOND_USE,
        close=", ".join(name.removesuffix(".mp4") for name in films if _are_close(films[name])) or "none",
    )
    return "\n".join([head, *rows, READ])


def refined(six: dict[str, Any], two: dict[str, Any]) -> str:
    """The section on what is refined."""
    both = [{run["sequence"]: run for run in of["runs"] if run["method"] == MEAN} for of in (six, two)]
    shared = [name for name in both[1] if name in both[0]]
    rows = [f"| {name.removesuffix('.mp4')} | {_cell(both[0][name])} | {_cell(both[1][name])} |" for name in shared]
    known = [name for name in shared if name != "scope_03" and all("lens_off" in of[name] for of in both)]
    said = [_spread([of[name]["lens_off"] for name in known]) for of in both]
    commits = [of["environment"]["commit"][:7] for of in (six, two)]
    text = f"\nOff, {len(known)} films with truth but scope_03: {said[0]} by six numbers, {said[1]} by two.\n"
    return "\n".join([REFINED_HEAD.format(six=commits[0], two=commits[1]), *rows, text])


def _spread(off: list[float]) -> str:
    of_use = [one for one in off if one <= BEYOND_USE]
    mean = f"mean of those of use {100 * statistics.mean(of_use):.1f} %"
    return f"median {100 * statistics.median(off):.1f} %, {mean}, {len(off) - len(of_use)} of {len(off)} beyond use"


def page() -> str:
    """The page, as committed."""
    record, six = (json.loads((RECORDS / f"unknown_lens{of}.json").read_text()) for of in ("", f"_{SIX}"))
    return guesses(record) + refined(six, record)


if __name__ == "__main__":
    print(page(), end="")
