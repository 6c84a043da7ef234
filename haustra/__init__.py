"""haustra: endoscope video to a coloured colon mesh, camera path, dense depth and coverage, on a CPU.

The public names, each loaded at its first use, so that importing this package takes no time:

- `reconstruct(source, output, config)`: the whole pipeline; returns a `Run`.
- `open_run(folder)`: a finished `Run`: frames, submaps, keyframes, surfaces, coverage, metrics.
- `Config`, `Camera`: settings of the pipeline, and a lens.
- `DepthCompleter`: image and sparse depth to dense depth and confidence.
- `HaustraError`: every known failure, with one sentence that says what to do.
"""

from typing import TYPE_CHECKING

from haustra.core.lazy_names import lazy_names

if TYPE_CHECKING:
    from completion.inference.completer import DepthCompleter as DepthCompleter
    from haustra.core.camera import Camera as Camera
    from haustra.core.errors import HaustraError as HaustraError
    from pipeline.config import Config as Config
    from pipeline.finished_run import Run as Run
    from pipeline.finished_run import open_run as open_run
    from pipeline.run import reconstruct as reconstruct

_MODULE_OF = {
    "Camera": "haustra.core.camera",
    "Config": "pipeline.config",
    "DepthCompleter": "completion.inference.completer",
    "HaustraError": "haustra.core.errors",
    "Run": "pipeline.finished_run",
    "open_run": "pipeline.finished_run",
    "reconstruct": "pipeline.run",
}
__all__ = ["Camera", "Config", "DepthCompleter", "HaustraError", "Run", "open_run", "reconstruct"]
__getattr__ = lazy_names(__name__, _MODULE_OF)
