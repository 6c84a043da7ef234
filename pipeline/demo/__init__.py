"""The embedded clip: a rendered colon whose path and surface are known, so that the demo can state its own error.

Made by `python -m phantom.demo`; `camera.json`, `trajectory.txt` and `mesh.ply` beside the video are its truth.
"""

from importlib import resources
from pathlib import Path

from haustra.core.progress import Progress
from pipeline.config import Config

FOLDER = Path(str(resources.files("pipeline.demo")))
CAMERA = FOLDER / "camera.json"
VIDEO = FOLDER / "video.mp4"


def run_demo(
    output: Path,
    config: Config,
    *,
    resume: bool = False,
    overwrite: bool = False,
    progress: Progress,
    profile: bool = False,
) -> str:
    """Reconstruct the clip with its own camera and return its errors as text."""
    from pipeline.compare import compare_run
    from pipeline.run import reconstruct

    if config.camera == "auto":
        config = config.model_copy(update={"camera": str(CAMERA)})
    reconstruct(VIDEO, output, config, resume=resume, overwrite=overwrite, progress=progress, profile=profile)
    # Said with the figures: they flatter, as the clip is of the kind that the weights were trained on.
    caution = "in-domain: the clip is rendered by the phantom that trains the weights, and fusion was tuned on it"
    return f"error against the clip's truth:\n{compare_run(output, FOLDER)}\n{caution}\nopen {output / 'report.html'}"
