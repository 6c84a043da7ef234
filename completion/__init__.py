"""LEG 2: image and sparse depth to dense depth and confidence (torch). Imports nothing else of this project."""

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from completion.inference.completer import DepthCompleter as DepthCompleter

__all__ = ["DepthCompleter"]


def __getattr__(name: str) -> Any:
    """`DepthCompleter` on first use: importing torch takes seconds, `--help` should not."""
    if name == "DepthCompleter":
        from completion.inference.completer import DepthCompleter

        return DepthCompleter
    raise AttributeError(f"module 'completion' has no attribute '{name}'")
