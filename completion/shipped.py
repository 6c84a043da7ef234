"""The models that come with the package, by name."""

from importlib import resources
from pathlib import Path

from completion.errors import CompletionError

# The first is what `reconstruct` uses; the second errs less in the mean where the points' errors are not known, but its
# meshes are mostly worse (docs/completion.md).
MODELS = {"mscsa": "mscsa.safetensors", "mscsa-twice": "mscsa-twice.safetensors"}


def resolve_weights(model: str | Path) -> Path:
    """Path of a shipped model's weights, or of the given file."""
    if str(model) in MODELS:
        return Path(str(resources.files("completion.weights") / MODELS[str(model)]))
    if Path(model).is_file():
        return Path(model)
    raise CompletionError(f"no model '{model}': give a weight file or one of {', '.join(MODELS)}")


def check_weights(model: str | Path) -> None:
    """Refuse a model that cannot be loaded before any work is done; reads the file's header only."""
    from completion.checkpoint import read_metadata

    read_metadata(resolve_weights(model))
