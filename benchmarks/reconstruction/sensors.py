"""A depth sensor or a second eye beside the pictures: scale, path and surface in the run's own millimetres.

    haustra phantom SUITE --suite
    python -m benchmarks.reconstruction sensors SUITE/easy_withdrawal --parts --json benchmarks/results/sensors.json

Of each film the depth of two time-of-flight sensors (64x64 and 240x180 zones, 3 % of noise, holes at grazing angles and
highlights, 5 % dropped; `scripts/simulated_sensor.py`) and a pair of eyes 4 mm apart (`scripts/stereo_film.py`) are
made. Each is reconstructed with odometry and the lens given, beside the pictures alone. With `--parts` also with the
scale of the whole alone, with adjustment but without the sensor's points in completion, with points of the keyframe's
own depth instead of those gathered from the frames around, and with points but without adjustment. With
`--front-end sfm` poses are of COLMAP's mapper.

scale_error: of the path, 1 is 100 %; None without millimetres. Errors of the path are RMSE of camera centres; F-scores
are at 1 mm, after the path's Sim(3), and after its SE(3), that is in the run's own mm. A row is added as each run
ends; a stopped call goes on where it was. Rendered by `python scripts/pages/sensors_page.py`.
"""

import argparse
import subprocess
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any, Literal

from benchmarks.common.record import ROOT, RunTable, print_row
from benchmarks.common.runner import add_folders
from haustra.core.camera import read_camera
from haustra.core.errors import HaustraError
from pipeline.compare import compare_run
from pipeline.config import Config
from pipeline.given_settings import SensorSettings, StereoSettings
from pipeline.run import reconstruct

ALONE, WHOLE, STEREO = "pictures alone", "all of it", "stereo, 4 mm"
PARTS: dict[str, dict[str, Any]] = {
    WHOLE: {},
    "scale alone": {"adjust": False, "points": "none"},
    "adjusted, no points": {"points": "none"},
    "adjusted, points of the own frame": {"points": "own"},
    "gathered points, not adjusted": {"adjust": False},
}
Make = Callable[[Path, Path], None]  # of a film, into a new folder


def _time_of_flight(columns: int, rows: int) -> Make:
    return lambda film, out: _script("simulated_sensor", film, out, "--noise", 0.03, "--zones", columns, rows)


SENSORS: dict[str, Make] = {
    "64x64 zones": _time_of_flight(64, 64),
    "240x180 zones": _time_of_flight(240, 180),
    STEREO: lambda film, out: _script("stereo_film", film, out, "--baseline", 4),
}


def _script(name: str, *arguments: object) -> None:
    subprocess.run([sys.executable, str(ROOT / f"scripts/{name}.py"), *map(str, arguments)], check=True, cwd=ROOT)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add_folders(parser, "films of the phantom")
    parser.add_argument("--front-end", choices=["odometry", "sfm"], default="odometry")
    parser.add_argument("--parts", action="store_true", help="also without each part")


def measure(arguments: argparse.Namespace) -> None:
    table, parts = RunTable(arguments.json), list(PARTS) if arguments.parts else [WHOLE]
    front_end = arguments.front_end
    by = "" if front_end == "odometry" else f"{front_end}, "
    for film in arguments.folders:
        if not table.has(film.name, 0, by + ALONE):
            camera = str(film / "camera.json")
            alone = Config(camera=camera, front_end=front_end, sensor=SensorSettings(depth="none"))
            _add(table, film, by + ALONE, figures_of(film, film, alone))
        for sensor, make in SENSORS.items():
            if sensor == STEREO and not read_camera(film / "camera.json").is_pinhole:
                continue  # the second eye is rendered for pinholes alone
            missing = [part for part in parts if not table.has(film.name, 0, f"{by}{sensor}: {part}")]
            if missing:
                with tempfile.TemporaryDirectory() as scratch:
                    sensed = Path(scratch) / "sensed"
                    make(film, sensed)
                    for part in missing:
                        config = config_of(sensed, PARTS[part], front_end)
                        _add(table, film, f"{by}{sensor}: {part}", figures_of(sensed, film, config))


def config_of(sensed: Path, part: dict[str, Any], front_end: Literal["odometry", "sfm"]) -> Config:
    """For a folder with a sensor's depth, or one of stereo pictures."""
    sensor, rig = SensorSettings.model_validate(part), sensed / "rig.yaml"
    if rig.is_file():
        return Config(front_end=front_end, sensor=sensor, stereo=StereoSettings(calibration=str(rig)))
    return Config(camera=str(sensed / "camera.json"), front_end=front_end, sensor=sensor)


def figures_of(source: Path, truth: Path, config: Config) -> dict[str, Any]:
    """Of one run; one that fails leaves its sentence."""
    with tempfile.TemporaryDirectory() as scratch:
        try:
            run = reconstruct(source, Path(scratch) / "run", config)
            found = compare_run(run.folder, truth)
        except HaustraError as error:
            return {"failed": str(error)}
    metric, surface = found.se3, found.surface
    assert surface is not None
    return {
        "posed": found.posed,
        "frames": found.total,
        "scale_error": None if metric is None else abs(found.sim3.scale - 1),
        "ate_sim3_mm": found.sim3.ate_rmse,
        "ate_se3_mm": None if metric is None else metric.ate_rmse,
        "rotation_deg": found.sim3.rotation_median_deg,
        "f_sim3": 100 * surface.f_score,
        "f_se3": None if found.surface_se3 is None else 100 * found.surface_se3.f_score,
    }


def _add(table: RunTable, film: Path, method: str, figures: dict[str, Any]) -> None:
    table.add(film.name, 0, {method: figures})
    print_row({"film": film.name, "method": method} | figures, digits=4)
