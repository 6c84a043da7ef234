"""Milliseconds per frame of depth completion: the default model beside the rivals and interpolation, in turn.

    python -m benchmarks.speed completion --runs 20 --json completion_speed.json

One 320x320 frame, 100 points, every core; then the default model over image sizes, points, iterations and
working sizes. Rivals have random weights, which cost the same; theirs is the network alone, the default's is the whole
of `DepthCompleter` (exposure, normalisation, confidence). "network alone" is one iteration at 320 px by onnxruntime
and, where it is installed, by OpenVINO in both precisions. Each run measures all of them once, in a new order.
"""

import argparse
import tempfile
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import torch

from benchmarks.common.record import shown, spread
from completion import DepthCompleter
from completion.data.sampling_training import normalise_log
from completion.inference.completer import load_depth_network
from completion.inference.onnx_export import export_onnx
from completion.networks.classical import CLASSICAL
from completion.networks.cpu.int8_unet import can_use_int8
from completion.networks.protocol import DepthNetwork
from completion.networks.registry import build_model
from pipeline.run_folder.malloc import keep_freed_memory

RIVALS = ("std18", "std50", "nlspn", "gaenet")
SIZES, POINTS = (160, 240, 320, 480), (10, 100, 1000)
Calls = dict[str, Callable[[], object]]
Graph = dict[str, np.ndarray]  # inputs of an exported network


def scene(size: int, points: int) -> tuple[np.ndarray, np.ndarray]:
    """A tube-like depth, shaded by its distance, with random points."""
    rng = np.random.default_rng(0)
    y, x = np.mgrid[:size, :size] / size - 0.5
    depth = (8 / np.maximum(np.hypot(x, y), 0.05)).astype(np.float32)
    rgb = np.clip(4e4 / depth**2 + rng.normal(0, 4, depth.shape), 0, 255).astype(np.uint8)[..., None].repeat(3, axis=2)
    sparse = np.zeros_like(depth)
    chosen = rng.choice(size * size, points, replace=False)
    sparse.ravel()[chosen] = depth.ravel()[chosen]
    return rgb, sparse


def network_call(name: str, size: str, rgb: np.ndarray, sparse: np.ndarray) -> Callable[[], object]:
    network = build_model(name, size).eval()  # type: ignore[arg-type]
    image = torch.from_numpy(rgb).permute(2, 0, 1)[None].float() / 255
    image = image.contiguous(memory_format=torch.channels_last)
    points = torch.from_numpy(sparse)[None, None]
    lens = torch.tensor([[160.0, 160.0, rgb.shape[1] / 2, rgb.shape[0] / 2]])

    def call() -> object:
        with torch.inference_mode():
            return network(image, points / 25, lens)

    return call


def exported(network: DepthNetwork, rgb: np.ndarray, sparse: np.ndarray, folder: Path) -> tuple[Path, Graph]:
    """A network's graph for a picture of this size, and what goes in."""
    path = export_onnx(network, folder / "m.onnx", rgb.shape[0])
    trust = (sparse > 0).astype(np.float32)[None, None]
    log_sparse = normalise_log(torch.from_numpy(sparse)[None, None])[0].numpy()
    return path, {
        "rgb": rgb.transpose(2, 0, 1)[None].astype(np.float32) / 255,
        "log_sparse": log_sparse,
        "trust": trust,
    }


def by_onnxruntime(path: Path, inputs: Graph) -> Callable[[], object]:
    """Float32: it has no other on a CPU."""
    import onnxruntime

    session = onnxruntime.InferenceSession(str(path), providers=["CPUExecutionProvider"])
    return lambda: session.run(None, inputs)


