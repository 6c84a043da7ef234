"""Weights and training states as safetensors files; nothing here unpickles.

The header of a weight file has the class name and the configuration of its network (`registry.described_network`), so
that loading needs no other file and a wrong file is refused by name.
"""

import json
import os
from dataclasses import asdict
from pathlib import Path
from typing import Any

import torch
from safetensors import SafetensorError, safe_open
from safetensors.torch import save_file
from torch import Tensor, nn

from completion.networks.registry import Entry, described_network
from haustra.core.errors import CompletionError


def save_tensors(path: Path, tensors: dict[str, Tensor], metadata: dict[str, Any]) -> None:
    """Write tensors, and metadata as JSON in the header, atomically: a killed run keeps its last whole checkpoint."""
    path.parent.mkdir(parents=True, exist_ok=True)
    partial = path.with_name(path.name + ".partial")
    contiguous = {name: tensor.detach().contiguous().clone() for name, tensor in tensors.items()}
    save_file(contiguous, partial, metadata={"haustra": json.dumps(metadata)})
    os.umask(umask := os.umask(0))  # which can only be read by setting it
    partial.chmod(0o666 & ~umask)  # as any other file; safetensors keeps it from everybody else
    os.replace(partial, path)


def read_metadata(path: Path) -> dict[str, Any]:
    """The metadata that `save_tensors` wrote into the header."""
    try:
        with safe_open(path, framework="pt") as file:
            header = file.metadata() or {}
    except (SafetensorError, OSError) as error:
        raise CompletionError(f"{path} is not a readable safetensors file: {error}") from error
    if "haustra" not in header:
        raise CompletionError(f"{path} holds tensors, but no haustra network: its header lacks a configuration")
    return json.loads(header["haustra"])


def load_tensors(path: Path) -> tuple[dict[str, Tensor], dict[str, Any]]:
    """Tensors and metadata of a file that `save_tensors` wrote."""
    metadata = read_metadata(path)
    with safe_open(path, framework="pt") as file:
        return {name: file.get_tensor(name) for name in file.keys()}, metadata  # noqa: SIM118


def save_network(path: Path, network: nn.Module, weights: dict[str, Tensor], about: dict[str, Any]) -> None:
    """Write weights in half precision; metadata: class name, configuration, and `about`."""
    halved = {n: t.half() if t.is_floating_point() else t for n, t in weights.items()}
    config = asdict(network.config)  # type: ignore[call-overload]  # a dataclass
    save_tensors(path, halved, {"network": type(network).__name__, "config": config, **about})


def load_network(path: Path) -> nn.Module:
    """The network of a weight file, strictly loaded, in evaluation mode."""
    tensors, metadata = load_tensors(path)
    entry, config = _described(metadata, path)
    network = entry.network(config)
    try:
        network.load_state_dict({n: t.float() if t.is_floating_point() else t for n, t in tensors.items()})
    except RuntimeError as error:
        raise CompletionError(f"the weights in {path} do not fit {metadata['network']}: {reason(error)}") from error
    return network.eval()


def reason(error: RuntimeError) -> str:
    """The first mismatch that torch's `load_state_dict` reports, without its headline."""
    lines = str(error).splitlines()
    return lines[min(1, len(lines) - 1)].strip()


def read_config(path: Path) -> Any:
    """The configuration of a weight file's network, from the header alone."""
    return _described(read_metadata(path), path)[1]


def _described(metadata: dict[str, Any], path: Path) -> tuple[Entry, Any]:
    try:
        return described_network(metadata["network"], metadata["config"])
    except (KeyError, TypeError) as error:
        raise CompletionError(f"{path} describes no network that this version knows: {error}") from error
    except CompletionError as error:
        raise CompletionError(f"{path} holds {error}") from None


def flatten_optimizer(optimizer: torch.optim.Optimizer) -> dict[str, Tensor]:
    """AdamW's moments as named tensors."""
    state = optimizer.state_dict()["state"]
    return {f"optimizer.{i}.{key}": value for i, slots in state.items() for key, value in slots.items()}


def restore_optimizer(optimizer: torch.optim.Optimizer, tensors: dict[str, Tensor]) -> None:
    """The inverse of `flatten_optimizer`, for an optimizer over the same parameters."""
    state: dict[int, dict[str, Tensor]] = {}
    for name, value in tensors.items():
        if name.startswith("optimizer."):
            _, index, key = name.split(".")
            state.setdefault(int(index), {})[key] = value
    optimizer.load_state_dict({"state": state, "param_groups": optimizer.state_dict()["param_groups"]})
