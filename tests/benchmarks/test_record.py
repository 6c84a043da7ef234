"""The commit of a record: changed code marks it, other records do not."""

import subprocess
from pathlib import Path

from benchmarks.common import record


def test_records_beside_the_code_do_not_mark_the_commit_as_changed(tmp_path: Path) -> None:
    git = ["git", "-C", str(tmp_path), "-c", "user.name=a", "-c", "user.email=a@b"]
    (tmp_path / "code.py").write_text("1\n")
    for command in (["init", "-q"], ["add", "."], ["commit", "-qm", "first"]):
        subprocess.run([*git, *command], check=True)
    results = tmp_path / "benchmarks/results/paper"
    results.mkdir(parents=True)
    (results / "run.json").write_text("{}\n")
    assert not record.environment(tmp_path)["commit"].endswith("+")
    (tmp_path / "code.py").write_text("2\n")
    assert record.environment(tmp_path)["commit"].endswith("+")
