"""Bundle adjustment of odometry's windows: ours beside Ceres (by pycolmap) and GTSAM, on the same windows.

    python -m benchmarks.speed window-adjustment SUITE/loop SUITE/low_texture --json windows.json

The windows are those that tracking a film meets, every `--every`-th of those that two cameras or more hold, as they are
before they are adjusted. Films must have a pinhole's lens, since residuals are then the same pixels for all three; that
all begin at the same cost (Cauchy's, to a millionth) is checked, and windows with a point behind a camera, which each
library takes in its own way, are left out and counted. One thread each. Held cameras are constant for ours and for
Ceres, and have a prior of a millionth for GTSAM, which is slower by six to ten times with an equality.

Twice: two iterations, as many as the tracker takes at most, and until one lowers the cost by less than a thousandth (20
at most). An iteration of ours and of Ceres tries one damping, one of GTSAM's as many as it takes to lower the cost.
*Making* is what turns arrays into each library's problem, in Python; in COLMAP's and GTSAM's own programs most of that
would be C++. *Solving* is the rest, Ceres' own set-up included. The cost that each reaches is computed by one function,
as a share of the first.
"""

import argparse
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import cv2  # before pycolmap: see pipeline/frontend/colmap/worker.py
import gtsam
import numpy as np
import pycolmap
from gtsam.symbol_shorthand import L, X
from threadpoolctl import threadpool_limits

from benchmarks.common.front_end import store, tracked_maps
from benchmarks.common.record import spread
from benchmarks.common.runner import add_folders
from haustra.core.camera import Camera
from pipeline.config import Config
from pipeline.frontend.odometry.frame_io import frame_reader
from pipeline.mapping import map_adjustment
from pipeline.mapping.map_adjustment import LOSS_PX, WINDOW_ITERATIONS
from pipeline.optimization.bundle_adjustment import Bundle, adjust
from pipeline.optimization.kernels import robust_cost

CONVERGED, MOST = 1e-3, 20
HELD_SIGMA = 1e-6
SAME_COST = 1e-6


@dataclass(frozen=True)
class Stop:
    """When an adjustment ends: iterations, and the share of the cost below which another does not pay (0: never)."""

    name: str
    iterations: int
    tolerance: float


STOPS = (Stop(f"{WINDOW_ITERATIONS} steps", WINDOW_ITERATIONS, 0.0), Stop("converged", MOST, CONVERGED))


@dataclass(frozen=True)
class Adjusted:
    """A window as a library left it; seconds of making its problem and of solving it; the cost that it began at."""

    bundle: Bundle
    making: float
    solving: float
    begun_at: float


def windows_of(folder: Path, every: int, scratch: Path) -> tuple[Camera, list[Bundle]]:
    """Windows that tracking the film adjusts, before they are adjusted; those with a point behind a camera too."""
    frames, workspace = store(folder, Config(front_end="odometry", seed=0), scratch)
    if frames.camera.model != "PINHOLE":
        raise SystemExit(f"{folder}: its lens is {frames.camera.model}; only a pinhole's residuals are alike for all")
    met: list[Bundle] = []

    def recorded(bundle: Bundle, *others: Any) -> Bundle:
        met.append(bundle)
        return adjust(bundle, *others)

    map_adjustment.adjust = recorded  # type: ignore[attr-defined]
    try:
        tracked_maps(frames.camera, frame_reader(workspace), frames.index)
    finally:
        map_adjustment.adjust = adjust  # type: ignore[attr-defined]
    return frames.camera, [w for w in met if w.fixed.sum() > 1 and not w.fixed.all()][::every]


def is_ahead(window: Bundle) -> bool:
    """Whether all points lie ahead of the cameras that saw them."""
    local = np.einsum("mij,mj->mi", window.rotation[window.camera], window.points[window.point])
    return bool((local[:, 2] + window.translation[window.camera, 2] > 0).all())


def ours(window: Bundle, camera: Camera, stop: Stop) -> Adjusted:
    begun = time.perf_counter()
    result = adjust(window, stop.iterations, LOSS_PX, stop.tolerance)
    return Adjusted(result, 0.0, time.perf_counter() - begun, robust_cost(*window.arrays, LOSS_PX))


