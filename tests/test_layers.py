"""Imports flow one way, and nothing heavy is imported before a command needs it."""

import ast
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
MAY_IMPORT = {
    "pipeline": {"pipeline", "completion", "reconstruction", "phantom", "compiled"},
    "completion": {"completion", "compiled"},
    "reconstruction": {"reconstruction", "compiled"},
    "phantom": {"phantom"},
    "compiled": {"compiled"},
}


def imported_packages(path: Path) -> set[str]:
    found = set()
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            found |= {alias.name.split(".")[0] for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.level == 0:
            found.add(str(node.module).split(".")[0])
    return found


@pytest.mark.parametrize("package", MAY_IMPORT)
def test_imports_flow_one_way(package):
    files = sorted((ROOT / package).glob("**/*.py"))
    assert files
    for path in files:
        ours = imported_packages(path) & set(MAY_IMPORT)
        assert ours <= MAY_IMPORT[package], f"{path.name} imports {ours - MAY_IMPORT[package]}"


def test_only_the_worker_imports_pycolmap():
    """pycolmap imported before OpenCV makes OpenCV's PNG writer abort; it lives in its own process."""
    users = {p.name for p in (ROOT / "pipeline").glob("**/*.py") if "pycolmap" in imported_packages(p)}
    assert users == {"colmap_worker.py"}


def test_the_command_line_imports_nothing_heavy():
    code = (
        "import sys, pipeline.cli;"
        "heavy = {'torch', 'open3d', 'cv2', 'av', 'matplotlib', 'pycolmap', 'scipy', 'numba'};"
        "sys.exit(sorted(heavy & set(sys.modules)) or 0)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


@pytest.mark.parametrize("package", MAY_IMPORT)
def test_files_stay_short(package):
    for path in (ROOT / package).glob("**/*.py"):
        assert len(path.read_text().splitlines()) <= 300, f"{path} holds more than one idea"
