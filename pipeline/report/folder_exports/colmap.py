"""COLMAP's folder of undistorted pictures: images/, masks/ and sparse/0 in text and binary. gsplat reads it, too."""

import shutil
from pathlib import Path

from haustra.core.progress import SilentProgress
from pipeline.finished_run import Run
from pipeline.frontend.base import COLMAP_WORKER
from pipeline.input.frames import write_image, write_png
from pipeline.mapping.colmap_io import write_model
from pipeline.report.folder_exports.keyframe_views import empty_folder, pinhole_submap, point_colours, views
from pipeline.run_folder.subprocesses import run_isolated


def export_colmap(run: Run, target: Path) -> Path:
    """Write the keyframes of the run's first submap and its points; returns sparse/0."""
    folder, pictures = empty_folder(target), {}
    (folder / "images").mkdir()
    (folder / "masks").mkdir()
    for view in views(run):
        name = f"{view.number:06d}.jpg"
        write_image(folder / "images" / name, view.rgb)
        write_png(folder / "masks" / f"{name}.png", view.mask)
        pictures[view.number] = view.rgb
    submap, model = pinhole_submap(run), folder / "sparse" / "0"
    write_model(submap, run.completed_submaps[0].camera, model, point_colours(submap, pictures))
    (model / "model.npz").unlink()
    _add_binary(model)
    return model


def _add_binary(model: Path) -> None:
    """By COLMAP itself."""
    scratch = model.parent / "binary"
    job = {"models": [{"source": str(model), "target": str(scratch), "factor": 1.0}]}
    log = model.parent / "binary.log"
    run_isolated(COLMAP_WORKER, "scale", job, log, "binary model", SilentProgress())
    for path in sorted(scratch.glob("*.bin")):
        path.replace(model / path.name)
    shutil.rmtree(scratch)
    for left in model.parent.glob("binary*"):
        left.unlink()