def by_ceres(window: Bundle, camera: Camera, stop: Stop) -> Adjusted:
    begun = time.perf_counter()
    model, config, names = _ceres_problem(window, camera)
    options = _ceres_options(stop)
    made = time.perf_counter()
    summary = pycolmap.create_default_bundle_adjuster(options, config, model).solve()
    solved = time.perf_counter()
    cameras_from_world = np.stack([model.images[k + 1].cam_from_world().matrix() for k in range(len(window.rotation))])
    points = np.stack([model.points3D[name].xyz for name in names])
    result = replace(
        window, rotation=cameras_from_world[:, :, :3], translation=cameras_from_world[:, :, 3], points=points
    )
    return Adjusted(result, made - begun, solved - made, 2 * summary.ceres_summary.initial_cost)


def _ceres_problem(
    window: Bundle, camera: Camera
) -> tuple[pycolmap.Reconstruction, pycolmap.BundleAdjustmentConfig, list[int]]:
    """The window as a COLMAP model, what is held in it, and its points' names there."""
    model, config = pycolmap.Reconstruction(), pycolmap.BundleAdjustmentConfig()
    lens = pycolmap.Camera(model="PINHOLE", width=camera.width, height=camera.height, params=camera.params)
    lens.camera_id = 1
    model.add_camera_with_trivial_rig(lens)
    pixels = window.xy * camera.focal + camera.centre
    row_in_image = np.arange(len(window.camera)) - np.searchsorted(window.camera, window.camera)
    for number, (rotation, translation) in enumerate(zip(window.rotation, window.translation, strict=True)):
        image = pycolmap.Image(f"{number}", pixels[window.camera == number], 1, number + 1)
        camera_from_world = pycolmap.Rigid3d(pycolmap.Rotation3d(rotation), translation)
        model.add_image_with_trivial_frame(image, camera_from_world)
        config.add_image(number + 1)
        if window.fixed[number]:
            config.set_constant_rig_from_world_pose(number + 1)
    config.set_constant_cam_intrinsics(1)
    tracks: list[list[pycolmap.TrackElement]] = [[] for _ in window.points]
    for number, row, point in zip(window.camera.tolist(), row_in_image.tolist(), window.point.tolist(), strict=True):
        tracks[point].append(pycolmap.TrackElement(number + 1, row))
    names = [model.add_point3D(x, pycolmap.Track(t)) for x, t in zip(window.points, tracks, strict=True)]
    return model, config, names


def _ceres_options(stop: Stop) -> pycolmap.BundleAdjustmentOptions:
    options = pycolmap.BundleAdjustmentOptions()
    options.refine_focal_length = options.refine_extra_params = options.print_summary = False
    options.ceres.loss_function_type = pycolmap.LossFunctionType.CAUCHY
    options.ceres.loss_function_scale = LOSS_PX
    solver = options.ceres.solver_options
    solver.max_num_iterations, solver.function_tolerance = stop.iterations, stop.tolerance
    solver.gradient_tolerance = solver.parameter_tolerance = 0.0
    solver.num_threads = 1
    return options


def by_gtsam(window: Bundle, camera: Camera, stop: Stop) -> Adjusted:
    begun = time.perf_counter()
    graph, values = _gtsam_problem(window, camera)
    params = gtsam.LevenbergMarquardtParams()
    params.setMaxIterations(stop.iterations)
    params.setRelativeErrorTol(stop.tolerance)
    params.setAbsoluteErrorTol(0.0)
    made = time.perf_counter()
    solved_values = gtsam.LevenbergMarquardtOptimizer(graph, values, params).optimize()
    solved = time.perf_counter()
    cameras_from_world = [solved_values.atPose3(X(number)).inverse() for number in range(len(window.rotation))]
    result = replace(
        window,
        rotation=np.stack([transform.rotation().matrix() for transform in cameras_from_world]),
        translation=np.stack([transform.translation() for transform in cameras_from_world]),
        points=np.stack([solved_values.atPoint3(L(number)) for number in range(len(window.points))]),
    )
    return Adjusted(result, made - begun, solved - made, 2 * graph.error(values))


