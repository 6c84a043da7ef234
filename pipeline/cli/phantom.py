"""`haustra phantom`: from options to folders of RGB-D video with truth, training frames or a gallery."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

from haustra.core.errors import HaustraError
from haustra.core.progress import Progress
from haustra.phantom.config import EventsConfig, PhantomConfig
from haustra.phantom.dataset.checks import check
from haustra.phantom.dataset.generate import FILES, RECORDS, clear, generate, is_begun, is_finished
from haustra.phantom.dataset.scenes import film_of, scene_config
from haustra.phantom.dataset.suite import config_from, load_suite, read_settings
from haustra.phantom.motion.recorded_path import read_recording
from haustra.phantom.timeline import frames_needed

OURS = {*FILES, *RECORDS, "rgb", "depth", "mesh.ply.partial"}  # what a film's folder holds
EVENT_ROOM = 1.4  # a film with --events is at least this much longer than its events


@dataclass(frozen=True)
class PhantomOptions:
    """What the command line says; None leaves the scene's own value."""

    scene: str | None = None
    seed: int | None = None
    frames: int | None = None
    size: int | None = None
    motion: str | None = None
    events: bool = False
    config: Path | None = None


def chosen_config(options: PhantomOptions) -> PhantomConfig:
    """The config file's values, or the scene's, with the options on top."""
    values = read_settings(options.config) if options.config else {}
    for name in ("scene", "seed"):
        if getattr(options, name) is not None:
            values[name] = getattr(options, name)
    config, frames = config_from(values), options.frames
    if options.events:
        config = replace(config, events=EventsConfig(1, 1, 1, 1, 1))
        if frames is None:
            frames = max(config.motion.frames, math.ceil(EVENT_ROOM * frames_needed(config.motion, config.events)))
    return film_of(config, frames, options.size, options.motion)


def render(
    sequences: Mapping[Path, PhantomConfig], progress: Progress, overwrite: bool = False, recordings: Path = Path()
) -> list[Path]:
    """Film each config into its folder; finished ones are left as they are. Returns the folders in order.

    `recordings` is the folder of the recorded camera paths that configs name.
    """
    for folder, config in sequences.items():
        check(config)
        if config.motion.recording:
            read_recording(recordings / config.motion.recording)
        if not is_finished(folder, config):
            _refuse_foreign_files(folder, config, overwrite)
    for folder, config in sequences.items():
        if is_finished(folder, config) and not overwrite:
            progress.log(f"{folder}: already there, left as it is")
            continue
        clear(folder)
        progress.log(f"{folder.name}: growing {config.anatomy.length_mm:.0f} mm of gut, seed {config.seed}")
        with progress.bar(folder.name, config.motion.frames) as advance:
            generate(config, folder, progress=advance, recordings=recordings)
    return list(sequences)


def suite_folders(out: Path, file: Path) -> dict[Path, PhantomConfig]:
    """The sequences of a file like suite.yaml, each in a folder of its own."""
    return {out / name: config for name, config in load_suite(file).items()}


def render_training(out: Path, frames: int, options: PhantomOptions, workers: int, progress: Progress) -> Path:
    """Random phantoms' single frames as memory-mappable arrays, for `completion.training.train`."""
    from haustra.phantom.dataset.shards import ShardPlan, write_shards

    if options.frames or options.motion or options.events or options.config:
        raise HaustraError("--training takes --scene, --seed, --size and --workers only: its phantoms are drawn")
    if options.scene is not None:
        scene_config(options.scene)
    if out.exists() and any(out.iterdir()) and not (out / "images.npy").exists():
        raise HaustraError(f"{out} holds something else; give another folder")
    if (out / "shards.json").exists():
        raise HaustraError(f"{out} already holds training frames; give another folder")
    plan = ShardPlan(out, frames, options.size or 192, options.seed or 0, options.scene)
    with progress.bar("training frames", frames) as advance:
        write_shards(plan, workers, advance)
    return out


def _refuse_foreign_files(folder: Path, config: PhantomConfig, overwrite: bool) -> None:
    """An unfinished film of the same phantom is begun anew; another film goes with --overwrite; the rest never."""
    standing = next((path for path in (folder, *folder.parents) if path.exists()), folder)
    if not standing.is_dir():
        raise HaustraError(f"{standing} is a file; give a folder")
    if not folder.exists() or not any(folder.iterdir()) or is_begun(folder, config):
        return
    if foreign := [path.name for path in sorted(folder.iterdir()) if path.name not in OURS]:
        raise HaustraError(f"{folder} holds something else ({foreign[0]}); give another folder")
    if not overwrite:
        raise HaustraError(f"{folder} holds another film; give another folder, or --overwrite")
