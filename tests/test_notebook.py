"""The notebook is stored without what it showed, and runs from its beginning."""

from pathlib import Path

import nbformat
import pytest

from scripts.run_notebook import run

NOTEBOOK = Path(__file__).parents[1] / "notebooks/demo.ipynb"


def test_the_notebook_is_stored_bare():
    notebook = nbformat.read(NOTEBOOK, as_version=4)
    nbformat.validate(notebook)
    assert all(not cell.get("outputs") and cell.get("execution_count") is None for cell in notebook.cells)


def test_a_cell_that_fails_ends_it(tmp_path):
    notebook = nbformat.v4.new_notebook(cells=[nbformat.v4.new_code_cell("raise ValueError('of the test')")])
    nbformat.write(notebook, tmp_path / "bad.ipynb")
    with pytest.raises(Exception, match="of the test"):
        run(tmp_path / "bad.ipynb", tmp_path / "made.ipynb")
    assert not (tmp_path / "made.ipynb").exists()


@pytest.mark.slow
def test_the_notebook_runs_and_shows_its_figures(tmp_path):
    run(NOTEBOOK, tmp_path / "made" / "demo.ipynb")
    cells = nbformat.read(tmp_path / "made" / "demo.ipynb", as_version=4).cells
    shown = [output for cell in cells for output in cell.get("outputs", []) if "image/png" in output.get("data", {})]
    assert len(shown) == 2
