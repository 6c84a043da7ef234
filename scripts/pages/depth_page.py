"""docs/lab/depth_and_surface.md from `benchmarks/results/depth_*.json`: depth and mesh of films that burn.

python -m scripts.pages.depth_page > docs/lab/depth_and_surface.md
"""

import json
import statistics
from pathlib import Path
from typing import Any

RESULTS = Path(__file__).parents[2] / "benchmarks/results"
PROCESSORS = tuple(RESULTS / f"depth_h264_5749c81_{name}.json" for name in ("intel", "amd"))  # one commit on two
RECORDS = {
    name: RESULTS / f"depth_{name}.json"
    for name in ("films", "h264", "completion", "strata", "lids", "lids_chosen", "weights", "limits")
}

MESHES = ("as completed", "dark spots open")

HEAD = """# Depth and surface of films that burn

- **Question:** What is the mesh worth beside true depth on the same poses, where near folds burn and the far lumen is
  dark? Which depth should be fused, and does depth from several views help?
- **Command:** `python -m benchmarks.records depth_films depth_h264 depth_completion depth_strata depth_lids
  depth_lids_chosen depth_weights depth_limits`, which runs the command named with each table, at the
  commit and on the processor given there (two cores). Rendered from the records `depth_*.json` in `benchmarks/results`
  by `python -m scripts.pages.depth_page > docs/lab/depth_and_surface.md`. `depth_h264_5749c81_*.json` were made by the
  command of `depth_h264` at that commit.
- **Decision:** Depth is admitted by its expected error in voxels. Bright pictures are not dimmed. Several views are off
  unless asked for. Small dark spots stay open; light is no other witness on depth.
"""

CHOSEN = """
Other choices, on films of the same two files:

- **Greatest expected error: 3 voxels.** Below, far wall goes; above, wrong depth enters. The limit takes the place of
  the greatest depth of twice the median, which left out wall that true depth shows. F is judged at 1 mm, and a run
  without a scale knows no millimetre: in the narrow small intestine, whose voxels are smaller, a higher limit is
  better, and where texture is poor a lower one (second table). 3.5 voxels add a tenth to the mean, of less precise
  wall, and 3 were taken. The two tables are of two processors and do not compare.
- **Bright pictures stay as they are.** Dimmed to the exposure of the training frames, burnt wall looks grey.
"""

TRIED = """
## Tried, and not taken

- **Depth from several views** (`depth.multiview`): on seven films kept for choosing the median pixel of a keyframe gets
  better, the mean F does not. Likely cause: keyframes of one map share their sparse points, whose errors are then
  common to all views, and fusion averages over the views anyway. Points that are drawn for each frame by itself, as in
  a trial with true depth, do not have that. The predicted error of refined depth is too small for the same reason.
- **Unsure depth only where no surer view shows wall**, by rays cast into the mesh of the surer depth: F within 0.3
  points of one limit for all, on four of the films (script not kept).
- **Light as a witness on the depth of a picture.** With the lamp fitted (`reconstruction/fusion/photometry.py`), the
  brightness that a depth predicts was compared with the picture's. Burnt pixels that should be dark, and dark ones that
  should be bright, are indeed mostly wrong in depth. But few of them are fused: confidence and consistency have left
  them out. Lowering the confidence further left F as it was on three films and took 0.4 to 2 points on a fourth, whose
  vessels are dark. On the fused surface, whose colours are means over the views, mouths can be told from vessels
  (above).
- **The mean of a frame completed upright and mirrored**, or of all eight ways to turn and mirror it: F -0.4 to +0.9
  and -0.7 to +0.4 points on six films kept for choosing, for two and eight times the work (scripts not kept).
- **Weights from an empty folder.** The shipped ones stand on nine runs, of which the first six cannot be made again.
  Training from random weights on one H200 (1,550 steps of 32 frames on 6,000 frames, then 1,785 of 64 on 6,000 others)
  ended at 3.9 % on held-out guts where the last run of the shipped weights, on the same frames, ended at 2.9 %.
"""


