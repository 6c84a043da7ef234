"""The page of a live session, for this machine alone."""

import json
import threading
import webbrowser
from functools import cache
from http import HTTPStatus
from importlib import resources
from urllib.parse import urlsplit

from haustra.core.errors import HaustraError
from pipeline.live.page.live_state import LiveState
from pipeline.report.server import LOOPBACK, LocalHandler, LocalServer

POLICY = (
    "default-src 'none'; script-src 'self'; style-src 'self' 'unsafe-inline'; img-src 'self' data: blob:; "
    "connect-src 'self'; base-uri 'none'; form-action 'none'"
)
POLL_S = 0.05  # how soon the server notices that it is to end
STOP_HEADER = "X-Haustra"  # which a page of another origin cannot send without being asked first
PICTURES = {"frame.jpg": "image/jpeg", "back.jpg": "image/jpeg", "depth.png": "image/png"}
Answer = tuple[bytes, str]


class LivePage(LocalServer):
    """Serves `state` in threads of its own; use it by `with`."""

    def __init__(self, state: LiveState, port: int = 0) -> None:
        self.state = state
        try:
            super().__init__(port, _Handler)
        except (OSError, OverflowError) as error:
            reason = getattr(error, "strerror", None) or str(error)
            raise HaustraError(f"port {port} cannot be used ({reason}); leave --port out for a free one") from error
        self._thread = threading.Thread(target=self.serve_forever, args=(POLL_S,), name="page", daemon=True)

    def show(self, open_browser: bool) -> None:
        """Begin to answer."""
        self._thread.start()
        if open_browser:
            threading.Thread(target=webbrowser.open, args=(self.address,), daemon=True).start()

    def end(self) -> None:
        self.shutdown()
        self._thread.join()
        self.server_close()

    def answer(self, path: str) -> Answer | None:
        """What a path names; None for nothing."""
        if path == "/":
            return _asset("pipeline.live.page", "live.html").encode(), "text/html; charset=utf-8"
        if path == "/state":
            return json.dumps(self.state.to_dict(), allow_nan=False).encode(), "application/json"
        if path.startswith("/assets/"):
            return _assets().get(path.removeprefix("/assets/"))
        if path.startswith("/surface/"):
            number = path.removeprefix("/surface/")
            part = self.state.surface(int(number)) if number.isdecimal() else None
            return None if part is None else (part, "application/octet-stream")
        name = path.lstrip("/")
        coded = self.state.picture(name) if name in PICTURES else None
        return None if coded is None else (coded, PICTURES[name])


def _asset(package: str, name: str) -> str:
    return (resources.files(package) / name).read_text(encoding="utf-8")


@cache
def _assets() -> dict[str, Answer]:
    from plotly.offline import get_plotlyjs

    page = "pipeline.report.page"
    style = _asset(page, "report.css") + _asset("pipeline.live.page", "live.css")
    scripts = {"plotly.js": get_plotlyjs(), "scene.js": _asset(page, "scene.js")}
    scripts |= {name: _asset("pipeline.live.page", name) for name in ("live.js", "live_scene.js")}
    made: dict[str, Answer] = {"style.css": (style.encode(), "text/css; charset=utf-8")}
    return made | {name: (text.encode(), "text/javascript; charset=utf-8") for name, text in scripts.items()}


class _Handler(LocalHandler):
    """GET of what `LivePage.answer` knows, and POST of /stop."""

    server: LivePage
    policy = POLICY

    def found(self) -> Answer | None:
        return self.server.answer(urlsplit(self.path).path)

    def do_POST(self) -> None:
        host = self.headers.get("Host", "").rsplit(":", 1)[0]
        if host not in (LOOPBACK, "localhost") or self.headers.get(STOP_HEADER) != "stop":
            self.send_error(HTTPStatus.FORBIDDEN)
            return
        if self.path != "/stop":
            self.send_error(HTTPStatus.NOT_FOUND)
            return
        self.server.state.stop_asked.set()
        self.send_response(HTTPStatus.NO_CONTENT)
        self.end_headers()
