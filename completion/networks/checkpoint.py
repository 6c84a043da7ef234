"""Weights and training states as safetensors; nothing here unpickles.

A weight file carries its network's name and configuration in the header, so that loading needs no other file and a
wrong one is refused by name instead of half loaded.
"""

import json
import os
from pathlib import Path
from typing import Any

import torch
from safetensors import SafetensorError, safe_open
from safetensors.torch import save_file
from torch import Tensor

from completion.networks.mscsa import MSCSAConfig, MSCSANet
from completion.networks.mscsa_sfm import ScaleFreeConfig, ScaleFreeMSCSANet
from completion.networks.registry import MSCSAModel
from completion.networks.rivals.gaenet import GAENet, GAENetConfig
from completion.networks.rivals.nlspn import NLSPN, NLSPNConfig
from completion.networks.rivals.sparse_to_dense import StDConfig, StDNet
from haustra.core.errors import CompletionError

Network = MSCSANet | ScaleFreeMSCSANet | StDNet | NLSPN | GAENet
_BUILDERS: dict[str, tuple[type[Network], type[Any]]] = {
    "ScaleFreeMSCSANet": (ScaleFreeMSCSANet, ScaleFreeConfig),
    "MSCSANet": (MSCSANet, MSCSAConfig),
    "MSCSAModel": (MSCSAModel, MSCSAConfig),
    "StDNet": (StDNet, StDConfig),
    "NLSPN": (NLSPN, NLSPNConfig),
    "GAENet": (GAENet, GAENetConfig),
}


def save_tensors(path: Path, tensors: dict[str, Tensor], metadata: dict[str, Any]) -> None:
    """Write atomically: a run that is killed while saving keeps its last whole checkpoint."""
    path.parent.mkdir(parents=True, exist_ok=True)
    partial = path.with_name(path.name + ".partial")
    contiguous = {name: tensor.detach().contiguous().clone() for name, tensor in tensors.items()}
    save_file(contiguous, partial, metadata={"haustra": json.dumps(metadata)})
    os.umask(umask := os.umask(0))  # which can only be read by setting it
    partial.chmod(0o666 & ~umask)  # as any other file; safetensors keeps it from everybody else
    os.replace(partial, path)


def read_metadata(path: Path) -> dict[str, Any]:
    """What `save_tensors` wrote into the header."""
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


def save_network(path: Path, network: Network, weights: dict[str, Tensor], about: dict[str, Any]) -> None:
    """Weights in half precision with the network's name and configuration."""
    halved = {n: t.half() if t.is_floating_point() else t for n, t in weights.items()}
    save_tensors(path, halved, {"network": type(network).__name__, "config": network.config.to_dict(), **about})


def load_network(path: Path) -> Network:
    """The network of a weight file, strictly loaded, in evaluation mode."""
    tensors, metadata = load_tensors(path)
    network = _build(metadata, path)
    try:
        network.load_state_dict({n: t.float() if t.is_floating_point() else t for n, t in tensors.items()})
    except RuntimeError as error:
        raise CompletionError(f"the weights in {path} do not fit {metadata['network']}: {reason(error)}") from error
    return network.eval()


def reason(error: RuntimeError) -> str:
    """The first thing that torch found wrong with a state, below its headline."""
    lines = str(error).splitlines()
    return lines[min(1, len(lines) - 1)].strip()


def _build(metadata: dict[str, Any], path: Path) -> Network:
    try:
        if metadata["network"] in _BUILDERS:
            network, config = _BUILDERS[metadata["network"]]
            return network(config(**metadata["config"]))
    except (KeyError, TypeError) as error:
        raise CompletionError(f"{path} describes no network that this version knows: {error}") from error
    raise CompletionError(f"{path} holds a {metadata['network']}, which this version does not know")


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
