"""Corrupted and adversarial inputs: each must end in a result or in one clear sentence, never in a crash.

    python -m benchmarks.robustness --inputs 200 --json fuzz.json
    python -m benchmarks.robustness --only 17 --inputs 200      # one of them again, with its traceback

Each input is a stretch of the demo clip. Those of even number are damaged in one or two of the ways of
`corruptions.py`: frames, file or camera file. Those of odd number are whole, but stored in one of the ways of
`strange_files.py`, which a player shows rightly. The whole of `reconstruct` runs on each. Counted: reconstructed,
refused with a sentence, fault (any other exception, a process that died, or more than `--limit` seconds). Of what is
whole also: wrong without a word, which is a path that has another clock or another hand than the truth. The result of a
damaged film is not thereby a good one: a film mirrored half-way through, say, becomes two submaps, each right in
itself. How many results have a submap that contradicts its lamp is counted too.

With `--json` each input is written down as it ends, with its commit, and the same command goes on with those that are
left.
"""

import argparse
import json
import multiprocessing
import tempfile
import traceback
from collections import Counter
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from functools import lru_cache
from pathlib import Path
from typing import Any

import av
import numpy as np

from benchmarks.common.record import environment, write
from benchmarks.robustness.corruptions import OF_FRAMES, Frames, damage_file, left_alone, wrong_camera
from benchmarks.robustness.strange_files import RATE, STRANGE, Strange, write_camera
from haustra.core.errors import HaustraError
from pipeline.config import Config, FrameSettings
from pipeline.demo import CAMERA, VIDEO
from pipeline.run import reconstruct
from reconstruction.evaluation.trajectory_io import read_tum
from reconstruction.evaluation.trajectory_metrics import associate, trajectory_errors

STRETCH = 60  # frames of an input
PX = 240  # of the working pictures' side
MOST_OFF = 0.1  # of the true path's spread; the clip's stretches give 0.001 to 0.03
MOST_TURNED_DEG = 5.0
LEAST_PAIRED = 0.9  # of the posed frames, at the true time
PER_PROCESS = 20  # inputs before a fresh process, which bounds what one can do to the next


@lru_cache(1)
def demo_frames() -> Frames:
    with av.open(str(VIDEO)) as container:
        return [frame.to_ndarray(format="rgb24") for frame in container.decode(video=0)]


