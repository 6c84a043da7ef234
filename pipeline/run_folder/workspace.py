"""The run folder: the name of each artefact, and what is done already.

`run.yaml` is the run's memory. A stage is recorded there after its artefacts are whole on disk, so a run that was
stopped anywhere goes on after its last finished stage. Records and depth maps are replaced as wholes; a stage that was
stopped is done again.
"""

import copy
import os
import shutil
import zipfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import yaml

from haustra.core.errors import HaustraError
from haustra.core.text import json_text, write_text
from pipeline.config import Config, read_recorded, retired_differences
from pipeline.run_folder.earlier_run import RECORD_NAME, bring_back, forget, is_kept
from pipeline.run_folder.lock import RunLock

# Of a live session: its record, its recording, and keyframes for its own use.
LIVE_RECORD, LIVE_FILM, LIVE_FOLDER = "live.json", "film.mkv", "live"
FIRST_RESULT = "structure"  # the stage before which a run that was refused is in nobody's way
REFUSED_LOG = "log_refused"  # of a run that was to replace another, and was refused
REFUSED = "refused"  # in the record: the sentence that ended such a run
# Of further submaps, and of COLMAP's database.
FURTHER = ("features.db-*", "mesh_*.ply", "trajectory_*.tum", "keyframes_*.tum", "camera_*.json", "coverage_*.png")
CLEARING = "clearing"  # in the record while what an earlier run left is being removed


class Workspace:
    """Paths of a run folder and its record of finished stages."""

    def __init__(self, root: Path) -> None:
        self.root = root
        self.images = root / "images"
        self.masks = root / "masks"
        self.sensor = root / "sensor"  # depth of a stereo endoscope
        self.log = root / "log"
        self.frames = root / "frames.json"
        self.camera = root / "camera.json"
        self.lens = root / "lens.json"  # of whole pictures as filmed
        self.features = root / "features.db"
        self.models = root / "log" / "models"  # the chosen submaps, in their own units
        self.sparse = root / "sparse"
        self.depth = root / "depth"
        self.confidence = root / "confidence"
        self.first_depth = root / "first_depth"  # depth and confidence that are still to be refined
        self.trajectory = root / "trajectory.tum"
        self.keyframes = root / "keyframes.tum"
        self.mesh = root / "mesh.ply"
        self.mesh_glb = root / "mesh.glb"
        self.coverage = root / "coverage.png"
        self.metrics = root / "metrics.json"
        self.report = root / "report.html"
        self.recording = root / "run.rrd"
        self.record_path = root / RECORD_NAME
        self.record: dict[str, Any] = {"stages": {}}
        self.lock: RunLock | None = None  # held where this process writes
        self.made_anew = ""  # why the surface of a run that is gone on with is made anew; empty where it is not
        self._before: dict[str, Any] | None = None  # the record with the surface that is being replaced

    def __enter__(self) -> "Workspace":
        return self

    def __exit__(self, _: object, error: BaseException | None, __: object) -> None:
        if isinstance(error, HaustraError) and not self.is_done(FIRST_RESULT) and self.record_path.exists():
            with suppress(OSError):  # a full disk may be the reason itself
                self._refuse(error)
        if isinstance(error, HaustraError) and self._before is not None:
            with suppress(OSError):  # the wish was refused, and the surface is still the old one
                self.record = self._before
                self.save()
        if isinstance(error, KeyboardInterrupt | OSError) and self.record_path.exists():
            error.add_note(f"what was finished is kept in {self.root}: the same command with --resume goes on")
        if self.lock is not None:
            self.lock.release()

    def _refuse(self, error: HaustraError) -> None:
        """Bring back the run that was to be replaced, with the logs of the new one beside it if the reason names one;
        or, where there was none, keep the reason."""
        if is_kept(self.root):
            log, reason = self.root / REFUSED_LOG, str(error)
            self.record_path.unlink()  # nothing is written: a full disk may be the reason
            shutil.rmtree(log, ignore_errors=True)
            if str(self.log) in reason:
                os.replace(self.log, log)
            remove_files(self)
            bring_back(self.root)
            error.args = (f"{reason.replace(str(self.log), str(log))}; the earlier run in {self.root} stays as it was",)
            return
        self.record[REFUSED] = str(error)
        self.save()

    def set_aside(self) -> None:
        """Keep the record as it is: where what is asked for now is refused, the run has it again."""
        self._before = copy.deepcopy(self.record)

    def replace_surface(self) -> None:
        """Remove what was written of an older surface; call it before the first file of a new one."""
        self._before = None
        for path in (self.report, self.metrics, self.recording):
            path.unlink(missing_ok=True)

    def undo(self, stages: tuple[str, ...]) -> None:
        """They are no longer done; the record is not written yet."""
        for stage in stages:
            self.record["stages"].pop(stage, None)

    def forget_features(self) -> None:
        """Remove COLMAP's database."""
        for path in self.root.glob(f"{self.features.name}*"):
            path.unlink()

    def image_path(self, index: int) -> Path:
        return self.images / f"{index:06d}.jpg"

    def mask_path(self, index: int) -> Path:
        return self.masks / f"{index:06d}.jpg.png"  # COLMAP's name for the mask of 000000.jpg

    def depth_path(self, index: int, first: bool = False) -> Path:
        return (self.first_depth if first else self.depth) / f"{index:06d}.png"

    def confidence_path(self, index: int, first: bool = False) -> Path:
        return self.first_depth / f"{index:06d}_confidence.png" if first else self.confidence / f"{index:06d}.png"

    def sensor_path(self, index: int) -> Path:
        return self.sensor / f"{index:06d}.png"

    def is_done(self, stage: str) -> bool:
        return stage in self.record["stages"]

    def result(self, stage: str) -> dict[str, Any]:
        """What a finished stage recorded."""
        return self.record["stages"][stage]

    def finish(self, stage: str, **result: Any) -> None:
        """Record a stage as done, with whatever later stages must know."""
        self.record["stages"][stage] = result
        self.save()
        if stage == FIRST_RESULT:
            forget(self.root)

    def save(self) -> None:
        write_text(self.record_path, yaml.safe_dump(self.record, sort_keys=False))

    @property
    def config(self) -> Config:
        return read_recorded(self.record["config"])

    @property
    def retired_settings(self) -> list[str]:
        """Settings of an earlier version by which the run differs from what is fixed today."""
        return retired_differences(self.record["config"])