def films(record: dict[str, Any]) -> list[str]:
    """F-score of each film beside true depth."""
    runs = record["runs"]
    lines = [
        "\n## Eight films that nothing was chosen on\n",
        "`python -m benchmarks.reconstruction beside-true-depth FILMS/*` on `benchmarks/exposure_films.yaml`, seed 0,",
        f"{_commits(record)}. F at 1 mm in percent; *true* is true depth on the same poses, *share* F of that;",
        "coverage's error in points.",
        "\n| film | F | precision | recall | true | share | ATE (mm) | coverage |",
        "|---|---|---|---|---|---|---|---|",
    ]
    names = ("f_score_percent", "precision_percent", "recall_percent", "true_depth_f_score_percent", "of_true_percent")
    for run in runs:
        if run["failed"]:
            lines.append(f"| {run['sequence']} | failed: {run['failed']} | | | | | | |")
            continue
        coverage = "-" if run["coverage_error_points"] is None else f"{run['coverage_error_points']:+.1f}"
        cells = " | ".join(_percent(run[name]) for name in names)
        lines.append(f"| {run['sequence']} | {cells} | {run['ate_mm']:.3f} | {coverage} |")
    good = [run for run in runs if not run["failed"]]
    lines.append("")
    for name, values in (
        ("F", [run["f_score_percent"] for run in runs]),
        ("of true depth's F", [run["of_true_percent"] for run in good]),
    ):
        lines.append(f"- {name}: {_spread(values)}, {len(values)} films")
    errors = [run["coverage_error_points"] for run in good if run["coverage_error_points"] is not None]
    if errors:
        rms = statistics.fmean(error**2 for error in errors) ** 0.5
        lines.append(f"- coverage: RMS error {rms:.1f} points, {len(errors)} films judged")
    return lines


def _commits(record: dict[str, Any]) -> str:
    """Of which commit a record is, of which if its rows differ; and the processor."""
    found = sorted({row["commit"] for row in record.get("runs", [])} or {record["environment"]["commit"]})
    return f"commit {', '.join(commit[:7] for commit in found)}, {record['environment']['processor']}"


def _spread(values: list[float]) -> str:
    middle, mean = statistics.median(values), statistics.fmean(values)
    return f"median {middle:.1f}, mean {mean:.1f}, least {min(values):.1f} %"


def _percent(value: float | None) -> str:
    return "-" if value is None else f"{value:.1f}"


def ct_colon(record: dict[str, Any], one_commit: list[dict[str, Any]]) -> list[str]:
    """The CT colon from H.264, and one commit on two processors."""
    lines = [
        "\n## CT colon from H.264\n",
        f"`python -m benchmarks.reconstruction accuracy CTCOLON --seeds {len(record['seeds'])} --front-end odometry`:",
        "F at 1 mm. A development figure.\n",
    ]
    for one in (record, *one_commit):
        values = [100 * value for value in one["figures"]["f_score"]["values"]]
        ate, turned = (one["figures"][name]["median"] for name in ("ate_mm", "rotation_deg"))
        path = f"median ATE {ate:.3f} mm, rotation {turned:.2f} degrees"
        lines.append(f"- {_commits(one)}: {_spread(values)}, {len(values)} seeds; {path}")
    return [
        *lines,
        "",
        "One commit differs from processor to processor. The network computes in the number format that each has fast",
        "(8-bit integers with AVX-512 VNNI, bfloat16, or float32), and the path differs too; which of the two it is",
        "was not measured. So tables of two processors do not compare.",
    ]


def completion(record: dict[str, Any]) -> list[str]:
    """abs.REL of each film and setting."""
    model = next(
        name.removesuffix("_abs_rel_percent")
        for name in record["rows"][0]
        if name.endswith("_abs_rel_percent") and not name.startswith("linear")
    )
    lines = [
        "\n## Completion\n",
        f"`python -m benchmarks.completion accuracy FILMS/* --stride 6 --draws {record['draws']}` on the same films,",
        f"{_commits(record)}, {record['precision']}: abs.REL in percent, mean over frames / median frame / share of",
        "frames over 10 %. The CT colon and SimCol3D are in [completion.md](completion.md).\n",
        f"| film | points | linear | `{model}` |",
        "|---|---|---|---|",
    ]
    for row in record["rows"]:
        lines.append(
            f"| {row['folder']} ({row['frames']} frames) | {row['points']} {row['sampler']} | {_both(row, model)} |"
        )
    summary = [""]
    for sampler, points in dict.fromkeys((row["sampler"], row["points"]) for row in record["rows"]):
        rows = [row for row in record["rows"] if (row["sampler"], row["points"]) == (sampler, points)]
        means = [statistics.fmean(row[f"{of}_abs_rel_percent"] for row in rows) for of in ("linear", model)]
        over = statistics.fmean(row[f"{model}_over_10"] for row in rows)
        middle = statistics.median(row[f"{model}_abs_rel_percent"] for row in rows)
        summary.append(
            f"- {points} {sampler}, {len(rows)} films: mean {means[1]:.2f} %, median film {middle:.2f} %, "
            f"{over:.1f} % of frames over 10 %; linear {means[0]:.2f} % in the mean"
        )
    return [*lines, *summary]


