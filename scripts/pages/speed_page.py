"""docs/lab/speed.md from benchmarks/results/speed.json: whole runs beside the version before and beside COLMAP.

python -m scripts.pages.speed_page > docs/lab/speed.md
"""

import json
from pathlib import Path
from typing import Any

ROOT = Path(__file__).parents[2]
RECORD = ROOT / "benchmarks/results/speed.json"
DECIMATION = ROOT / "benchmarks/results/decimation.json"
OURS, PEER = "reconstruct", "colmap+linear+tsdf"

HEAD = """# Speed of whole runs

- **Question:** How long does a run take, what does it need, and what is lost by the ways in which it was made faster?
- **Command:** `python -m benchmarks.speed throughput FOLDERS --before CHECKOUT --runs {runs} --json speed.json`, on
  commit {commit}; `before` is commit {before}. {processor}, {cores} cores, Python {python}. Rendered from
  `benchmarks/results/speed.json` by `python -m scripts.pages.speed_page > docs/lab/speed.md`.
- **Protocol:** the methods take turns; wall time of the whole process, from the command to its end. Default settings,
  seed 0. F-score at 1 mm and ATE of the largest submap, after the Sim(3) of its camera path. Median of {runs} runs; for
  the ratio the median of the ratios of each turn, and in brackets the least and the greatest.
- **Films:** the CT colon and easy_withdrawal were looked at while the stages were made faster; that keyframes lie 0.045
  of the width apart was chosen on these, on flexure, events and the films of `benchmarks/exposure_choosing.yaml`.

| film | method | frames | frames/s | time over this version's | peak MiB | F at 1 mm, % | ATE, unit of the truth |
| --- | --- | --- | --- | --- | --- | --- | --- |
"""

READ = """
## What was done

- **Half the keyframes.** Keyframes were 0.02 of the width apart, and a surface needed two of them; now they are 0.045
  apart, and one is enough, if the keyframes 1, 2 and 5 before and after do not contradict it. A view is new when less
  than half of the points (before: 0.7) are shared with the last keyframe.
- **Side by side.** Two frames are completed at once, each by one thread, rather than one after the other by two.
  Features of loop closing and the preparation of keyframes for fusion are made in threads. Files are written and the
  report's pictures drawn while the coverage is measured; the features that the points are triangulated from are found
  while the maps are judged; descriptors of submaps' look-alikes are compared while the last ones are verified.
- **Two threads** follow the corners of a picture, half each, refine points, and count the votes of depth maps on the
  mesh. The bytes of a result stay.
- **Features found once.** SIFT features of the front end's keyframes are kept for the stage that triangulates points
  anew ([points.md](points.md)), which came after `before`. It needs those of some more frames, as the film moves on.
- **Bundle adjustment by vector instructions**: the blocks of the reduced camera system are summed by compiled code
  that adds a row at once, each sum in its order as before, so that the bytes of a result stay
  (`pipeline/optimization/kernels.py`).
- **Matching by keyframe.** A keyframe's features are projected into all keyframes that it is matched with in one call.
- **Self-calibration ends when it has converged.** COLMAP's bundle adjustment with the lens free makes a hundred
  iterations by default. One that lowers the cost by less than a millionth is now the last.
- **Smaller pictures.** Frames of 600 points and more are completed at 384 px in place of 448
  ([completion.md](completion.md)).
- **The support of the mesh by depth maps** is one compiled loop over its vertices.
- **Loaded while frames are read**: torch, the network, Open3D, trimesh, Matplotlib. An import holds Python's
  interpreter, so that reading slows meanwhile. While libraries load, Python looks for garbage cycles seldom, and as the
  program ends not at all.
- **Decimation by pyfqmr**, which keeps the borders of a mesh where it can: {decimation}.

## What was not

- The stages that triangulate points anew, adjust poses to them and correct each depth by its neighbours' pictures take
  time that `before` does not need; `reconstruct --profile` says how much. The F-score is higher for them.
{peer}- Completion does not begin while tracking goes on: depth is completed from points that the adjusted poses
  triangulate, and these are known last.
- Films of 1,000 and 1,500 frames are measured without a peer ([long_videos.md](long_videos.md)). The peer's accuracy is
  not measured here.
"""


def row_of(film: str, method: str, frames: int, figures: dict[str, Any]) -> str:
    """One line of the table."""
    rate, ratio = figures["frames_per_second"]["median"], figures["times_ours"]
    score, ate = (figures.get(name, {}).get("median") for name in ("f_score_percent", "ate"))
    cells = [film, method, str(frames), f"{rate:.2f}"]
    cells += [f"{ratio['median']:.2f} [{ratio['min']:.2f}, {ratio['max']:.2f}]", f"{figures['peak_mib']['median']:.0f}"]
    cells += ["" if score is None else f"{score:.1f}", "" if ate is None else f"{ate:.4f}"]
    return "| " + " | ".join(cells) + " |"


def page(record: dict[str, Any]) -> str:
    """The whole page."""
    environment, films = record["environment"], record["films"]
    frames = {row["film"]: row["frames"] for row in record["runs"]}
    runs = 1 + max(row["run"] for row in record["runs"])
    about = {name: environment[name] for name in ("processor", "cores", "python")}
    head = HEAD.format(runs=runs, commit=environment["commit"][:7], before=(record["before"] or "none")[:7], **about)
    rows = [row_of(film, method, frames[film], of) for film, by in films.items() for method, of in by.items()]
    read = READ.format(decimation=_decimation(json.loads(DECIMATION.read_text())), peer=_peer(films))
    return head + "\n".join([*rows, "", *_means(films)]) + "\n" + read


def _decimation(record: dict[str, Any]) -> str:
    """Both methods in words."""
    parts = [
        f"{name} {of['seconds']['median']:.2f} s, off by {1e6 * of['mean']:.0f} in the mean and by "
        f"{1e6 * of['greatest']:.0f} at most"
        for name, of in record["figures"].items()
    ]
    faces = next(iter(record["figures"].values()))["faces"]
    return (
        f"a mesh of {record['faces']} faces to {faces}, distances in millionths of a scene unit, median time of "
        f"{len(record['figures']['pyfqmr']['seconds']['values'])} (`benchmarks.speed decimation`): " + "; ".join(parts)
    )


def _peer(films: dict[str, Any]) -> str:
    """On which films COLMAP with interpolation and TSDF takes less time; a line, or nothing."""
    faster = [film for film, by in films.items() if PEER in by and by[PEER]["times_ours"]["median"] < 1]
    return f"- COLMAP with interpolation and TSDF takes less time on {', '.join(faster)}.\n" if faster else ""


def _means(films: dict[str, Any]) -> list[str]:
    """Over the films: how many times as long each other method took."""
    lines = []
    for method in next(iter(films.values())):
        if method == OURS:
            continue
        ratios = [by[method]["times_ours"]["median"] for by in films.values() if method in by]
        lines.append(
            f"- `{method}` took {min(ratios):.2f} to {max(ratios):.2f} times as long as this version (medians)."
        )
    return lines


if __name__ == "__main__":
    print(page(json.loads(RECORD.read_text())), end="")
