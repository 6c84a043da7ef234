"""Answers for the runs of one folder, to this machine alone: pages, their data and pictures, and nothing else."""

import json
from collections.abc import Callable
from functools import cache
from importlib import resources
from pathlib import Path
from urllib.parse import unquote, urlsplit

from haustra.core.errors import HaustraError
from pipeline.report.server import LocalHandler, LocalServer
from pipeline.report.viewer import run_files
from pipeline.report.viewer.run_list import find_runs, rows_of
from pipeline.run_folder.workspace import Workspace

POLICY = (
    "default-src 'none'; script-src 'self'; style-src 'self' 'unsafe-inline'; img-src 'self' data: blob:; "
    "connect-src 'self'; base-uri 'none'; form-action 'none'"
)
PAGES = {"/": "runs.html", "/play": "player.html", "/compare": "compare.html"}
Answer = tuple[bytes, str]  # body and its type


class FolderServer(LocalServer):
    """Serves `folder`; runs are looked for anew at each list, so that new ones appear."""

    def __init__(self, folder: Path, port: int = 0) -> None:
        self.folder = folder
        super().__init__(port, _Handler)

    def answer(self, path: str) -> Answer | None:
        """What a path names; None for nothing."""
        if path in PAGES:
            return _asset("pipeline.report.viewer", PAGES[path]).encode(), "text/html; charset=utf-8"
        if path.startswith("/assets/"):
            return _assets().get(path.removeprefix("/assets/"))
        kind, _, rest = path.lstrip("/").partition("/")
        wanted = _ROUTES.get(kind)
        return None if wanted is None else wanted(self, rest)

    def run(self, name: str) -> Path:
        """The folder of a run of the list; HaustraError for any other name."""
        runs = find_runs(self.folder)
        if name not in runs:
            raise HaustraError(f"no run {name}")
        return runs[name]


def _list(server: FolderServer, _: str) -> Answer:
    rows = [row.to_dict() for row in rows_of(server.folder)]
    return _json({"folder": server.folder.resolve().name, "runs": rows})


def _player(server: FolderServer, name: str) -> Answer:
    return _json(run_files.player_data(server.run(name)))


def _scene(server: FolderServer, name: str) -> Answer:
    return run_files.scene_json(server.run(name)), "application/json"


def _turn(server: FolderServer, names: str) -> Answer:
    first, _, second = names.partition("::")
    return _json(run_files.turn_between(server.run(first), server.run(second)))


def _report(server: FolderServer, name: str) -> Answer:
    return Workspace(server.run(name)).report.read_bytes(), "text/html; charset=utf-8"


def _coverage(server: FolderServer, name: str) -> Answer:
    return Workspace(server.run(name)).coverage.read_bytes(), "image/png"


def _picture(kind: str) -> Callable[[FolderServer, str], Answer]:
    def answer(server: FolderServer, rest: str) -> Answer:
        name, _, number = rest.rpartition("/")
        if not number.isdecimal():
            raise HaustraError("a frame is a number")
        media = "image/jpeg" if kind == "frame" else "image/png"
        return run_files.picture(server.run(name), kind, int(number)), media

    return answer


_ROUTES: dict[str, Callable[[FolderServer, str], Answer]] = {
    "runs": _list,
    "player": _player,
    "scene": _scene,
    "turn": _turn,
    "report": _report,
    "coverage": _coverage,
    "frame": _picture("frame"),
    "depth": _picture("depth"),
    "confidence": _picture("confidence"),
}


def _json(value: object) -> Answer:
    return json.dumps(value, allow_nan=False).encode(), "application/json"


def _asset(package: str, name: str) -> str:
    return (resources.files(package) / name).read_text(encoding="utf-8")


@cache
def _assets() -> dict[str, Answer]:
    """Scripts and style by name; the 3-D view and the colours are the report's."""
    from plotly.offline import get_plotlyjs

    page, viewer = "pipeline.report.page", "pipeline.report.viewer"
    style = _asset(page, "report.css") + _asset(viewer, "viewer.css")
    scripts = {"plotly.js": get_plotlyjs()} | {name: _asset(page, name) for name in ("theme.js", "scene.js")}
    scripts |= {name: _asset(viewer, name) for name in ("common.js", "runs.js", "player.js", "compare.js")}
    made: dict[str, Answer] = {"style.css": (style.encode(), "text/css; charset=utf-8")}
    return made | {name: (text.encode(), "text/javascript; charset=utf-8") for name, text in scripts.items()}


class _Handler(LocalHandler):
    """GET and HEAD of what `FolderServer.answer` knows."""

    server: FolderServer
    policy = POLICY

    def found(self) -> Answer | None:
        try:
            return self.server.answer(unquote(urlsplit(self.path).path))
        except (HaustraError, OSError, KeyError, ValueError):
            return None
