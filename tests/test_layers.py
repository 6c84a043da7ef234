"""Imports flow one way between packages and between rooms, no file imports in a circle, and nothing heavy is early."""

import ast
import statistics
import subprocess
import sys
from functools import cache
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
PACKAGES = ("pipeline", "completion", "reconstruction", "haustra")
MOST_LINES = 300
MOST_MODULES = 15  # of one folder
MEDIAN_FUNCTION, LONG_FUNCTION = 10, 25  # lines: of the median function, and of the one longer than nine in ten
TREES = (*PACKAGES, "tests", "benchmarks", "scripts")
OF_THE_WHOLE = ("end_to_end", "extending", "pages")  # folders of tests
MOST_LINES_OF_ARCHITECTURE = 150

# Each room may import those on the lines below its own, and itself; rooms on one line do not import each other.
ORDER = """
pipeline.cli
pipeline.doctor
pipeline.demo
pipeline.climb
pipeline.compare
pipeline.truth
pipeline.live
pipeline.run
pipeline.report
pipeline.finished_run
pipeline.surface
pipeline.loop_closing
pipeline.depth
pipeline.frontend
pipeline.mapping
pipeline.matching
pipeline.optimization pipeline.input
pipeline.run_folder
pipeline.config
pipeline.given_settings
pipeline.retired_settings
completion.training completion.evaluation
completion.inference
completion.weights
completion.data
completion.networks
completion.confidence
reconstruction.evaluation
reconstruction.coverage reconstruction.fusion reconstruction.motion
reconstruction.mesh
reconstruction.robust_pose_graph
haustra.phantom
haustra.core
"""
PHANTOM_ORDER = "dataset imaging motion appearance anatomy timeline raycaster noise config"
# What a package may import of the others, whatever the order above would allow.
MAY_IMPORT = {
    "pipeline": {"pipeline", "completion", "reconstruction", "haustra.phantom", "haustra.core"},
    "completion": {"completion", "haustra.core"},
    "reconstruction": {"reconstruction", "haustra.core"},
    "haustra.phantom": {"haustra.phantom", "haustra.core.errors"},
    "haustra.core": {"haustra.core"},
}
LEVEL = {room: level for level, line in enumerate(ORDER.split("\n")) for room in line.split()}


@cache
def modules() -> dict[str, Path]:
    """Name and file of every module of ours."""
    files = [path for package in PACKAGES for path in sorted((ROOT / package).glob("**/*.py"))]
    return {".".join(path.relative_to(ROOT).with_suffix("").parts).removesuffix(".__init__"): path for path in files}


@cache
def imports(module: str) -> frozenset[str]:
    """Modules of ours that one imports anywhere, inside functions too."""
    found = set()
    tree = ast.parse(modules()[module].read_text())
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{module} imports by dots"
            names = {f"{node.module}.{alias.name}" for alias in node.names}
            found |= {name if name in modules() else str(node.module) for name in names}
    return frozenset(found & modules().keys())


def room_of(module: str) -> str:
    return ".".join(module.split(".")[:2])


def is_upward(room: str, other: str) -> bool:
    """Doors, the packages themselves, may import anything of theirs and are imported by nobody inside."""
    if room == other or room in (*PACKAGES, "pipeline.__main__"):
        return False
    return other in PACKAGES or LEVEL[other] <= LEVEL[room]


def is_part(module: str, of: str) -> bool:
    return module == of or module.startswith(of + ".")


@pytest.mark.parametrize("package", MAY_IMPORT)
def test_packages_import_one_way(package):
    mine = [module for module in modules() if is_part(module, package)]
    assert mine
    for module in mine:
        for other in imports(module):
            assert any(is_part(other, allowed) for allowed in MAY_IMPORT[package]), f"{module} imports {other}"


def test_rooms_import_one_way():
    upward = [
        f"{module} imports {other}"
        for module in modules()
        for other in imports(module)
        if is_upward(room_of(module), room_of(other))
    ]
    assert not upward, "\n".join(upward)


def test_every_room_has_its_place():
    """A new room must be entered in ORDER. Package `__init__`s are doors and belong to none."""
    rooms = {room_of(module) for module in modules() if "." in module} - {"pipeline.__main__"}
    assert rooms == set(LEVEL)


def test_the_phantoms_rooms_import_one_way():
    level = {name: k for k, name in enumerate(PHANTOM_ORDER.split())}
    for module in (m for m in modules() if m.startswith("haustra.phantom.")):
        mine = module.split(".")[2]
        theirs = {other.split(".")[2] for other in imports(module) if other.startswith("haustra.phantom.")} - {mine}
        assert all(level[other] > level[mine] for other in theirs), f"{module} imports {theirs}"


