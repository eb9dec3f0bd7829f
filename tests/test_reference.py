"""Each public name has an example in py/examples/reference, which runs. The documentation site shows it below the name."""

import importlib
import json
import re
import shutil
from pathlib import Path
from typing import Any

import pytest

import mirrorball
from conftest import ROOT

REFERENCE = ROOT / "py/examples/reference"
NEEDS = {"bags": "rosbags", "gym": "gymnasium", "vision": "cv2", "pipeline": "cv2"}
"""Packages without which a module's examples are skipped."""


def cells(name: str) -> list[tuple[list[str], str]]:
    """Names and code of each cell."""
    parts = re.split(r"^# %% (.+)$", (REFERENCE / f"{name}.py").read_text(), flags=re.MULTILINE)[1:]
    return [(names.split(", "), code) for names, code in zip(parts[::2], parts[1::2], strict=True)]


@pytest.mark.parametrize("name", ["mirrorball", *mirrorball._MODULES])
def test_each_public_name_has_an_example_that_uses_it(name: str) -> None:
    if name in ("bags", "gym"):
        pytest.importorskip(NEEDS[name])
    module = importlib.import_module("mirrorball" if name == "mirrorball" else f"mirrorball.{name}")
    shown = {each: code for names, code in cells(name) for each in names}
    assert set(shown) == {each for each in module.__all__ if not each.startswith("__")}
    # The import alone is no use.
    unused = [each for each, code in shown.items() if len(re.findall(rf"\b{each}\b", code)) < 2]
    assert unused == []


@pytest.mark.parametrize("name", sorted(path.stem for path in REFERENCE.glob("*.py")))
def test_examples_of_a_module_run(name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    if name in NEEDS:
        pytest.importorskip(NEEDS[name])
    monkeypatch.chdir(tmp_path)
    for folder in ("config", "samples"):
        (tmp_path / folder).symlink_to(ROOT / folder)
    if name == "evaluation":
        shutil.copytree(evaluated(tmp_path), tmp_path / "out/nubot2013")
    if name == "bags":
        write_bag(monkeypatch)
    variables: dict[str, Any] = {"__name__": "__main__"}
    for names, code in cells(name):
        if "write_step" in names:
            pytest.importorskip("OCP")
        exec(compile(code, f"{name}.py: {', '.join(names)}", "exec"), variables)


def evaluated(folder: Path) -> Path:
    """A folder as `mirrorball eval` writes it, with no experiment in it."""
    written = folder / "evaluated"
    written.mkdir()
    about = {"name": "nubot2013", "title": "nubot2013", "source": "", "machine": "", "version": ""}
    (written / "results.json").write_text(json.dumps({**about, "seeds": [1, 2], "differs": [], "parts": []}))
    return written


def write_bag(monkeypatch: pytest.MonkeyPatch) -> None:
    """The bag of the notebook bag_to_poses."""
    from test_notebooks import run

    monkeypatch.setenv("MIRRORBALL_HOME", str(ROOT))
    run(ROOT / "py/examples/bag_to_poses.ipynb")
    shutil.rmtree("recording")
