"""Do the documents say what the source says?"""

import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
DOCUMENTS = [ROOT / "README.md", ROOT / "ARCHITECTURE.md", *sorted((ROOT / "docs").glob("*.md"))]


def test_the_configuration_reference_is_what_the_source_says() -> None:
    tool = ROOT / "tools/configuration_reference"
    done = subprocess.run([sys.executable, tool, "--check"], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr


def test_the_reference_has_every_key_that_our_own_files_use() -> None:
    text = (ROOT / "docs/configuration.md").read_text()
    keys = set(re.findall(r"^\| (\w+) \|", text, re.M)) | set(re.findall(r"^#+ \[+(?:\w+\.)*(\w+)", text, re.M))
    for path in [*(ROOT / "config/robots").glob("*.toml"), *(ROOT / "config/scenarios").glob("*.toml")]:
        used = {line.split("=")[0].strip() for line in path.read_text().splitlines() if re.match(r"\w+ =", line)}
        assert used <= keys, (path, used - keys)


@pytest.mark.parametrize("document", DOCUMENTS, ids=lambda path: str(path.name))
def test_links_lead_to_files(document: Path) -> None:
    for target in re.findall(r"\]\(([^)#]+)", document.read_text()):
        assert target.startswith("http") or (document.parent / target).exists(), target
