"""Showing a finished run to others: the report over HTTP, and a Rerun recording."""

import http.client
import os
import signal
import socket
import subprocess
import sys
import threading
from pathlib import Path
from types import SimpleNamespace
from unittest.mock import MagicMock

import pytest

from haustra.core.errors import HaustraError
from pipeline.cli import main as cli
from pipeline.config import load_config
from pipeline.finished_run import Run
from pipeline.report import rerun_export
from pipeline.report.server import ReportServer, view
from pipeline.run_folder.creating import create_workspace
from tests.helpers.tiny_run import make_tiny_run

REPORT = b"<!doctype html><p>a report"


@pytest.fixture
def run(tmp_path):
    (tmp_path / "a.mp4").write_bytes(b"bytes")
    folder = tmp_path / "run"
    create_workspace(folder, tmp_path / "a.mp4", load_config(None), overwrite=False).lock.release()
    (folder / "report.html").write_bytes(REPORT)
    return folder


@pytest.fixture
def ask(run):
    """Ask a running server; returns (status, body)."""
    server = ReportServer(run / "report.html")
    thread = threading.Thread(target=server.serve_forever, daemon=True)
    thread.start()

    def call(path, method="GET", **headers):
        connection = http.client.HTTPConnection("127.0.0.1", server.server_address[1], timeout=30)
        connection.request(method, path, headers=headers)
        answer = connection.getresponse()
        return answer.status, answer.read()

    yield call
    server.shutdown()
    server.server_close()
    thread.join()


def test_the_report_is_served_and_nothing_else(ask):
    assert ask("/") == (200, REPORT)
    assert ask("/report.html?again") == (200, REPORT)
    assert ask("/", "HEAD") == (200, b"")
    for path in ("/run.yaml", "/../run.yaml", "/report.html/../run.yaml", "//etc/passwd", "/%2e%2e/a.mp4", "/images/"):
        assert ask(path)[0] == 404, path
    assert ask("/", "POST")[0] == 501
    assert ask("/", Host="attacker.example:80")[0] == 403


def test_only_this_machine_is_served(run):
    with ReportServer(run / "report.html") as server:
        assert server.server_address[0] == "127.0.0.1"
        assert server.server_address[1] > 0


def test_a_port_in_use_and_a_run_without_a_report_are_one_sentence(run):
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        with pytest.raises(HaustraError, match="leave --port out"):
            view(run, taken.getsockname()[1], open_browser=False)
    (run / "report.html").unlink()
    with pytest.raises(HaustraError, match="has no report yet"):
        view(run, open_browser=False)


def test_a_browser_that_leaves_in_the_middle_is_no_error(tmp_path, capsys):
    report = tmp_path / "report.html"
    report.write_bytes(b"x" * 20_000_000)  # more than any buffer between the two holds
    with ReportServer(report) as server, socket.create_connection(server.server_address) as browser:
        browser.sendall(b"GET / HTTP/1.1\r\nHost: localhost\r\n\r\n")
        answer = threading.Thread(target=server.process_request_thread, args=server.get_request())
        answer.start()
        assert browser.recv(12) == b"HTTP/1.0 200"
        browser.close()
        answer.join()
        assert capsys.readouterr().err == ""
        try:
            raise KeyError("a bug")
        except KeyError:
            server.handle_error(None, server.server_address)
        assert "a bug" in capsys.readouterr().err


def test_ctrl_c_ends_it_cleanly(run):
    code = "import sys, pipeline.cli.main as cli; sys.argv = ['haustra', *sys.argv[1:]]; cli.main()"
    process = subprocess.Popen(
        [sys.executable, "-c", code, "view", str(run), "--no-browser"],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    address = process.stdout.readline().split()[0]
    port = int(address.rstrip("/").rsplit(":", 1)[1])
    connection = http.client.HTTPConnection("127.0.0.1", port, timeout=30)
    connection.request("GET", "/")
    assert connection.getresponse().read() == REPORT
    process.send_signal(signal.SIGINT)
    _, errors = process.communicate(timeout=60)
    assert process.returncode == 0
    assert errors == ""


def test_recordings_of_two_runs_stay_two(tmp_path, monkeypatch):
    """Rerun's viewer shows recordings of one id as one."""
    (tmp_path / "a.mp4").write_bytes(b"bytes")
    ids = []
    fake = SimpleNamespace(RecordingStream=lambda name, recording_id: ids.append(recording_id) or MagicMock())
    monkeypatch.setattr(rerun_export, "import_rerun", lambda: fake)
    for name, nothing in (("frames", None), ("completed_submaps", []), ("surfaces", [])):
        monkeypatch.setattr(Run, name, nothing)
    for patient in ("one", "two"):
        with create_workspace(tmp_path / patient / "run", tmp_path / "a.mp4", load_config(None), False) as workspace:
            workspace.finish("surface")
    monkeypatch.chdir(tmp_path)
    for run in (tmp_path / "one" / "run", tmp_path / "two" / "run", Path("one/run")):
        rerun_export.export_rerun(run, tmp_path / "out.rrd")
    assert ids[0] == ids[2] != ids[1]
    (tmp_path / "a.mp4").write_bytes(b"another film")
    create_workspace(tmp_path / "one" / "run", tmp_path / "a.mp4", load_config(None), True).finish("surface")
    rerun_export.export_rerun(tmp_path / "one" / "run", tmp_path / "out.rrd")
    assert ids[3] != ids[0]


def test_a_recording_without_the_sdk_is_one_sentence(run, tmp_path, monkeypatch, capsys):
    monkeypatch.setitem(sys.modules, "rerun", None)
    monkeypatch.setattr(sys, "argv", ["haustra", "export", str(run), str(tmp_path / "out.rrd")])
    with pytest.raises(SystemExit) as stop:
        cli.main()
    assert stop.value.code == 1
    assert capsys.readouterr().err == "error: a Rerun recording needs its SDK: pip install 'haustra[rerun]'\n"


def test_a_recording_holds_the_run(tmp_path, monkeypatch):
    pytest.importorskip("rerun", reason="Rerun's SDK is not installed: pip install 'haustra[rerun]'")
    made = make_tiny_run(tmp_path / "tiny", 20, 6)
    made.workspace.finish("surface")
    for name, value in (("frames", made.frames), ("completed_submaps", made.completed), ("surfaces", made.surfaces)):
        monkeypatch.setattr(Run, name, value)
    target = rerun_export.export_rerun(made.workspace.root, tmp_path / "out.rrd")

    def rerun(*words):  # its own reader; at home in this folder, and told to tell nobody
        return subprocess.run(
            [sys.executable, "-m", "rerun_cli", *words],
            env=os.environ | {"HOME": str(tmp_path), "XDG_CONFIG_HOME": str(tmp_path)},
            capture_output=True,
            text=True,
            check=True,
        ).stdout

    rerun("analytics", "disable")
    rerun("rrd", "verify", str(target))
    told = rerun("rrd", "print", str(target))
    for entity in ("submap_0/mesh", "submap_0/path", "submap_1/camera/image", "submap_1/camera/depth"):
        assert entity in told, entity
