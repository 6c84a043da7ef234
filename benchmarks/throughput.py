"""Speed and peak memory of the whole `reconstruct` beside COLMAP + interpolation + TSDF, run in turn.

    python -m benchmarks.throughput ../shared/data/ctcolon --runs 3 --json throughput.json

Both start from the same RGB-D folder and read its images only. Wall time is of the whole process, start-up and report
included; memory is the largest resident sum of the process and its children, sampled twenty times a second.
"""

import argparse
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import psutil

from benchmarks.record import spread, write

PEER = Path(__file__).with_name("peer_colmap.py")


def measure(command: list[str]) -> tuple[float, float]:
    """Wall seconds and peak MiB of a command; raises if it fails."""
    start, peak = time.monotonic(), 0
    process = psutil.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    while process.poll() is None:
        try:
            family = [process, *process.children(recursive=True)]
            peak = max(peak, sum(member.memory_info().rss for member in family))
        except psutil.NoSuchProcess:
            pass
        time.sleep(0.05)
    if process.returncode:
        raise SystemExit(f"failed with exit code {process.returncode}: {' '.join(command)}")
    return time.monotonic() - start, peak / 2**20


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("folder", type=Path)
    parser.add_argument("--runs", type=int, default=3)
    parser.add_argument("--json", type=Path)
    arguments = parser.parse_args()
    frames = len(list((arguments.folder / "rgb").glob("*.png")))
    results: dict[str, list[tuple[float, float]]] = {"reconstruct": [], "colmap+linear+tsdf": []}
    for run in range(arguments.runs):
        with tempfile.TemporaryDirectory() as scratch:
            commands = {
                "reconstruct": [sys.executable, "-m", "pipeline", str(arguments.folder), "-o", f"{scratch}/run", "-q"],
                "colmap+linear+tsdf": [sys.executable, str(PEER), str(arguments.folder), f"{scratch}/peer"],
            }
            for name, command in commands.items():
                results[name].append(measure(command))
                seconds, memory = results[name][-1]
                print(f"run {run} {name:20} {frames / seconds:.2f} frames/s, {memory:.0f} MiB", flush=True)
    summary = {
        name: {
            "frames_per_second": spread([frames / seconds for seconds, _ in runs]),
            "peak_mib": spread([memory for _, memory in runs]),
        }
        for name, runs in results.items()
    }
    pairs = zip(*results.values(), strict=True)
    summary["speed_ratio"] = spread([theirs[0] / ours[0] for ours, theirs in pairs])
    for name in results:
        rate, memory = summary[name]["frames_per_second"], summary[name]["peak_mib"]
        print(
            f"{name:20} {rate['median']:.2f} frames/s [{rate['min']:.2f}, {rate['max']:.2f}], "
            f"peak {memory['median']:.0f} MiB ({len(results[name])} runs of {frames} frames)"
        )
    print(f"speed ratio {summary['speed_ratio']['median']:.2f}")
    write(arguments.json, {"folder": arguments.folder.name, "frames": frames, "figures": summary})


if __name__ == "__main__":
    main()
