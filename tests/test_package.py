"""The package as a whole: types, names, and the same modules and examples inside the executable."""

import ast
import importlib
import inspect
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

import mirrorball

ROOT = Path(__file__).parents[1]
PROGRAM = ROOT / "target/release/mirrorball"
PACKAGE = ROOT / "py/mirrorball"
MODULES = sorted(
    ".".join(path.relative_to(PACKAGE.parent).with_suffix("").parts).removesuffix(".__init__") for path in PACKAGE.rglob("*.py")
)

EXAMPLES: dict[str, list[str | Path]] = {
    "analyse_log": ["{game}", "{out}/analysis"],
    "check_strip": [ROOT / "samples/calibration", "--map", ROOT / "samples/calibration/exact_map.npz"],
    "draw_detections": [ROOT / "samples/sequence", "{out}/drawn"],
    "drive_and_localize": ["--seconds", "1"],
    "label_images": [
        ROOT / "samples/sequence",
        "--box",
        "000.jpg",
        "210",
        "80",
        "230",
        "95",
        "carpet",
        "--out",
        "{out}/labels",
    ],
    "lima2001": ["--out", "{out}/lima2001.png"],
    "minho_like": ["--out", "{out}/minho.png"],
    "measure_pipeline": [ROOT / "samples/sequence", "--rounds", "1"],
    "mirror_from_requirements": ["--out", "{out}/wishes.png"],
    "nubot2013": ["--out", "{out}/nubot.png"],
    "sphere_cone_1999": ["--out", "{out}/sphere.png"],
    "sweep_speeds": ["{out}/speeds", "1", "0.5"],
}


def run(command: list[str | Path], folder: Path) -> str:
    environment = {**os.environ, "VIRTUAL_ENV": sys.prefix, "PYTHONPATH": str(ROOT / "py"), "MPLBACKEND": "agg"}
    done = subprocess.run(command, capture_output=True, text=True, env=environment, cwd=folder, timeout=300)
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_the_site_has_a_page_for_each_module_and_notebook() -> None:
    text = (ROOT / "mkdocs.yml").read_text()
    pages = set(re.findall(r"(?:api|notebooks)/\w+\.md", text))
    modules = {f"api/{name}.md" for name in ("mirrorball", *mirrorball._MODULES)}
    notebooks = {f"notebooks/{path.stem}.md" for path in (ROOT / "py/examples").glob("*.ipynb")}
    assert pages == modules | notebooks


def test_every_module_is_inside_the_executable(tmp_path: Path) -> None:
    script = tmp_path / "script.py"
    script.write_text(
        "import importlib, mirrorball._core\n"
        f"for name in {MODULES}:\n"
        "    print(name, importlib.import_module(name).__spec__.origin)\n"
        "print(mirrorball.Localizer(field=mirrorball.Field()).points(0.0, []).mode)\n"
    )
    found = run([PROGRAM, "script", script], tmp_path).splitlines()
    assert len(MODULES) > 30
    assert [line.split()[0] for line in found[:-1]] == MODULES
    assert all("<mirrorball>/" in line for line in found[:-1])
    assert found[-1] == "lost"


def test_every_example_is_tested() -> None:
    assert {path.stem for path in (ROOT / "py/examples").glob("*.py")} == set(EXAMPLES)


@pytest.mark.parametrize("name", EXAMPLES)
@pytest.mark.parametrize("interpreter", ["python", "script"])
def test_example_runs(name: str, interpreter: str, game: Path, tmp_path: Path) -> None:
    start: list[str | Path] = [sys.executable] if interpreter == "python" else [PROGRAM, "script"]
    arguments = [str(argument).format(game=game, out=tmp_path) for argument in EXAMPLES[name]]
    run([*start, ROOT / f"py/examples/{name}.py", *arguments], tmp_path)


def test_docstrings_of_the_optics_name_arguments_and_frames() -> None:
    found = {}
    for node in ast.parse((PACKAGE / "_core.pyi").read_text()).body:
        if isinstance(node, ast.ClassDef | ast.FunctionDef):
            found[node.name] = ast.get_docstring(node) or ""
    mount = inspect.signature(mirrorball.Mount).parameters
    assert [name for name in mount if f"`{name}`" not in found["Mount"]] == []
    assert "`Estimate.tilt_rad` has the opposite sign" in found["Mount"]
    for name in ("trace_rays", "trace_points", "ground_map"):
        assert "robot frame: x forward, y left" in found[name].lower(), name


def test_stubs_state_the_compiled_half() -> None:
    environment = {**os.environ, "MYPYPATH": str(ROOT / "py"), "PYTHONPATH": str(ROOT / "py")}
    command = [sys.executable, "-m", "mypy.stubtest", "mirrorball._core"]
    done = subprocess.run(command, capture_output=True, text=True, env=environment, cwd=ROOT, timeout=300)
    assert done.returncode == 0, done.stdout


@pytest.mark.parametrize("name", ["user", "mistakes"])
def test_a_users_script_passes_a_strict_type_check(name: str, tmp_path: Path) -> None:
    # `make types` checks user.py with pyright, too.
    script = ROOT / f"tests/typing/{name}.py"
    environment = {**os.environ, "MYPYPATH": str(ROOT / "py")}
    # Errors inside the package are not shown, as of an installed one.
    options = ["--strict", "--config-file=", "--follow-imports=silent"]
    command: list[str | Path] = [sys.executable, "-m", "mypy", *options, script]
    done = subprocess.run(command, capture_output=True, text=True, env=environment, cwd=tmp_path, timeout=300)
    assert done.returncode == 0, done.stdout


@pytest.mark.parametrize("name", [name for name in MODULES if "_worker" not in name])
def test_completion_shows_what_is_meant(name: str) -> None:
    module = importlib.import_module(name)
    assert module.__doc__
    exported = getattr(module, "__all__", None)
    if exported is not None:
        assert all(hasattr(module, each) for each in exported)


def test_completion_of_the_package_shows_modules_and_no_imports() -> None:
    shown = dir(mirrorball)
    assert {"Pipeline", "Localizer", "Simulation", "analysis", "gym", "vision"} <= set(shown)
    assert not {"np", "importlib", "ModuleType", "annotations"} & set(shown)
    assert not {"np", "Path", "Mapping"} & set(dir(mirrorball.vision))
    for name in ("analysis", "gym", "mirror", "sweep"):
        assert importlib.import_module(f"mirrorball.{name}") is getattr(mirrorball, name)
