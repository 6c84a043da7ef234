"""A run of the embedded clip's first 0.7 s, small, with the figures that a sound installation gives."""

import tempfile
import time
import traceback
from pathlib import Path

from haustra.core.errors import HaustraError
from pipeline.doctor.machine import Finding

END_S, PX = 0.7, 256
FRAMES = 21
MOST_ATE_MM = 0.2  # 0.018 at seed 0
LEAST_PERCENT = 80.0  # of the surface within 1 mm of the true wall; 89 at seed 0


def self_test() -> list[Finding]:
    """Decode, track, complete, fuse and compare: one line for each figure, or for what went wrong."""
    start = time.monotonic()
    try:
        posed, ate, percent = _figures()
    except HaustraError as error:
        return [Finding("self-test", "refused", "fault", str(error))]
    except Exception:  # noqa: BLE001 - whatever it is belongs into the report
        lines = traceback.format_exc().splitlines()
        return [Finding("self-test", "failed", "fault", f"{lines[-1]} ({lines[-3].strip()})")]
    wrong = "a sound installation gives other figures"
    return [
        Finding("self-test", f"{time.monotonic() - start:.0f} s (the first one compiles loops, which takes minutes)"),
        _judged("frames", f"{posed} of {FRAMES} posed, expected all", posed == FRAMES, wrong),
        _judged("path", f"{ate:.3f} mm off, expected below {MOST_ATE_MM:g}", ate < MOST_ATE_MM, wrong),
        _judged("surface", f"{percent:.0f} % right, expected over {LEAST_PERCENT:g}", percent > LEAST_PERCENT, wrong),
    ]


def _judged(subject: str, value: str, good: bool, meaning: str) -> Finding:
    return Finding(subject, value, "ok" if good else "fault", "" if good else meaning)


def _figures() -> tuple[int, float, float]:
    """Frames posed, ATE in mm, percent of the surface within 1 mm of the truth."""
    from pipeline.compare import compare_run
    from pipeline.config import FAST_KEYFRAME_MOTION, Config, FrameSettings, load_config
    from pipeline.demo import CAMERA, FOLDER, VIDEO
    from pipeline.run import reconstruct

    settings: Config = load_config(
        None, camera=str(CAMERA), front_end="odometry", odometry={"keyframe_motion": FAST_KEYFRAME_MOTION}
    ).model_copy(update={"frames": FrameSettings(end_s=END_S, long_side=PX)})
    with tempfile.TemporaryDirectory() as scratch:
        run = Path(scratch) / "run"
        reconstruct(VIDEO, run, settings)
        errors = compare_run(run, FOLDER)
    assert errors.surface is not None
    return errors.posed, errors.sim3.ate_rmse, 100 * errors.surface.precision
