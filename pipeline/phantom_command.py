"""`haustra phantom`: from options to folders of RGB-D video with truth, training frames or a gallery."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

from phantom.config import EventsConfig, PhantomConfig
from phantom.generate import clear, generate, is_finished
from phantom.scenes import film_of
from phantom.suite import config_from, load_suite, read_settings
from pipeline.errors import HaustraError
from pipeline.progress import Progress


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
    config = film_of(config_from(values), options.frames, options.size, options.motion)
    if options.events:
        config = replace(config, events=EventsConfig(1, 1, 1, 1, 1))
    return config


def render(sequences: Mapping[Path, PhantomConfig], progress: Progress, overwrite: bool = False) -> list[Path]:
    """Film each config into its folder; finished ones are left as they are. Returns the folders in order."""
    for folder, config in sequences.items():
        if not overwrite and not is_finished(folder, config):
            _refuse_strangers(folder, config)
    for folder, config in sequences.items():
        if is_finished(folder, config) and not overwrite:
            progress.say(f"{folder}: already there, left as it is")
            continue
        clear(folder)
        with progress.bar(folder.name, config.motion.frames) as advance:
            generate(config, folder, progress=advance)
    return list(sequences)


def suite_folders(out: Path) -> dict[Path, PhantomConfig]:
    """The five evaluation sequences, each in a folder of its own."""
    return {out / name: config for name, config in load_suite().items()}


def render_training(out: Path, frames: int, options: PhantomOptions, workers: int, progress: Progress) -> Path:
    """Random phantoms' single frames as memory-mappable arrays, for `completion.train`."""
    from phantom.shards import ShardPlan, write_shards

    if options.frames or options.motion or options.events or options.config:
        raise HaustraError("--training takes --scene, --seed, --size and --workers only: its phantoms are random")
    if (out / "shards.json").exists():
        raise HaustraError(f"{out} already holds training frames; give another folder")
    plan = ShardPlan(out, frames, options.size or 192, options.seed or 0, options.scene)
    with progress.bar("training frames", frames) as advance:
        write_shards(plan, workers, advance)
    return out


def _refuse_strangers(folder: Path, config: PhantomConfig) -> None:
    """An unfinished film of the same phantom is begun anew; anything else is not ours to replace."""
    if not folder.exists():
        return
    if not folder.is_dir():
        raise HaustraError(f"{folder} is a file; give a folder")
    if any(folder.iterdir()) and not _same_phantom(folder, config):
        raise HaustraError(f"{folder} holds something else; give another folder, or --overwrite")


def _same_phantom(folder: Path, config: PhantomConfig) -> bool:
    record = folder / "config.yaml"
    return record.exists() and PhantomConfig.from_dict(read_settings(record)) == config
