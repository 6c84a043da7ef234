"""Sentences of a run: one that a repeated step says again is said once."""

from contextlib import nullcontext
from typing import Any

from haustra.core.progress import SaidOnce


class _Heard:
    def __init__(self) -> None:
        self.sentences: list[str] = []

    def bar(self, label: str, total: int | None) -> Any:
        return nullcontext(f"{label} of {total}")

    def log(self, sentence: str) -> None:
        self.sentences.append(sentence)


def test_sentence_is_said_once_and_bars_pass() -> None:
    heard = _Heard()
    progress = SaidOnce(heard)
    for sentence in ("too few features", "43 keyframes", "too few features"):
        progress.log(sentence)
    assert heard.sentences == ["too few features", "43 keyframes"]
    with progress.bar("odometry", 7) as bar:
        assert bar == "odometry of 7"


def test_another_run_says_it_again() -> None:
    heard = _Heard()
    for _ in range(2):
        SaidOnce(heard).log("too few features")
    assert heard.sentences == ["too few features"] * 2
