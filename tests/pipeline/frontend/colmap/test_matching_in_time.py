"""Matching ends in the time that it has, with the pairs of neighbours first."""

import json

import pytest

from haustra.core.progress import SilentProgress
from pipeline.frontend.colmap import front_end, worker
from pipeline.frontend.colmap.pairs import sequential_pairs

NAMES = [f"{number:06d}.jpg" for number in range(60)]


class Clock:
    """Each batch of pairs takes a second."""

    def __init__(self):
        self.now = 100.0

    def monotonic(self):
        return self.now


@pytest.mark.parametrize(("until_s", "batches"), [(None, 20), (0.5, 1), (7.5, 8), (1000, 20), (-3, 0)])
def test_matching_ends_in_time(tmp_path, monkeypatch, until_s, batches):
    clock, done = Clock(), []

    def match(_, pairs):
        clock.now += 1
        done.extend(pairs)

    for name in ("_register", "_extract", "_descriptors"):
        monkeypatch.setattr(worker, name, lambda *_: None)
    monkeypatch.setattr(worker, "loops_to_try", lambda *_: [])
    monkeypatch.setattr(worker, "_match", match)
    monkeypatch.setattr(worker, "time", clock)
    job = {"seed": 0, "images": NAMES, "overlap": 8, "scratch": str(tmp_path)}
    worker.extract_and_match(job if until_s is None else job | {"matching_until_s": until_s})
    pairs = sequential_pairs(NAMES, 8)
    told = json.loads((tmp_path / "matched.json").read_text())
    assert told == {"matched": len(done), "pairs": len(pairs)}
    assert done == pairs[: len(done)]
    assert len(done) == pytest.approx(len(pairs) * batches / 20, abs=20)


class Heard(SilentProgress):
    def __init__(self):
        self.said = []

    def log(self, text):
        self.said.append(text)


def test_what_was_not_matched_is_said(tmp_path):
    heard, path = Heard(), tmp_path / "matched.json"
    front_end._say_what_was_matched(path, heard)
    for matched in (500, 300):
        path.write_text(json.dumps({"matched": matched, "pairs": 500}))
        front_end._say_what_was_matched(path, heard)
    assert heard.said == ["of 500 pairs of frames 300 were matched in the time, neighbours first; these are mapped"]