def test_no_files_import_in_a_circle():
    """Not even inside functions: what needs that lies in the wrong file."""
    state: dict[str, int] = {}

    def visit(module: str, path: tuple[str, ...]) -> None:
        assert state.get(module) != 1, " -> ".join((*path[path.index(module) :], module))
        if module not in state:
            state[module] = 1
            for other in sorted(imports(module)):
                visit(other, (*path, module))
            state[module] = 2

    for module in modules():
        visit(module, ())


def test_only_the_worker_imports_pycolmap():
    """pycolmap imported before OpenCV makes OpenCV's PNG writer abort; it lives in its own process."""
    users = {module for module, path in modules().items() if "pycolmap" in imported_names(path)}
    assert users == {"pipeline.frontend.colmap.worker"}


def imported_names(path: Path) -> set[str]:
    nodes = list(ast.walk(ast.parse(path.read_text())))
    plain = {alias.name.split(".")[0] for node in nodes if isinstance(node, ast.Import) for alias in node.names}
    return plain | {str(node.module).split(".")[0] for node in nodes if isinstance(node, ast.ImportFrom)}


@pytest.mark.parametrize("door", ["pipeline.cli.main", "haustra", "pipeline", "completion", "reconstruction"])
def test_doors_load_nothing_heavy(door):
    code = (
        f"import sys, {door};"
        "heavy = {'torch', 'open3d', 'cv2', 'av', 'matplotlib', 'pycolmap', 'scipy', 'numba'};"
        "sys.exit(sorted(heavy & set(sys.modules)) or 0)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False, cwd=ROOT)
    assert done.returncode == 0, done.stderr


@pytest.mark.parametrize("tree", TREES)
def test_files_stay_short(tree):
    for path in (ROOT / tree).glob("**/*.py"):
        assert len(path.read_text().splitlines()) <= MOST_LINES, f"{path} holds more than one idea"


@pytest.mark.parametrize("tree", [*PACKAGES, "benchmarks"])
def test_functions_stay_short(tree):
    """The median and the 90th percentile of their lines."""
    functions = [
        node.end_lineno - node.lineno + 1
        for path in (ROOT / tree).glob("**/*.py")
        for node in ast.walk(ast.parse(path.read_text()))
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef)
    ]
    percentiles = statistics.quantiles(functions, n=10)
    assert (percentiles[4] <= MEDIAN_FUNCTION, percentiles[8] <= LONG_FUNCTION) == (True, True), percentiles


def test_the_architecture_is_read_in_one_go():
    assert len((ROOT / "ARCHITECTURE.md").read_text().splitlines()) <= MOST_LINES_OF_ARCHITECTURE


def test_private_names_stay_in_their_module():
    for module, path in modules().items():
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.ImportFrom) and str(node.module).split(".")[0] in PACKAGES:
                private = [a.name for a in node.names if a.name.startswith("_") and not a.name.startswith("__")]
                assert not private, f"{module} imports {private} of {node.module}"


@pytest.mark.parametrize("tree", TREES)
def test_folders_stay_small(tree):
    for folder in [ROOT / tree, *(path for path in (ROOT / tree).glob("**/*") if path.is_dir())]:
        found = [path for path in folder.glob("*.py") if path.name != "__init__.py"]
        assert len(found) <= MOST_MODULES, f"{folder} holds {len(found)} modules"


def test_tests_have_the_tree_of_the_code():
    """Apart from tests of the whole, of docs/extending.md and of rendered pages."""
    for path in (ROOT / "tests").glob("*/**/test_*.py"):
        folder = path.parent.relative_to(ROOT / "tests")
        assert folder.parts[0] in OF_THE_WHOLE or (ROOT / folder).is_dir(), f"{path} tests a folder that there is not"


def test_no_test_imports_another_test_file():
    for path in (ROOT / "tests").glob("**/*.py"):
        for node in ast.walk(ast.parse(path.read_text())):
            names = []
            if isinstance(node, ast.ImportFrom):
                names = [f"{node.module}.{alias.name}" for alias in node.names]
            elif isinstance(node, ast.Import):
                names = [alias.name for alias in node.names]
            parts = [part for name in names if name.startswith("tests.") for part in name.split(".")]
            assert not [part for part in parts if part.startswith("test_")], f"{path} imports {names}"
