"""Run a module in a process of its own, with progress, a log file, and a clean stop."""

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

from pipeline.errors import HaustraError
from pipeline.progress import Progress


def run_isolated(module: str, action: str, job: dict[str, Any], log: Path, label: str, progress: Progress) -> None:
    """`python -m module action job.json`; raises `HaustraError` naming the log if it fails.

    The child writes "done total" lines to standard output. On Ctrl-C it is killed before the interrupt goes on.
    """
    job_file = log.with_suffix(".job.json")
    job_file.write_text(json.dumps(job, indent=1))
    with log.open("w") as errors, progress.bar(label, None) as advance:
        # -P: the working directory must not shadow installed packages.
        command = [sys.executable, "-P", "-m", module, action, str(job_file)]
        child = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=errors, text=True, start_new_session=True)
        try:
            assert child.stdout is not None
            for line in child.stdout:
                words = line.split()
                if len(words) == 2 and all(word.isdigit() for word in words):
                    advance(int(words[0]), int(words[1]))
            code = child.wait()
        except BaseException:
            child.kill()
            child.wait()
            raise
    if code != 0:
        raise HaustraError(f"{label} failed (exit code {code}); its log is {log}")
