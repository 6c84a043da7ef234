"""Public names of `reconstruction`, of the phantom, and of their subpackages: few, found, and loaded at first use."""

import subprocess
import sys
from importlib import import_module
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
DOORS = [
    "reconstruction",
    *(f"reconstruction.{room}" for room in ("coverage", "evaluation", "fusion", "mesh", "mesh.formats")),
    "haustra.phantom",
    *(f"haustra.phantom.{room}" for room in ("anatomy", "appearance", "dataset", "imaging", "motion")),
]


@pytest.mark.parametrize("door", DOORS)
def test_public_names_are_few_and_found(door):
    """None is a submodule of the same name, which would hide it."""
    package = import_module(door)
    assert package.__doc__
    assert 1 <= len(package.__all__) <= 8
    for name in package.__all__:
        assert type(getattr(package, name)).__name__ != "module", name
    with pytest.raises(AttributeError, match="no attribute"):
        package.nothing_of_this_name  # noqa: B018


def test_importing_all_doors_loads_nothing_heavy():
    code = (
        f"import sys, {', '.join(DOORS)};"
        "heavy = {'torch', 'open3d', 'cv2', 'av', 'matplotlib', 'scipy', 'numba', 'trimesh'};"
        "sys.exit(sorted(heavy & set(sys.modules)) or 0)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False, cwd=ROOT)
    assert done.returncode == 0, done.stderr
