"""Run a notebook from its beginning and write it with what it showed; the first cell that fails ends it.

python scripts/run_notebook.py notebooks/demo.ipynb build/demo.ipynb
"""

import sys
from pathlib import Path

import nbformat
from nbclient import NotebookClient

SECONDS = 900


def run(source: Path, target: Path) -> None:
    """Execute and write."""
    notebook = nbformat.read(source, as_version=4)
    NotebookClient(notebook, timeout=SECONDS, kernel_name="python3").execute()
    target.parent.mkdir(parents=True, exist_ok=True)
    nbformat.write(notebook, target)


if __name__ == "__main__":
    run(Path(sys.argv[1]), Path(sys.argv[2]))
