"""Video to sparse depth, and the whole reconstruction: stages, run folder, commands."""

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from pipeline.run import reconstruct as reconstruct

__all__ = ["reconstruct"]


def __getattr__(name: str) -> Any:
    """`reconstruct` on first use, so that `--help` does not import torch."""
    if name == "reconstruct":
        from pipeline.run import reconstruct

        return reconstruct
    raise AttributeError(f"module 'pipeline' has no attribute '{name}'")
