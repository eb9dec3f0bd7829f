"""Documents agree with the source."""

import dataclasses
import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
DOCUMENTS = [
    *(ROOT / name for name in ("README.md", "ARCHITECTURE.md", "CONTRIBUTING.md", "CHANGELOG.md")),
    *sorted((ROOT / "docs").glob("*.md")),
]


def test_configuration_reference_is_up_to_date() -> None:
    tool = ROOT / "tools/configuration_reference"
    done = subprocess.run([sys.executable, tool, "--check"], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr


def test_configuration_reference_covers_shipped_files() -> None:
    text = (ROOT / "docs/configuration.md").read_text()
    keys = set(re.findall(r"^\| (\w+) \|", text, re.M)) | set(re.findall(r"^#+ \[+(?:\w+\.)*(\w+)", text, re.M))
    for path in [*(ROOT / "config/robots").glob("*.toml"), *(ROOT / "config/scenarios").glob("*.toml")]:
        used = {line.split("=")[0].strip() for line in path.read_text().splitlines() if re.match(r"\w+ =", line)}
        assert used <= keys, (path, used - keys)


@pytest.mark.parametrize("document", DOCUMENTS, ids=lambda path: str(path.name))
def test_document_links_resolve(document: Path) -> None:
    for target in re.findall(r"\]\(([^)#]+)", document.read_text()):
        assert target.startswith("http") or (document.parent / target).exists(), target


@pytest.mark.parametrize("document", DOCUMENTS, ids=lambda path: str(path.name))
def test_paths_in_documents_exist(document: Path) -> None:
    for path in re.findall(r"`((?:crates|py|tools|config|tests|docs)/[\w/.-]+)`", document.read_text()):
        assert "NAME" in path or (ROOT / path).exists(), path


def test_citations_of_methods_in_the_code_lead_to_sections() -> None:
    sections = set(re.findall(r"^#+ (\d+(?:\.\d+)?)[. ]", (ROOT / "docs/methods.md").read_text(), re.M))
    for path in [*(ROOT / "crates").rglob("*.rs"), *(ROOT / "py").rglob("*.py")]:
        for number in re.findall(r"methods\.md,? (\d+(?:\.\d+)?)", path.read_text()):
            assert number in sections, (path, number)


def test_mirror_design_files_are_documented_key_by_key() -> None:
    from mirrorball.mirror import design_file
    from mirrorball.mirror.optical_analysis import Lens
    from mirrorball.mirror.tolerances import Tolerances

    text = (ROOT / "docs/mirror_design.md").read_text()
    kinds = design_file.PART_KINDS | design_file.REQUIREMENT_KINDS
    assert all(f"| {kind} |" in text for kind in (*kinds, "free"))
    keys = {
        design_file._toml_key(field.name) for kind in (*kinds.values(), Lens, Tolerances) for field in dataclasses.fields(kind)
    }
    assert [key for key in sorted(keys - {"hard"}) if f"`{key}" not in text] == []
    assert "`hard = true`" in text
    assert all(f"`{key}`" in text for key in design_file.CAMERA_KEYS)
