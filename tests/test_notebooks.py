"""The notebooks run from the first cell to the last: in plain Python, and with nbclient in a kernel."""

import json
from pathlib import Path
from typing import Any

import pytest

from conftest import ROOT

NOTEBOOKS = sorted((ROOT / "py/examples").glob("*.ipynb"))


def run(path: Path) -> dict[str, Any]:
    """Its code cells in one namespace; lines for the notebook alone (%matplotlib) are left out."""
    names: dict[str, Any] = {"__name__": "__main__"}
    for number, cell in enumerate(json.loads(path.read_text())["cells"]):
        if cell["cell_type"] == "code":
            lines = [line if not line.startswith("%") else "\n" for line in cell["source"]]
            exec(compile("".join(lines), f"{path.name}, cell {number}", "exec"), names)
    return names


@pytest.fixture(autouse=True)
def beside(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("MIRRORBALL_HOME", str(ROOT))
    monkeypatch.setenv("SECONDS_OF_PLAY", "2")


def test_mirror_design_notebook_runs(tmp_path: Path) -> None:
    names = run(ROOT / "py/examples/design_a_mirror.ipynb")
    assert names["image"].shape == (480, 480, 3) and names["errors"].count == 50
    assert (tmp_path / "my_own.csv").is_file()


def test_comparison_notebook_runs(tmp_path: Path) -> None:
    names = run(ROOT / "py/examples/compare_two_methods.ipynb")
    ours, theirs = names["runs"].values()
    assert len(ours) == len(theirs) == 60 and ours["true_x_m"].tolist() == theirs["true_x_m"].tolist()
    assert names["largest"] == ours["error_m"].max() and 0.0 < names["apart"]["apart_m"].mean() < 0.5
    assert all((tmp_path / name).is_file() for name in ("both/index.html", "page/index.html", "default.mp4"))


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: str(path.stem))
def test_notebooks_have_no_outputs_and_run_in_a_kernel(path: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    cells = [cell for cell in json.loads(path.read_text())["cells"] if cell["cell_type"] == "code"]
    assert all(cell["outputs"] == [] and cell["execution_count"] is None for cell in cells)
    nbclient, nbformat = pytest.importorskip("nbclient"), pytest.importorskip("nbformat")
    notebook = nbformat.read(path, as_version=4)
    monkeypatch.setenv("PYTHONPATH", str(ROOT / "py"))
    nbclient.NotebookClient(notebook, timeout=300, resources={"metadata": {"path": str(tmp_path)}}).execute()
    drawn = [output for cell in notebook.cells for output in cell.get("outputs", []) if "image/png" in output.get("data", {})]
    assert drawn
