"""Names and files of the weights that come with the package, and validation of a model before any work."""

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
