"""Open3D is loaded although another thread loads something else at the same time."""

import subprocess
import sys

import pytest

# As its own: it goes through the loaded modules, and Python stops it where their number changes meanwhile.
PACKAGE = """
import sys
for number, name in enumerate(sys.modules):
    if number == 0 and sys.tries < {failures}:
        sys.tries += 1
        sys.modules[f"loaded by another thread {{sys.tries}}"] = sys
"""
CODE = """
import sys
sys.tries = 0
sys.path.insert(0, sys.argv[1])
from reconstruction.mesh.open3d_import import import_open3d
print(import_open3d().__file__, sys.tries)
"""


@pytest.mark.parametrize(("failures", "ends"), [(0, 0), (3, 0), (10_000, 1)])
def test_a_module_that_another_thread_loads_meanwhile_stops_no_run(tmp_path, failures, ends):
    (tmp_path / "open3d").mkdir()
    (tmp_path / "open3d" / "__init__.py").write_text(PACKAGE.format(failures=failures))
    done = subprocess.run([sys.executable, "-c", CODE, str(tmp_path)], capture_output=True, text=True)
    assert done.returncode == ends, done.stderr
    if ends:
        assert "dictionary changed size during iteration" in done.stderr
    else:
        assert done.stdout.split() == [str(tmp_path / "open3d" / "__init__.py"), str(failures)]