def _both(row: dict[str, Any], model: str) -> str:
    """Cells of linear interpolation and of the model."""
    return " | ".join(
        f"{row[f'{name}_abs_rel_percent']:.2f} / {row[f'{name}_median']:.2f} / {row[f'{name}_over_10']:.1f} %"
        for name in ("linear", model)
    )


def strata(record: dict[str, Any]) -> list[str]:
    """Share of pixels below the predicted error, by stratum."""
    points = list(dict.fromkeys(row["points"] for row in record["rows"]))
    of_all = {(row["rectified"], row["stratum"]): row["pixels"] for row in record["rows"]}
    near = {rectified: of_all[rectified, "near"] / of_all[rectified, "all"] for rectified in (False, True)}
    lines = [
        "\n## Predicted error by stratum\n",
        f"`python -m benchmarks.completion strata FILMS/* --stride {record['stride']}` on the same films,",
        f"{_commits(record)}. Share of pixels whose error is below the predicted one (63 % if calibrated) / mean",
        "abs.REL / share of pixels of confidence 0.1 and more / share of those that err by less than 5 %; all films",
        "together, every pixel the same. *As filmed*: four of the films have a fisheye. *Rectified*: as `reconstruct`",
        "completes them, by a pinhole camera, which cuts a fisheye's corners. In those corners depth along the optical",
        f"axis falls towards zero: {100 * near[False]:.2f} % of the pixels as filmed are near, and",
        f"{100 * near[True]:.2f} % of the rectified ones.\n",
        "| stratum | "
        + " | ".join(f"{kind}, {count} SfM-like points" for kind in ("as filmed", "rectified") for count in points)
        + " |",
        "|---" * (1 + 2 * len(points)) + "|",
    ]
    cells = {(row["stratum"], row["rectified"], row["points"]): _stratum(row) for row in record["rows"]}
    for name in dict.fromkeys(row["stratum"] for row in record["rows"]):
        of_name = [cells.get((name, rectified, count), "-") for rectified in (False, True) for count in points]
        lines.append(f"| {name} | " + " | ".join(of_name) + " |")
    return lines


def _stratum(cell: dict[str, Any]) -> str:
    shares = (cell["within_one"], cell["abs_rel"], cell["kept"], cell["kept_close"] or 0.0)
    within, error, kept, close = (100 * share for share in shares)
    return f"{within:.0f} / {error:.1f} / {kept:.0f} / {close:.0f} %"


def lids(record: dict[str, Any], chosen: dict[str, Any]) -> list[str]:
    """Mouths of diverticula that are closed, and what opening dark spots does to the F-score."""
    lines = [
        "\n## Lids over diverticula\n",
        "Completed depth closes dark mouths. Small spots of the mesh that are darker than the wall around, much darker",
        "in their middle and with a brighter rim, are left open (`reconstruction/fusion/dark_spots.py`). *Opened*:",
        "share of the mesh, and how much of it lay within 1 mm of the true wall: shallow lips of mouths, and wall",
        "opened wrongly. All mouths have one model of lip; dark residue or pigment with a bright rim was not tested.",
        "`python -m benchmarks.lids FILMS/*`, lens given, seed 0: mouths that are closed, and F at 1 mm in percent,",
        "of the mesh as completed and with dark spots open. A mouth whose lid bulges by over 1.5 mm counts as open.",
        f"Reported: the films of `benchmarks/diverticula.yaml`, {_commits(record)}. Chosen on: those of",
        "`benchmarks/diverticula_choosing.yaml`, `benchmarks/exposure_choosing.yaml` and four of",
        f"`benchmarks/coverage_films.yaml`, {_commits(chosen)}.\n",
        "| film | kind | closed, as completed | closed, dark spots open | F as completed | F, dark spots open "
        "| opened (%) | of it on the wall (%) |",
        "|---|---|---|---|---|---|---|---|",
    ]
    for kind, given in (("reported", record), ("chosen on", chosen)):
        for film, meshes in given["films"].items():
            closed = " | ".join(_closed(meshes[name]["mouths"]) for name in MESHES)
            scores = " | ".join(f"{meshes[name]['f_percent']:.1f}" for name in MESHES)
            gone = meshes["opened"]
            wrong = f"{gone['on_wall_percent']:.0f}" if gone["percent"] else "-"
            lines.append(f"| {film} | {kind} | {closed} | {scores} | {gone['percent']:.2f} | {wrong} |")
    return lines + [""] + [_lids_in_all(kind, given) for kind, given in (("reported", record), ("chosen on", chosen))]