def open_workspace(root: Path) -> Workspace:
    """An existing run folder."""
    workspace = Workspace(root)
    if not workspace.record_path.exists():
        why = "it has no run.yaml" if root.exists() else "there is no such folder"
        raise HaustraError(f"{root} is not a run folder: {why}")
    try:
        workspace.record = yaml.safe_load(workspace.record_path.read_text())
        workspace.record["stages"], workspace.record["config"], workspace.record["source"]["sha256"]["source"]
    except OSError as error:
        raise HaustraError(f"{workspace.record_path} cannot be read: {error.strerror}") from error
    except (yaml.YAMLError, ValueError, TypeError, KeyError, RecursionError) as error:
        raise HaustraError(f"{workspace.record_path} is damaged; start the run anew with --overwrite") from error
    return workspace


def remove_run(root: Path) -> None:
    """Remove a run of one's own and nothing else that a user may have put there; hold the lock meanwhile."""
    workspace = open_workspace(root)
    workspace.record[CLEARING] = True
    workspace.save()
    clear_if_begun(workspace)
    workspace.record_path.unlink()


def clear_if_begun(workspace: Workspace) -> None:
    """Remove what an earlier run wrote where the record says that this is under way, and nothing else that a user may
    have put there."""
    if CLEARING not in workspace.record:
        return
    remove_files(workspace)
    del workspace.record[CLEARING]
    workspace.save()


def remove_files(workspace: Workspace) -> None:
    """All that a run may have written, but its record."""
    for path in files_of(workspace):
        shutil.rmtree(path) if path.is_dir() else path.unlink(missing_ok=True)


def files_of(workspace: Workspace) -> list[Path]:
    """Files and folders that a run may have written, but its record."""
    named = [path for path in vars(workspace).values() if isinstance(path, Path)]
    further = [path for pattern in FURTHER for path in workspace.root.glob(pattern)]
    return [path for path in (*named, *further) if path not in (workspace.root, workspace.record_path)]


def write_json(path: Path, value: Any) -> None:
    """`value` as JSON, which has no NaN and no infinity: null in their place."""
    write_text(path, json_text(value) + "\n")


@contextmanager
def report_corruption(path: Path) -> Iterator[None]:
    """What goes wrong while reading a run's own file becomes one sentence that names it."""
    try:
        yield
    except (OSError, ValueError, KeyError, TypeError, EOFError, zipfile.BadZipFile) as error:
        raise HaustraError(f"{path} is missing or damaged; start the run anew with --overwrite") from error
