"""The notebooks run from the first cell to the last: in plain Python, and with nbclient in a kernel."""

import json
import re
from pathlib import Path
from typing import Any

import numpy as np
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


def test_calibration_notebook_finds_the_map_but_for_its_zero() -> None:
    pytest.importorskip("cv2")
    names = run(ROOT / "py/examples/calibrate_your_camera.ipynb")
    before, after = names["error_m"](names["start"]), names["error_m"](names["found"], names["shift"])
    assert before[4] > 0.3 and after[4] < 0.02
    assert np.nanmedian(names["errors_m"]("right.npz")) < 0.02


def test_bag_notebook_has_a_pose_for_every_image() -> None:
    pytest.importorskip("rosbags", reason="the package rosbags is not installed (requirements.txt)")
    names = run(ROOT / "py/examples/bag_to_poses.ipynb")
    assert len(names["found"]) == 20 and np.median(names["errors"]) < 0.02


def test_covariance_notebook_has_a_row_for_each_run(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("SECONDS_OF_PLAY", "0.5")
    table = run(ROOT / "py/examples/how_honest_is_the_covariance.ipynb")["table"]
    assert len(table) == 6 and table["in 95 % ellipse"].between(0.0, 1.0).all() and (table["NEES"] > 0.0).all()


def test_sweep_notebook_computes_no_run_twice(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("SECONDS_OF_PLAY", "0.5")
    names = run(ROOT / "py/examples/sweep_on_a_cluster.ipynb")
    assert len(names["found"]) == 9 and names["again"].equals(names["found"])


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: str(path.stem))
def test_committed_notebook_shows_small_outputs_of_no_machine(path: Path) -> None:
    text = path.read_text()
    assert len(text.encode()) < 300_000 and not re.search(r"/(home|root|tmp|work|Users)/", text)
    cells = [cell for cell in json.loads(text)["cells"] if cell["cell_type"] == "code"]
    # Every cell was run, in order, and none with an error.
    assert [cell["execution_count"] for cell in cells] == list(range(1, len(cells) + 1))
    outputs = [output for cell in cells for output in cell["outputs"]]
    assert any("image/png" in output.get("data", {}) for output in outputs)
    assert all(output["output_type"] != "error" for output in outputs)


# The others run here in plain Python alone: the documentation site runs all of them in a kernel.
@pytest.mark.parametrize("name", ["design_a_mirror", "compare_two_methods"])
def test_notebook_runs_in_a_kernel(name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    nbclient, nbformat = pytest.importorskip("nbclient"), pytest.importorskip("nbformat")
    notebook = nbformat.read(ROOT / f"py/examples/{name}.ipynb", as_version=4)
    monkeypatch.setenv("PYTHONPATH", str(ROOT / "py"))
    nbclient.NotebookClient(notebook, timeout=300, resources={"metadata": {"path": str(tmp_path)}}).execute()
    drawn = [output for cell in notebook.cells for output in cell.get("outputs", []) if "image/png" in output.get("data", {})]
    assert drawn