def by_openvino(path: Path, inputs: Graph) -> Calls:
    """Per precision; empty where OpenVINO is not installed."""
    try:
        import openvino
    except ImportError:
        return {}
    core = openvino.Core()
    calls: Calls = {}
    model = core.read_model(path)
    model.reshape({name: list(array.shape) for name, array in inputs.items()})
    for precision in ("f32", "bf16"):
        hints = {"INFERENCE_PRECISION_HINT": precision, "PERFORMANCE_HINT": "LATENCY"}
        hints["INFERENCE_NUM_THREADS"] = torch.get_num_threads()
        request = core.compile_model(model, "CPU", hints).create_infer_request()
        calls[f"network alone at 320 px, OpenVINO {precision}"] = partial(request.infer, inputs)
    return calls


def of_default(rgb: np.ndarray, sparse: np.ndarray) -> Calls:
    """The default as it is, then over image sizes, points, iterations, working sizes and precisions."""
    completer = DepthCompleter.load("mscsa")
    calls: Calls = {"mscsa (default), 320 px, 100 points": partial(completer, rgb, sparse)}
    for size in SIZES:
        calls[f"mscsa, {size} px"] = partial(completer, *scene(size, 100))
    for points in POINTS:
        calls[f"mscsa, {points} points"] = partial(completer, *scene(320, points))
    network = load_depth_network("mscsa")
    for iterations, side in ((1, 192), (1, 224), (1, 256), (1, 320), (2, 224), (2, 320), (2, 384), (2, 448), (3, 320)):
        other = DepthCompleter(network, resolution=side, iterations=iterations)
        calls[f"mscsa, {iterations} iteration{'s' * (iterations > 1)} at {side} px"] = partial(other, rgb, sparse)
    for precision in ("int8", "bf16", "fp32"):
        if precision != "int8" or can_use_int8():
            calls[f"mscsa, {precision}"] = partial(DepthCompleter(network, precision=precision), rgb, sparse)
    return calls


def of_network_alone(rgb: np.ndarray, sparse: np.ndarray) -> Calls:
    """The default's network in other programs."""
    calls: Calls = {}
    with tempfile.TemporaryDirectory() as folder:
        path, inputs = exported(load_depth_network("mscsa"), rgb, sparse, Path(folder))
        calls["network alone at 320 px, onnxruntime"] = by_onnxruntime(path, inputs)
        calls |= by_openvino(path, inputs)
    return calls


def of_others(rgb: np.ndarray, sparse: np.ndarray) -> Calls:
    """Interpolation and the rivals' networks."""
    calls: Calls = {"linear": lambda: CLASSICAL["linear"](sparse)}
    for name in RIVALS:
        for size in ("small", "paper"):
            if (name, size) != ("nlspn", "paper"):  # seconds a frame
                calls[f"{name} {size}"] = network_call(name, size, rgb, sparse)
    return calls


def milliseconds(calls: Calls, runs: int) -> dict[str, list[float]]:
    """Of each call in each run; each run in a new order."""
    times: dict[str, list[float]] = {name: [] for name in calls}
    for call in calls.values():
        call()  # once for caches and lazy set-up
    order = np.random.default_rng(0)
    for _ in range(runs):
        for name in order.permutation(list(calls)):
            start = time.perf_counter()
            calls[name]()
            times[name].append(1000 * (time.perf_counter() - start))
    return times


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--runs", type=int, default=20)


def measure(arguments: argparse.Namespace) -> dict[str, Any]:
    """All of them once in each run."""
    keep_freed_memory()  # as while `reconstruct` completes depth
    inputs = scene(320, 100)
    times = milliseconds(of_default(*inputs) | of_network_alone(*inputs) | of_others(*inputs), arguments.runs)
    figures = {name: spread(values) for name, values in times.items()}
    for name, values in figures.items():
        print(f"{name:44} {shown(values, '.1f')} ms ({arguments.runs} runs)")
    first = next(iter(times))
    ratio = float(np.median(np.array(times["linear"]) / np.array(times[first])))
    print(f"linear takes {ratio:.2f} of the default's time")
    return {"figures": figures, "linear_over_default": ratio, "threads": torch.get_num_threads()}