def _closed(mouths: list[dict[str, Any]]) -> str:
    judged = [mouth for mouth in mouths if mouth["judged"]]
    return f"{sum(mouth['closed_share'] >= 0.5 for mouth in judged)} of {len(judged)}" if judged else "-"


def _lids_in_all(kind: str, given: dict[str, Any]) -> str:
    """Both meshes over all films of a kind."""
    films = given["films"].values()
    before, after = MESHES
    gains = [meshes[after]["f_percent"] - meshes[before]["f_percent"] for meshes in films]
    return (
        f"- {kind}: {given[before]['closed']} of {given[before]['judged']} judged mouths closed as completed, "
        f"{given[after]['closed']} of {given[after]['judged']} with dark spots open; F changes by "
        f"{statistics.mean(gains):+.2f} points in the mean, {min(gains):+.2f} to {max(gains):+.2f}, {len(gains)} films"
    )


def weights(record: dict[str, Any]) -> list[str]:
    """F by weights and limit on the films that these are chosen on."""
    return [
        "\n## What was chosen, and on what\n",
        "`python -m benchmarks.completion mesh-weights FILMS... --model eighth.safetensors --model mscsa --limit 2.5",
        f"--limit 3.5`, {_commits(record)}: F at 1 mm in percent on films of `benchmarks/coverage_films.yaml` and",
        "`benchmarks/exposure_choosing.yaml`, on which weights and settings are chosen; *voxels* is the greatest",
        "expected error that is fused. *eighth* are the weights that `mscsa` was trained on from",
        "([card](../../completion/weights/MODEL_CARD.md)).\n",
        *_by_method(record),
    ]


def limits(record: dict[str, Any]) -> list[str]:
    """F by limit with the shipped weights, on the same films."""
    return [
        f"\nThe shipped weights by other limits, {_commits(record)}, the same command with `--model mscsa",
        "--limit 2.5 --limit 3 --limit 3.5`:\n",
        *_by_method(record),
    ]


def _by_method(record: dict[str, Any]) -> list[str]:
    """Table of F, a row a film and a column a method."""
    runs = record["runs"]
    methods = list(dict.fromkeys(run["method"] for run in runs))
    found = {(run["sequence"], run["method"]): run["f_score"] for run in runs}
    names = list(dict.fromkeys(run["sequence"] for run in runs))
    lines = [f"| film | {' | '.join(methods)} |", "|---" * (1 + len(methods)) + "|"]
    lines += [f"| {name} | {' | '.join(_percent(found[name, method]) for method in methods)} |" for name in names]
    for label, of in (("mean", statistics.fmean), ("median", statistics.median)):
        cells = " | ".join(_percent(of(found[name, method] for name in names)) for method in methods)
        lines.append(f"| {label} of {len(names)} | {cells} |")
    return lines


def page() -> str:
    """The whole page."""
    records = {name: json.loads(path.read_text()) for name, path in RECORDS.items()}
    one_commit = [json.loads(path.read_text()) for path in PROCESSORS]
    parts = [films(records["films"]), ct_colon(records["h264"], one_commit), completion(records["completion"])]
    parts += [strata(records["strata"]), lids(records["lids"], records["lids_chosen"])]
    parts += [weights(records["weights"]), limits(records["limits"])]
    return "\n".join([HEAD, *(line for part in parts for line in part)]) + "\n" + CHOSEN + TRIED


if __name__ == "__main__":
    print(page(), end="")
