"""Names and files of the weights that come with the package, and validation of a model before any work."""

import json
from importlib import resources
from pathlib import Path

from haustra.core.errors import CompletionError

SHIPPED_WEIGHTS = {"mscsa": "mscsa.safetensors"}


def resolve_weights(model: str | Path) -> Path:
    """Path of shipped weights by name, or of the given weight file; CompletionError if it is neither."""
    if str(model) in SHIPPED_WEIGHTS:
        return Path(str(resources.files("completion.weights") / SHIPPED_WEIGHTS[str(model)]))
    if Path(model).is_file():
        return Path(model)
    raise CompletionError(f"no model '{model}': give a weight file or one of {', '.join(SHIPPED_WEIGHTS)}")


def check_whole(path: Path) -> None:
    """CompletionError for a safetensors file that is cut off, by its header alone and without torch.

    Format: 8 bytes with the header's length, the header in JSON with each tensor's `data_offsets`, then the tensors.
    """
    try:
        with path.open("rb") as file:
            length = int.from_bytes(file.read(8), "little")
            header = json.loads(file.read(min(length, path.stat().st_size)))
        ends = [entry["data_offsets"][1] for name, entry in header.items() if name != "__metadata__"]
        whole = 8 + length + max(ends)
    except (OSError, ValueError, KeyError, TypeError, IndexError) as error:
        raise CompletionError(f"the weights {path} are damaged ({error}); install haustra again") from error
    if path.stat().st_size != whole:
        raise CompletionError(f"the weights {path} have {path.stat().st_size} bytes of {whole}; install haustra again")


def validate_weights(model: str | Path, iterations: int | None = None) -> None:
    """CompletionError for a model that cannot be loaded or was trained for fewer iterations; reads the header only."""
    from completion.networks.checkpoint import read_config
    from completion.networks.protocol import most_iterations

    config = read_config(resolve_weights(model))
    if iterations is not None:
        validate_iterations(iterations, most_iterations(config))


def validate_iterations(iterations: int, trained: int) -> None:
    """CompletionError for more iterations than a network was trained for."""
    if iterations > trained:
        raise CompletionError(f"the model was trained for {trained} iterations at most, and {iterations} are asked for")
