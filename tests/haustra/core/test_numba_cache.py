"""Compiled functions are kept on disk, and nothing about the disk can stop or falsify them."""

import ast
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[3]
MODULE = "from haustra.core.numba_cache import compiled\n\n\n@compiled\ndef times(x):\n    return x * {factor}\n"
CALL = """
import resource
{before}
import made
print(made.times(2.0), sum(made.times.stats.cache_hits.values()))
"""


def run(folder: Path, factor: int, before: str = "") -> list[str]:
    """What the function of a module with that factor gives in a process of its own, and how often it was kept."""
    (folder / "made.py").write_text(MODULE.format(factor=factor))
    environment = {"PYTHONPATH": f"{folder}:{ROOT}", "HOME": str(folder), "PATH": ""}
    done = subprocess.run(
        [sys.executable, "-B", "-c", CALL.format(before=before)],
        cwd=folder, env=environment, capture_output=True, text=True, timeout=120, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    return done.stdout.split()


def test_it_is_compiled_once_and_anew_when_the_source_changes(tmp_path):
    assert run(tmp_path, 3) == ["6.0", "0"]
    assert run(tmp_path, 3) == ["6.0", "1"]
    assert run(tmp_path, 5) == ["10.0", "0"]


def test_a_disk_that_is_full_between_index_and_code_leaves_no_old_code_behind(tmp_path):
    """The index is small enough to be written, the code is not."""
    assert run(tmp_path, 3) == ["6.0", "0"]
    limit = "resource.setrlimit(resource.RLIMIT_FSIZE, (2048, 2048))"
    assert run(tmp_path, 7, before=limit) == ["14.0", "0"]
    assert run(tmp_path, 7)[0] == "14.0"


def test_damaged_files_are_compiled_anew(tmp_path):
    run(tmp_path, 3)
    kept = [path for path in tmp_path.rglob("*") if path.suffix in {".nbi", ".nbc"}]
    assert len(kept) == 2
    for path in kept:
        path.write_bytes(b"")
    assert run(tmp_path, 3) == ["6.0", "0"]


def test_where_nothing_can_be_kept_it_is_compiled_all_the_same(tmp_path):
    before = "import numba.core.caching as c; c.CompileResultCacheImpl._locator_classes = []"
    assert run(tmp_path, 3, before) == ["6.0", "0"]
    assert run(tmp_path, 3, before) == ["6.0", "0"]


def names_in(node: ast.AST) -> set[str]:
    return {part.id for part in ast.walk(node) if isinstance(part, ast.Name)}


def is_compiled(node: ast.stmt) -> bool:
    return isinstance(node, ast.FunctionDef) and any("compiled" in names_in(made) for made in node.decorator_list)


USERS = [
    path
    for package in ("pipeline", "completion", "reconstruction", "haustra")
    for path in sorted((ROOT / package).glob("**/*.py"))
    if "from haustra.core.numba_cache import" in path.read_text()
]


@pytest.mark.parametrize("path", USERS, ids=lambda path: path.stem)
def test_nothing_compiled_uses_what_another_file_says(path):
    """A change there would not be noticed: what is kept bears the hash of its own file alone."""
    tree = ast.parse(path.read_text())
    imported = {
        alias.asname or alias.name
        for node in ast.walk(tree)
        if isinstance(node, ast.ImportFrom)
        and str(node.module).split(".")[0] in {"completion", "reconstruction", "pipeline", "haustra"}
        for alias in node.names
    }
    assigned = {
        name: names_in(node.value)
        for node in tree.body
        if isinstance(node, ast.Assign)
        for target in node.targets
        for name in names_in(target)
    }
    foreign = imported | {name for name, given in assigned.items() if given & imported}
    loops = [node for node in tree.body if is_compiled(node)]
    assert loops
    for loop in loops:
        used = set().union(*(names_in(statement) for statement in loop.body))
        assert not used & foreign, f"{loop.name} must be given {used & foreign}"