def make_strange(number: int, folder: Path) -> tuple[Strange, Path, str, int]:
    """Film, camera file, in which way it is strange, and the stretch's first frame, from the input's number alone."""
    rng = np.random.default_rng(number)
    kind = list(STRANGE)[number // 2 % len(STRANGE)]
    length = 2 * STRETCH if kind == "interlaced" else STRETCH
    start = int(rng.integers(0, len(demo_frames()) - length))
    strange = STRANGE[kind](demo_frames()[start : start + length], rng, folder)
    write_camera(folder / "camera.json", json.loads(CAMERA.read_text()), strange)
    return strange, folder / "camera.json", kind, start


def attempt_strange(number: int, front_end: str) -> dict[str, Any]:
    """Reconstruct a whole film that is stored strangely, and say how it ended."""
    with tempfile.TemporaryDirectory() as scratch:
        strange, camera, kind, start = make_strange(number, Path(scratch))
        outcome: dict[str, Any] = {"number": number, "done": [kind], "camera": "file", "whole": True}
        config = Config(front_end=front_end, camera=str(camera), frames=FrameSettings(long_side=PX))
        try:
            run = reconstruct(strange.source, Path(scratch) / "run", config)
        except HaustraError as error:
            return outcome | {"end": "sentence", "text": str(error)}
        except Exception:  # noqa: BLE001 - what else there may be is the question asked
            return outcome | {"end": "fault", "text": traceback.format_exc()}
        seconds, world_from_camera = run.trajectory()
        figures = against_truth(seconds, world_from_camera, strange, start)
        posed = {"posed": run.metrics["frames"]["posed"], "submaps": len(run.metrics["submaps"])}
    right = figures["paired"] >= LEAST_PAIRED and figures["off"] <= MOST_OFF and figures["turned"] <= MOST_TURNED_DEG
    return outcome | posed | figures | {"end": "reconstructed" if right else "wrong", "dark": 0}


def against_truth(seconds: Any, world_from_camera: Any, strange: Strange, start: int) -> dict[str, float]:
    """Share of the poses at a true time; ATE over the path's spread and median turn in degrees after Sim(3)."""
    true = read_tum(CAMERA.with_name("trajectory.txt"))[1][start:][strange.rows]
    try:
        mine, theirs = associate(seconds, np.array(strange.seconds), 0.4 / RATE)
        errors = trajectory_errors(world_from_camera[mine], true[theirs])
    except HaustraError:
        return {"paired": 0.0, "off": float("inf"), "turned": 180.0}
    spread = float(np.sqrt(true[theirs, :3, 3].var(axis=0).sum()))
    return {
        "paired": len(mine) / len(seconds), "off": errors.ate_rmse / spread, "turned": errors.rotation_median_deg
    }  # fmt: skip


def make_input(number: int, folder: Path) -> tuple[Path, Path, list[str]]:
    """Video, camera file and what was done to them, from the input's number alone."""
    rng = np.random.default_rng(number)
    start = int(rng.integers(0, len(demo_frames()) - STRETCH))
    frames, done = demo_frames()[start : start + STRETCH], []
    for _ in range(rng.integers(0, 3)):
        done.append(str(rng.choice(list(OF_FRAMES))))
        frames = OF_FRAMES.get(done[-1], left_alone)(frames, rng)
    video, camera = folder / "video.mp4", folder / "camera.json"
    encode(frames, video)
    truth = json.loads(CAMERA.read_text())
    camera.write_text(json.dumps(truth))
    if not done or rng.random() < 0.2:
        which = int(rng.integers(0, 2))
        done.append(("damaged file", "wrong camera")[which])
        if which:
            camera.write_text(wrong_camera(truth, rng))
        else:
            damage_file(video, rng)
    return video, camera, done


def encode(frames: Frames, target: Path) -> None:
    height, width = frames[0].shape[:2]
    with av.open(str(target), "w") as container:
        stream = container.add_stream("libx264", rate=30)
        stream.width, stream.height, stream.pix_fmt, stream.options = width, height, "yuv420p", {"crf": "18"}
        for frame in frames:
            container.mux(stream.encode(av.VideoFrame.from_ndarray(frame, format="rgb24")))
        container.mux(stream.encode())


def attempt(number: int, front_end: str) -> dict[str, Any]:
    """Reconstruct one input and say how it ended."""
    if number % 2:
        return attempt_strange(number, front_end)
    with tempfile.TemporaryDirectory() as scratch:
        video, camera, done = make_input(number, Path(scratch))
        chosen = "auto" if number % 4 == 0 and "wrong camera" not in done else str(camera)  # a quarter guess the lens
        config = Config(front_end=front_end, camera=chosen, frames=FrameSettings(long_side=PX))
        outcome: dict[str, Any] = {"number": number, "done": done, "camera": "auto" if chosen == "auto" else "file"}
        try:
            metrics = reconstruct(video, Path(scratch) / "run", config).metrics
        except HaustraError as error:
            return outcome | {"end": "sentence", "text": str(error)}
        except Exception:  # noqa: BLE001 - what else there may be is the question asked
            return outcome | {"end": "fault", "text": traceback.format_exc()}
    dark = sum(completed["evidence"]["contrary"] > 0.05 for completed in metrics["submaps"])
    parts = len(metrics["submaps"])
    return outcome | {"end": "reconstructed", "posed": metrics["frames"]["posed"], "submaps": parts, "dark": dark}


def attempts(numbers: list[int], front_end: str, limit: float, log: Path | None) -> list[dict[str, Any]]:
    """All of them, one after the other, in processes that may die; what a log of lines knows is not done again, but for
    what ran out of time, as on a machine that others used."""
    context, commit = multiprocessing.get_context("spawn"), environment()["commit"]
    known = log.read_text().splitlines() if log is not None and log.exists() else []
    by_number = {one["number"]: one for one in map(json.loads, known) if one.get("text") != "TimeoutError"}
    outcomes: list[dict[str, Any]] = [by_number[number] for number in numbers if number in by_number]
    numbers = [number for number in numbers if number not in {one["number"] for one in outcomes}]
    for start in range(0, len(numbers), PER_PROCESS):
        pool = ProcessPoolExecutor(1, mp_context=context)
        for number in numbers[start : start + PER_PROCESS]:
            try:
                outcomes.append(pool.submit(attempt, number, front_end).result(timeout=limit))
            except (BrokenProcessPool, TimeoutError) as error:
                outcomes.append({"number": number, "end": "fault", "text": f"{type(error).__name__}"})
                for process in list(pool._processes.values()):
                    process.kill()
                pool.shutdown(wait=True, cancel_futures=True)
                pool = ProcessPoolExecutor(1, mp_context=context)
            last = outcomes[-1] = outcomes[-1] | {"commit": commit}
            if log is not None:
                with log.open("a") as file:
                    file.write(json.dumps(last) + "\n")
            print(f"{number:4} {last['end']:14} {', '.join(last.get('done', []))}", flush=True)
        pool.shutdown()
    return outcomes


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--inputs", type=int, default=200)
    parser.add_argument("--only", type=int, help="this input alone")
    parser.add_argument("--front-end", choices=["auto", "sfm", "odometry"], default="odometry")
    parser.add_argument("--limit", type=float, default=180.0, help="seconds for one input")


def measure(arguments: argparse.Namespace) -> dict[str, Any]:
    """All inputs; ends with exit code 1 if there was a fault."""
    numbers = list(range(arguments.inputs)) if arguments.only is None else [arguments.only]
    log = None if arguments.json is None else arguments.json.with_suffix(".lines")
    outcomes = attempts(numbers, arguments.front_end, arguments.limit, log)
    counts = Counter(outcome["end"] for outcome in outcomes)
    print(f"{len(outcomes)} inputs: " + ", ".join(f"{count} {end}" for end, count in sorted(counts.items())))
    print(f"results with a submap that contradicts its lamp: {sum(bool(o.get('dark')) for o in outcomes)}")
    whole = [outcome for outcome in outcomes if outcome.get("whole")]
    rightly = sum(outcome["end"] == "reconstructed" for outcome in whole)
    print(f"of {len(whole)} that a player shows rightly {rightly} were reconstructed")
    record = {"front_end": arguments.front_end, "counts": dict(counts), "outcomes": outcomes}
    faults = [outcome for outcome in outcomes if outcome["end"] in ("fault", "wrong")]
    for outcome in faults:
        print(f"\ninput {outcome['number']} {outcome.get('done')}\n{outcome.get('text', outcome)}")
    if faults:
        write(arguments.json, record)
        raise SystemExit(1)
    return record
