"""`haustra view RUN`: the report in a browser, served to this machine alone."""

import errno
import sys
import threading
import webbrowser
from collections.abc import Callable
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any

from haustra.core.errors import HaustraError
from pipeline.run_folder.workspace import open_workspace

LOOPBACK = "127.0.0.1"


class LocalServer(ThreadingHTTPServer):
    """Listens to this machine alone."""

    daemon_threads = True

    def __init__(self, port: int, handler: "type[LocalHandler]") -> None:
        super().__init__((LOOPBACK, port), handler)

    @property
    def address(self) -> str:
        return f"http://{LOOPBACK}:{self.server_address[1]}/"

    def handle_error(self, request: Any, client_address: Any) -> None:
        """A browser that leaves in the middle of the page is no error."""
        if not isinstance(sys.exc_info()[1], ConnectionError):
            super().handle_error(request, client_address)


class LocalHandler(BaseHTTPRequestHandler):
    """GET and HEAD of what `found` gives: body and type, None for what is not there."""

    server_version = "haustra"
    sys_version = ""
    policy = ""  # of content security, for pages that have none inside

    def found(self) -> tuple[bytes, str] | None:
        raise NotImplementedError

    def do_GET(self) -> None:
        self._answer(with_body=True)

    def do_HEAD(self) -> None:
        self._answer(with_body=False)

    def _answer(self, with_body: bool) -> None:
        # Another name for this machine in Host would be a foreign page that reads the report through its own name.
        host = self.headers.get("Host", "").rsplit(":", 1)[0]
        if host not in (LOOPBACK, "localhost"):
            self.send_error(HTTPStatus.FORBIDDEN)
            return
        answer = self.found()
        if answer is None:
            self.send_error(HTTPStatus.NOT_FOUND)
            return
        body, media = answer
        self.send_response(HTTPStatus.OK)
        self.send_header("Content-Type", media)
        self.send_header("Content-Length", str(len(body)))
        self.send_header("Cache-Control", "no-store")
        self.send_header("X-Content-Type-Options", "nosniff")
        if self.policy and not self.path.startswith("/report/"):  # the report has its own
            self.send_header("Content-Security-Policy", self.policy)
        self.end_headers()
        if with_body:
            self.wfile.write(body)

    def log_message(self, *_: object) -> None:
        """The terminal is for the address alone."""


class ReportServer(LocalServer):
    """Answers for one file: the report, which names no others. The rest of the folder is nobody's business."""

    def __init__(self, report: Path, port: int = 0) -> None:
        self.report = report
        super().__init__(port, _Handler)


class _Handler(LocalHandler):
    """`/` and `/report.html`."""

    server: ReportServer

    def found(self) -> tuple[bytes, str] | None:
        if self.path.split("?")[0] not in ("/", "/report.html"):
            return None
        try:
            return self.server.report.read_bytes(), "text/html; charset=utf-8"
        except OSError:
            return None


def view(run: Path, port: int = 0, open_browser: bool = True, say: Callable[[str], None] = print) -> None:
    """Serve a run's report until Ctrl-C; port 0 takes a free one."""
    workspace = open_workspace(run)
    if not workspace.report.exists():
        raise HaustraError(f"the run {run} has no report yet; go on with it by --resume")
    serve(lambda: ReportServer(workspace.report, port), port, str(workspace.report), open_browser, say)


def serve(
    make: Callable[[], LocalServer], port: int, shown: str, open_browser: bool, say: Callable[[str], None]
) -> None:
    """Serve until Ctrl-C; HaustraError where the port cannot be had."""
    try:
        server = make()
    except OverflowError as error:
        raise HaustraError(f"there is no port {port}") from error
    except OSError as error:
        if error.errno not in (errno.EADDRINUSE, errno.EACCES):
            raise
        raise HaustraError(f"port {port} cannot be used ({error.strerror}); leave --port out for a free one") from error
    with server:
        say(f"{server.address} shows {shown}; Ctrl-C ends it")
        if open_browser:
            threading.Thread(target=webbrowser.open, args=(server.address,), daemon=True).start()
        try:
            server.serve_forever()
        except KeyboardInterrupt:
            say("")  # ends the line of the terminal's ^C
