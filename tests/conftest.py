"""A short simulated game, recorded once for all tests that study logs."""

import subprocess
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
PROGRAM = ROOT / "target" / "release" / "mirrorball"


def pytest_sessionstart() -> None:
    """Without the executable most tests would have nothing to test: none of them passes by being left out."""
    if not PROGRAM.exists():
        pytest.exit("target/release/mirrorball is not built: make test builds it", returncode=1)


@pytest.fixture(scope="session")
def game(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two seconds of the demo with seed 3, images included."""
    path = tmp_path_factory.mktemp("game") / "game.mcap"
    command: list[str | Path] = [
        PROGRAM,
        "sim",
        ROOT / "config/scenarios/demo.toml",
        "--seed",
        "3",
        "--duration",
        "2",
        "--record",
        path,
    ]
    subprocess.run(command, check=True, capture_output=True)
    return path
