"""The processes of a batch: how they end, how they are stopped, and that none outlives it."""

import os
import signal
import subprocess
import sys
import threading
import time

import pytest

from pipeline.cli import batch
from pipeline.cli.batch import Job, process_pool, run_job
from pipeline.cli.batch_table import Outcome
from pipeline.run_folder.subprocesses import ChildProcesses
from tests.helpers.processes import alive, wait_for


@pytest.mark.parametrize(
    ("program", "arguments"),
    [
        ("import sys; print('error: no two frames', file=sys.stderr); sys.exit(1)", "no two frames"),
        ("import os; os.kill(os.getpid(), 9)", "ended by SIGKILL; out of memory?"),
        ("raise RuntimeError('a bug')", "RuntimeError: a bug"),
        ("import sys; sys.exit(3)", "exit code 3"),
    ],
)
def test_however_a_process_ends_there_is_one_sentence(tmp_path, monkeypatch, program, arguments):
    monkeypatch.setattr(
        ChildProcesses,
        "run",
        lambda self, _, log: subprocess.run([sys.executable, "-c", program], stderr=log).returncode,
    )
    outcome = run_job(Job(tmp_path / "a.mp4", tmp_path / "a"), [])
    assert outcome.status == "failed"
    assert arguments in outcome.message
    assert "\n" not in outcome.message


def test_stopping_ends_every_child_as_ctrl_c_would(tmp_path):
    script = (
        "import os, sys, time\ntry:\n open(os.path.join(sys.argv[1], str(os.getpid())), 'w').close()\n"
        " time.sleep(600)\n"
        "except KeyboardInterrupt:\n raise SystemExit(130)"
    )
    processes, codes = ChildProcesses(), []
    asleep = tmp_path / "asleep"
    asleep.mkdir()

    with (tmp_path / "log").open("w") as log:
        command = [sys.executable, "-c", script, str(asleep)]
        threads = [
            threading.Thread(target=lambda: codes.append(processes.run(command, log.fileno()))) for _ in range(2)
        ]
        for thread in threads:
            thread.start()
        wait_for(lambda: len(list(asleep.iterdir())) == 2, 60)
        processes.stop()
        for thread in threads:
            thread.join()
        assert processes.run(command, log.fileno()) == -signal.SIGINT  # and none starts any more
    assert len(codes) == 2
    assert set(codes) == {130}


SLEEPER = """
import sys, time
from pathlib import Path
told = Path(sys.argv[3]).with_suffix(".told")
try:
    told.write_text("begun")
    time.sleep(600)
except KeyboardInterrupt:
    told.write_text("interrupted")
    raise SystemExit(130)
"""
BATCH = """
import signal, sys
from pathlib import Path
from pipeline.cli import batch
from pipeline.config import load_config
from haustra.core.progress import SilentProgress
signal.signal(signal.SIGINT, signal.SIG_IGN)  # as a shell does with what runs in the background
batch.MODULE, out = "sleeper", Path(sys.argv[1])
batch.run_batch([out / "b.mp4"], out, [], load_config(None), batch.process_pool(1), SilentProgress())
"""


@pytest.mark.skipif(sys.platform != "linux", reason="only Linux ends a child with its parent")
@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGHUP, signal.SIGKILL])
def test_no_reconstruction_outlives_its_batch(tmp_path, number):
    (tmp_path / "sleeper.py").write_text(SLEEPER)
    environment = os.environ | {"PYTHONPATH": str(tmp_path)}
    process = subprocess.Popen([sys.executable, "-c", BATCH, str(tmp_path)], env=environment, stderr=subprocess.PIPE)
    told = tmp_path / "b.told"
    wait_for(lambda: told.exists() and told.read_text() == "begun")
    process.send_signal(number)
    errors = process.communicate(timeout=60)[1]
    if number == signal.SIGKILL:
        wait_for(lambda: alive(tmp_path) == [])
        return
    assert b"KeyboardInterrupt" in errors
    assert told.read_text() == "interrupted"
    assert alive(tmp_path) == []
    assert "not started" in (tmp_path / "batch.csv").read_text()  # it left no record of a run


def test_the_pool_gives_outcomes_as_they_come(tmp_path, monkeypatch):
    def slow_first(job, arguments, processes):
        time.sleep(0.3 if job.video.name == "a" else 0)
        return Outcome(str(job.video), str(job.folder), "done")

    monkeypatch.setattr(batch, "run_job", slow_first)
    jobs = [Job(tmp_path / name, tmp_path / name) for name in "ab"]
    assert [outcome.video[-1] for outcome in process_pool(2)(jobs, [])] == ["b", "a"]
