"""The container's contract: films in, a folder for each film and run out, one that fails does not stop the others."""

from __future__ import annotations

from pathlib import Path

import pytest

import pipeline.climb
import pipeline.run
from haustra.core.errors import HaustraError
from pipeline.cli.climb import climb


@pytest.fixture
def calls(monkeypatch: pytest.MonkeyPatch) -> list[tuple[str, int]]:
    made: list[tuple[str, int]] = []

    def reconstruct(film: Path, run: Path, settings) -> None:
        made.append((film.name, settings.seed))
        assert settings.front_end == "odometry"
        if film.stem == "black":
            raise HaustraError("the video is black")

    def write(run: Path, target: Path) -> Path:
        target.mkdir(parents=True)
        (target / "runtime.txt").write_text("init_seconds=0\n")
        return target

    monkeypatch.setattr(pipeline.run, "reconstruct", reconstruct)
    monkeypatch.setattr(pipeline.climb, "write_submission", write)
    return made


def test_every_film_has_its_runs_and_done_ones_are_left_alone(tmp_path: Path, calls: list[tuple[str, int]]) -> None:
    films, output = tmp_path / "input", tmp_path / "output"
    films.mkdir()
    for name in ("a.mp4", "b.mp4", "._a.mp4", "notes.txt"):
        (films / name).touch()
    climb(films, output, runs=5, camera="auto")
    assert calls == [(name, seed) for name in ("a.mp4", "b.mp4") for seed in range(5)]
    made = sorted(path.relative_to(output).as_posix() for path in output.rglob("runtime.txt"))
    assert made == [f"{film}/{run}/runtime.txt" for film in "ab" for run in range(1, 6)]
    (output / "b" / "3" / "runtime.txt").unlink()
    (output / "b" / "3").rmdir()
    calls.clear()
    climb(films, output, runs=5, camera="auto")
    assert calls == [("b.mp4", 2)]


def test_one_that_fails_is_named_and_the_others_are_done(
    tmp_path: Path, calls: list[tuple[str, int]], capsys: pytest.CaptureFixture[str]
) -> None:
    for name in ("black.mp4", "good.mp4"):
        (tmp_path / name).touch()
    with pytest.raises(HaustraError, match="2 of 4 runs failed"):
        climb(tmp_path, tmp_path / "out", runs=2, camera="auto")
    assert "failed: black.mp4, run 1: the video is black" in capsys.readouterr().out
    assert len(list((tmp_path / "out").rglob("runtime.txt"))) == 2


def test_a_folder_without_films_is_one_sentence(tmp_path: Path) -> None:
    with pytest.raises(HaustraError, match=r"holds no \.mp4 file"):
        climb(tmp_path, tmp_path / "out", runs=1, camera="auto")
