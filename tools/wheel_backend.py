"""What does `pip install .` build? maturin's wheel, and in it the executable that makes simulated runs.

A build backend (PEP 517) around maturin's own: before the wheel is packed, cargo builds the executable without Python and
views, so that a sweep's worker needs nothing but the wheel. Where the executable's sources are missing (a source
distribution holds the binding alone) or the system is not Linux, the wheel comes without it, and says so.
"""

import shutil
import subprocess
import sys
from pathlib import Path

import maturin
from maturin import (  # noqa: F401 (the rest of the interface is maturin's)
    build_editable,
    build_sdist,
    get_requires_for_build_editable,
    get_requires_for_build_sdist,
    get_requires_for_build_wheel,
    prepare_metadata_for_build_editable,
    prepare_metadata_for_build_wheel,
)

ROOT = Path(__file__).resolve().parents[1]
CARRIED = ROOT / "py" / "mirrorball" / "bin"


def build_wheel(wheel_directory, config_settings=None, metadata_directory=None):
    """Builds both."""
    try:
        _carry_executable()
        return maturin.build_wheel(wheel_directory, config_settings, metadata_directory)
    finally:
        # Beside the sources it would go stale. It must not be in .gitignore: maturin leaves out what is.
        shutil.rmtree(CARRIED, ignore_errors=True)


def _carry_executable():
    if not (ROOT / "crates" / "app" / "Cargo.toml").is_file() or not sys.platform.startswith("linux"):
        print("mirrorball: a wheel without the executable; simulated runs need it on the PATH", file=sys.stderr)
        return
    target = ROOT / "target-wheel"
    command = ["cargo", "build", "--release", "--locked", "-p", "app", "--no-default-features", "--target-dir", target]
    subprocess.run(command, cwd=ROOT, check=True)
    CARRIED.mkdir(exist_ok=True)
    program = CARRIED / "mirrorball"
    shutil.copy2(target / "release" / "mirrorball", program)
    if strip := shutil.which("strip"):
        subprocess.run([strip, program], check=True)
