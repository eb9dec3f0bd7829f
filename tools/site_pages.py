"""Pages of the documentation site that are generated: the start page, command line, Python API and executed notebooks.

A hook of MkDocs (mkdocs.yml). The command line's help comes from target/release/mirrorball. The notebooks are executed here, so
that their pictures are those of the present code.
"""

from __future__ import annotations

import ast
import base64
import json
import os
import re
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

from mkdocs.structure.files import File, Files

ROOT = Path(__file__).parents[1]
PROGRAM = ROOT / "target/release/mirrorball"
NOTEBOOKS = tuple(sorted(path.stem for path in (ROOT / "py/examples").glob("*.ipynb")))


def modules() -> tuple[str, ...]:
    """The package and its modules, as the package itself lists them."""
    tree = ast.parse((ROOT / "py/mirrorball/__init__.py").read_text())
    for node in tree.body:
        if isinstance(node, ast.Assign) and any(isinstance(name, ast.Name) and name.id == "_MODULES" for name in node.targets):
            names: tuple[str, ...] = ast.literal_eval(node.value)
            return ("mirrorball", *(f"mirrorball.{name}" for name in names))
    raise ValueError("py/mirrorball/__init__.py has no _MODULES")


def on_files(files: Files, config: Any) -> Files:
    """Adds the generated pages."""
    pages = {"index.md": start_page(), "command_line.md": command_line()}
    for module in modules():
        pages[f"api/{module.rpartition('.')[2]}.md"] = api_page(module)
    with tempfile.TemporaryDirectory(prefix="mirrorball-site-") as folder:
        for name in NOTEBOOKS:
            pages[f"notebooks/{name}.md"] = notebook_page(name, Path(folder))
    for path, text in pages.items():
        files.append(File.generated(config, path, content=text))
    return files


def on_page_markdown(markdown: str, **_: Any) -> str:
    """Links to files outside docs/ lead nowhere on the site: their names stay."""
    return re.sub(r"\[([^\]]+)\]\(\.\./[^)]+\)", r"`\1`", markdown)


def start_page() -> str:
    """README.md with the links of the site."""
    text = (ROOT / "README.md").read_text()
    text = re.sub(r"\]\(docs/", "](", text)
    return re.sub(r"\[([^\]]+)\]\((?!https?:)[A-Z]+\.md\)", r"`\1`", text)


def command_line() -> str:
    """The help of every command."""
    names = re.findall(r"^  (\w+) ", help_text().split("Commands:")[1].split("Options:")[0], re.MULTILINE)
    sections = [f"# Command line\n\n```\n{help_text()}```\n"]
    sections += [f"## mirrorball {name}\n\n```\n{help_text(name)}```\n" for name in names if name != "help"]
    return "\n".join(sections)


def help_text(*command: str) -> str:
    """Standard output of a command's --help."""
    done = subprocess.run([PROGRAM, *command, "--help"], capture_output=True, text=True, check=True)
    return done.stdout.rstrip() + "\n"


def api_page(module: str) -> str:
    """A module's public names, each with its example."""
    short = module.rpartition(".")[2]
    examples = examples_of(short)
    entries = []
    for name in public_names(module):
        entries.append(f"::: {name}")
        if code := examples.get(name.rpartition(".")[2]):
            entries.append(f"Example:\n\n```python\n{code}\n```")
    note = (
        f"The examples run in the order of `py/examples/reference/{short}.py`, in a clone's folder: "
        "later ones use names of earlier ones."
    )
    return "\n\n".join([f"# {module}", note, *entries]) + "\n"


def examples_of(module: str) -> dict[str, str]:
    """Code by public name, from the cells of py/examples/reference."""
    text = (ROOT / f"py/examples/reference/{module}.py").read_text()
    parts = re.split(r"^# %% (.+)$", text, flags=re.MULTILINE)[1:]
    return {name: code.strip() for names, code in zip(parts[::2], parts[1::2], strict=True) for name in names.split(", ")}


def public_names(module: str) -> list[str]:
    """Names of `__all__` with the module that defines them."""
    script = (
        "import importlib, json, sys\n"
        f"module = importlib.import_module({module!r})\n"
        "names = []\n"
        "for name in module.__all__:\n"
        "    value = getattr(module, name)\n"
        "    if name.startswith('__') or not callable(value) or not getattr(value, '__doc__', None): continue\n"
        "    home = getattr(value, '__module__', None) or ''\n"
        "    names.append(f'{home if home.startswith(\"mirrorball\") else module.__name__}.{name}')\n"
        "print(json.dumps(names))\n"
    )
    environment = {**os.environ, "PYTHONPATH": str(ROOT / "py")}
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True, env=environment)
    found: list[str] = json.loads(done.stdout)
    return found


def notebook_page(name: str, folder: Path) -> str:
    """A notebook with the outputs and pictures of this run."""
    environment = {
        **os.environ,
        "PYTHONPATH": f"{ROOT / 'py'}",
        "MIRRORBALL_HOME": str(ROOT),
        "SECONDS_OF_PLAY": "5",
        "MPLBACKEND": "module://matplotlib_inline.backend_inline",
    }
    # A copy: what the notebook writes stays in this folder.
    source, executed = folder / f"{name}.ipynb", folder / f"{name}.md"
    shutil.copy(ROOT / f"py/examples/{name}.ipynb", source)
    command = [sys.executable, "-m", "nbconvert", "--to", "markdown", "--execute", source, "--output-dir", folder]
    subprocess.run(command, check=True, env=environment, cwd=folder)
    text = executed.read_text()

    def inline(match: re.Match[str]) -> str:
        picture = (folder / match[2]).read_bytes()
        return f'<img alt="{match[1]}" src="data:image/png;base64,{base64.b64encode(picture).decode()}">'

    return re.sub(r"!\[([^\]]*)\]\(([^)]+\.png)\)", inline, text)
