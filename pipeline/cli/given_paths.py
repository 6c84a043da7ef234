"""A mistyped name is answered at once: these checks come before the packages that would read the file are loaded."""

from pathlib import Path

from haustra.core.errors import HaustraError

# As `live_film.SCHEMES`, whose module is too slow to load for a refusal.
STREAMS = ("rtsp", "rtsps", "rtp", "udp", "tcp", "srt", "http", "https")


def must_exist(*paths: Path | str | None) -> None:
    """HaustraError for the first that is not there; None is one that was not given."""
    for path in paths:
        if path is not None and not Path(path).exists():
            advice = "; a stream is taken by haustra live" if str(path).split(":")[0] in STREAMS else ""
            raise HaustraError(f"there is no file or folder {path}{advice}")


def no_empty_words(words: list[str]) -> None:
    """HaustraError for an empty word of the command line: as a path it would be the current folder."""
    for before, word in zip(["", *words], words, strict=False):
        if not word or (word.startswith("--") and word.endswith("=")):
            which = f"what follows {before}" if word == "" and before.startswith("-") else word or "a path"
            raise HaustraError(
                f"{which} is empty on the command line, as a shell's variable without a value is; the current folder "
                "is written as a dot"
            )


def must_match(*patterns: Path) -> None:
    """HaustraError for a pattern that a shell hands on because no name matches it."""
    for pattern in patterns:
        if "*" in pattern.name and not pattern.exists():
            raise HaustraError(f"no file or folder matches {pattern}")


def must_be_run(folder: Path) -> None:
    """HaustraError where a folder holds no record of a run."""
    must_exist(folder)
    if not (folder / "run.yaml").is_file():
        raise HaustraError(f"{folder} is not a run folder: it has no run.yaml")


def must_be_outside(target: Path, run: Path) -> None:
    """HaustraError for a file or folder to write that lies in the run folder, whose own files it could replace."""
    if target.resolve().is_relative_to(run.resolve()):
        raise HaustraError(
            f"{target} is inside the run folder {run}, whose files are the run's own; write it elsewhere"
        )


def must_be_no_folder(target: Path | None) -> None:
    """HaustraError where a file to write is a folder already; None is one that was not given."""
    if target is not None and target.is_dir():
        raise HaustraError(f"{target} is a folder; give the name of a file to write")


def must_have_folder(target: Path | None) -> None:
    """HaustraError where the folder of a file to write is not there; None is one that was not given."""
    if target is not None and not target.parent.is_dir():
        raise HaustraError(f"there is no folder {target.parent} to write {target.name} into")


def must_be_named_or_exist(option: str, choice: str | None) -> None:
    """HaustraError for a choice that is neither the name of something known, which holds no dot and no slash, nor a
    file."""
    if choice is not None and ("/" in choice or "." in choice) and not Path(choice).exists():
        raise HaustraError(f"{option}: there is no file {choice}")
