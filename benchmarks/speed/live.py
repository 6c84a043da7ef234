"""Whether `haustra live` keeps up with films played at their own rate, and how soon and steadily.

    python -m benchmarks.speed live ../shared/data/ctcolon SUITE/easy_withdrawal --runs 3 --json live.json
    python -m benchmarks.speed live ../shared/data/ctcolon --seconds 600 --json live_looped.json

Each run is the command itself, without the run at the end, in a process of its own; its page is asked once a second,
as a browser would, but nothing is drawn: a browser that draws without a graphics card takes a processor for itself.
Frames kept up with are those that were judged and, where they are worth it, tracked, over the time from the first of
them to the last; those that only served to find the picture's place, at the beginning, are counted apart. A
keyframe's surface is there so long after its frame came; of keyframes that were skipped there is none. Memory is the
resident sum of the command and its processes, once a second; its growth is the slope of a line through the second
half. Films are played again until `--seconds` are over; 0 plays them once. Start-up, before the first frame, is not
in the rates.
"""

import argparse
import json
import socket
import subprocess
import sys
import tempfile
import time
import urllib.request
from pathlib import Path
from typing import Any

import numpy as np
import psutil

from benchmarks.common.record import environment, spread
from benchmarks.common.runner import add_folders
from pipeline.input.video import Source
from pipeline.report.server import LOOPBACK

POLL_S = 1.0
COMMAND = "from pipeline.cli.main import main; main()"
FLAGS = ("--headless", "--no-sandbox", "--disable-gpu", "--use-angle=swiftshader", "--enable-unsafe-swiftshader")
LEAST_S = 60.0  # of play; in less, memory is still that of the start
GROWTH_FROM = 0.5  # of the time: before, libraries are still being loaded


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add_folders(parser, "films: RGB-D folders or videos")
    parser.add_argument("--runs", type=int, default=1)
    parser.add_argument("--browser", help="command of a Chromium that draws the page meanwhile")
    parser.add_argument("--seconds", type=float, default=0.0, help="play each film again until then")


def measure(arguments: argparse.Namespace) -> dict[str, Any]:
    rows = []
    for folder in arguments.folders:
        for number in range(arguments.runs):
            row = {"film": folder.name, "run": number} | _session(folder, arguments.seconds, arguments.browser)
            print(_sentence(row), flush=True)
            rows.append(row)
    names = ("kept_up_per_s", "median_s", "worst_s", "peak_mib")
    films = {
        name: {figure: spread([row[figure] for row in rows if row["film"] == name]) for figure in names}
        for name in dict.fromkeys(row["film"] for row in rows)
    }
    browser = "none" if arguments.browser is None else Path(arguments.browser).name
    about = {"environment": environment(), "seconds": arguments.seconds, "browser": browser}
    return about | {"runs": rows, "films": films}


def _session(film: Path, seconds: float, browser: str | None) -> dict[str, Any]:
    """One session's figures."""
    length = _length(film)
    loops = max(1, round(seconds / length))
    with tempfile.TemporaryDirectory() as scratch:
        out = Path(scratch) / "run"
        words = ["live", str(film.resolve()), "-o", str(out), "--no-browser", "--no-finish", "--loops", str(loops)]
        log, port = Path(scratch) / "log", _free_port()
        address = f"http://{LOOPBACK}:{port}/"
        with log.open("w") as file:
            command = [sys.executable, "-P", "-c", COMMAND, *words, "--port", str(port)]
            process = psutil.Popen(command, stdout=file, stderr=subprocess.STDOUT)
        memory, began, looking = [], None, None
        while process.poll() is None:
            came = _frames_that_came(address)
            if came is not None and browser is not None and looking is None:
                looking = subprocess.Popen([browser, *FLAGS, address], stderr=subprocess.DEVNULL)
            began = began or (time.monotonic() if came else None)
            if began is not None:
                memory.append((time.monotonic() - began, _resident_mib(process)))
            time.sleep(POLL_S)
        if looking is not None:
            looking.terminate()
            looking.wait()
        if process.returncode:
            raise SystemExit(f"the session of {film} failed: {log.read_text()}")
        figures = json.loads((out / "live.json").read_text())
    counts, after = figures["counts"], figures["surface_after_s"] or {"median": None, "worst": None}
    when, mib = np.array(memory).T
    late = (when > GROWTH_FROM * length * loops) & (when < length * loops)  # then the processes end
    growth = float(np.polyfit(when[late], mib[late], 1)[0]) * 60 if length * loops >= LEAST_S else None
    return {
        "played_s": length * loops,
        "kept_up_per_s": (counts["tracked"] + counts["unusable"] - 1) / figures["tracked_s"],
        "within_2_s": after.get("share_within_2_s"),
        "counts": counts,
        "median_s": after["median"],
        "worst_s": after["worst"],
        "peak_mib": float(mib.max()),
        "growth_mib_per_minute": growth,
    }


def _length(film: Path) -> float:
    """Seconds of a film, its last frame's interval included."""
    seconds = [frame.seconds for frame in Source(film)]
    return seconds[-1] - seconds[0] + float(np.median(np.diff(seconds)))


def _free_port() -> int:
    with socket.create_server((LOOPBACK, 0)) as server:
        return int(server.getsockname()[1])


def _frames_that_came(address: str) -> int | None:
    """By the session's page; None where it does not answer."""
    try:
        with urllib.request.urlopen(address + "state", timeout=10) as answer:
            return int(json.load(answer)["counts"]["came"])
    except OSError:
        return None


def _resident_mib(process: Any) -> float:
    try:
        return float(sum(p.memory_info().rss for p in [process, *process.children(recursive=True)])) / 2**20
    except psutil.NoSuchProcess:
        return 0.0


def _sentence(row: dict[str, Any]) -> str:
    growth = row["growth_mib_per_minute"]
    return (
        f"{row['film']}: {row['kept_up_per_s']:.1f} frames/s of {row['counts']['came'] / row['played_s']:.1f} kept up "
        f"with, {row['counts']['reviews']} reviews, "
        f"{row['counts']['shown']} keyframes fused {row['median_s']:.2f} s (worst {row['worst_s']:.2f} s) after "
        f"their frame, {row['counts']['dropped']} not kept up with; peak {row['peak_mib']:.0f} MiB"
        + ("" if growth is None else f", {growth:+.1f} MiB a minute")
    )
