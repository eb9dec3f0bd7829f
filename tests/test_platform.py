"""Another machine's mathematical library: do logs still replay to the same bits?"""

import json
import os
import subprocess
from pathlib import Path

import pytest
from mcap.reader import make_reader

ROOT = Path(__file__).parent.parent
PROGRAM = ROOT / "target" / "release" / "mirrorball"
SCENARIO = ROOT / "config" / "scenarios" / "demo.toml"

# Every elementary function of the platform's library, each result moved to the next larger number.
LIBRARY = r"""
#define _GNU_SOURCE
#include <dlfcn.h>
#include <math.h>

static double next(double y) { return isfinite(y) && y != 0.0 ? nextafter(y, INFINITY) : y; }
static float nextf(float y) { return isfinite(y) && y != 0.0f ? nextafterf(y, INFINITY) : y; }

#define ONE(name)                                                                                  \
    double name(double x) { return next(((double (*)(double))dlsym(RTLD_NEXT, #name))(x)); }       \
    float name##f(float x) { return nextf(((float (*)(float))dlsym(RTLD_NEXT, #name "f"))(x)); }
#define TWO(name)                                                                                  \
    double name(double x, double y) {                                                              \
        return next(((double (*)(double, double))dlsym(RTLD_NEXT, #name))(x, y));                  \
    }                                                                                              \
    float name##f(float x, float y) {                                                              \
        return nextf(((float (*)(float, float))dlsym(RTLD_NEXT, #name "f"))(x, y));                \
    }

ONE(sin) ONE(cos) ONE(tan) ONE(asin) ONE(acos) ONE(atan) ONE(sinh) ONE(cosh) ONE(tanh) ONE(asinh)
ONE(acosh) ONE(atanh) ONE(exp) ONE(exp2) ONE(exp10) ONE(expm1) ONE(log) ONE(log2) ONE(log10) ONE(log1p)
ONE(cbrt) TWO(atan2) TWO(pow) TWO(hypot)

void sincos(double x, double *s, double *c) { *s = sin(x); *c = cos(x); }
void sincosf(float x, float *s, float *c) { *s = sinf(x); *c = cosf(x); }
"""


def run(*arguments: object, library: Path | None = None) -> str:
    environment = {**os.environ, **({"LD_PRELOAD": str(library)} if library else {})}
    done = subprocess.run([PROGRAM, *map(str, arguments)], capture_output=True, text=True, check=False, env=environment)
    assert done.returncode == 0, done.stderr
    return done.stdout


def true_poses(path: Path) -> list[bytes]:
    with path.open("rb") as file:
        return [message.data for _, _, message in make_reader(file).iter_messages(topics=["/truth/pose"])]


@pytest.fixture(scope="module")
def other_library(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("library")
    source, library = folder / "other.c", folder / "libother.so"
    source.write_text(LIBRARY)
    subprocess.run(["gcc", "-shared", "-fPIC", "-fno-builtin", "-O1", "-o", library, source, "-ldl", "-lm"], check=True)
    return library


def test_preloaded_library_changes_what_the_executable_computes(other_library: Path, tmp_path: Path) -> None:
    script = tmp_path / "sine.py"
    script.write_text("import math\nprint(math.sin(0.5).hex())\n")
    assert run("script", script) != run("script", script, library=other_library)


@pytest.mark.parametrize("preset", ["default", "lima2001", "nubot2013", "minho2016"])
def test_log_verifies_with_another_mathematical_library(other_library: Path, tmp_path: Path, preset: str) -> None:
    log, foreign = tmp_path / "ours.mcap", tmp_path / "foreign.mcap"
    options = ("--seed", 3, "--duration", 1, "--preset", preset, "--record")
    run("sim", SCENARIO, *options, log)
    run("sim", SCENARIO, *options, foreign, library=other_library)
    # The simulator uses the platform's functions, so the library reaches compiled code too.
    assert true_poses(log) != true_poses(foreign)
    for path, library in ((log, other_library), (foreign, None)):
        verified = json.loads(run("replay", path, "--verify", "--json", library=library))["verified"]
        assert verified["identical"] and verified["cycles"] >= 20
        # An image in which no carpet is found has no detections.
        assert verified["vision_cycles"] > 0.8 * verified["cycles"]