def _gtsam_problem(window: Bundle, camera: Camera) -> tuple[gtsam.NonlinearFactorGraph, gtsam.Values]:
    """The window as a factor graph and where it begins."""
    lens = gtsam.Cal3_S2(*camera.focal, 0.0, *camera.centre)
    noise = gtsam.noiseModel.Robust.Create(
        gtsam.noiseModel.mEstimator.Cauchy.Create(LOSS_PX), gtsam.noiseModel.Unit.Create(2)
    )
    graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    pixels = window.xy * camera.focal + camera.centre
    for pixel, number, point in zip(pixels, window.camera.tolist(), window.point.tolist(), strict=True):
        graph.add(gtsam.GenericProjectionFactorCal3_S2(pixel, noise, X(number), L(point), lens))
    for number, (rotation, translation) in enumerate(zip(window.rotation, window.translation, strict=True)):
        camera_from_world = gtsam.Pose3(gtsam.Rot3(rotation.T), -rotation.T @ translation)
        values.insert(X(number), camera_from_world)
        if window.fixed[number]:
            graph.add(
                gtsam.PriorFactorPose3(X(number), camera_from_world, gtsam.noiseModel.Isotropic.Sigma(6, HELD_SIGMA))
            )
    for number, point in enumerate(window.points):
        values.insert(L(number), point)
    return graph, values


MOVED = ("rotation", "translation", "points")
METHODS: dict[str, Callable[[Bundle, Camera, Stop], Adjusted]] = {"ours": ours, "Ceres": by_ceres, "GTSAM": by_gtsam}


def measured(camera: Camera, windows: list[Bundle]) -> list[dict[str, Any]]:
    """A row for each window, stop and method, window by window, so that all meet the machine alike."""
    for method in METHODS.values():
        method(windows[0], camera, STOPS[0])  # compiles and loads
    rows = []
    for number, window in enumerate(windows):
        first = robust_cost(*window.arrays, LOSS_PX)
        size = {"observations": len(window.camera), "points": len(window.points), "cameras": len(window.rotation)}
        for stop in STOPS:
            for name, method in METHODS.items():
                done = method(window, camera, stop)
                if abs(done.begun_at / first - 1) > SAME_COST:
                    raise SystemExit(f"{name} begins at a cost of {done.begun_at}, not {first}: another problem")
                bundle = replace(done.bundle, **{k: np.ascontiguousarray(getattr(done.bundle, k)) for k in MOVED})
                rows.append(
                    {"window": number, "stop": stop.name, "method": name, "making_ms": 1e3 * done.making}
                    | {"solving_ms": 1e3 * done.solving, "cost_left": robust_cost(*bundle.arrays, LOSS_PX) / first}
                    | size
                )
    return rows


def print_table(film: str, rows: list[dict[str, Any]]) -> None:
    typical = {k: int(np.median([r[k] for r in rows])) for k in ("observations", "points", "cameras")}
    count = len({r["window"] for r in rows})
    print(f"{film}: {count} windows, in the median {typical}; median (least to most)")
    for stop in STOPS:
        for name in METHODS:
            mine = [r for r in rows if (r["stop"], r["method"]) == (stop.name, name)]
            cells = [spread([r[k] for r in mine]) for k in ("solving_ms", "making_ms", "cost_left")]
            texts = [f"{c['median']:.4g} ({c['min']:.4g} to {c['max']:.4g})" for c in cells]
            print(f"  {stop.name:10} {name:6} solving {texts[0]} ms, making {texts[1]} ms, cost left {texts[2]}")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add_folders(parser, "RGB-D folders whose lens is a pinhole")
    parser.add_argument("--every", type=int, default=5, help="use every n-th window")


def measure(arguments: argparse.Namespace) -> dict[str, Any]:
    """The windows of every film by every method."""
    cv2.setNumThreads(1)
    results = {}
    with threadpool_limits(1):
        for folder in arguments.folders:
            with tempfile.TemporaryDirectory() as scratch:
                camera, windows = windows_of(folder, arguments.every, Path(scratch) / folder.name)
            ahead = [window for window in windows if is_ahead(window)]
            print(f"{folder.name}: {len(windows) - len(ahead)} of {len(windows)} windows have a point behind a camera")
            results[folder.name] = measured(camera, ahead)
            print_table(folder.name, results[folder.name])
    return {"windows": results}
