"""Scripts and mirror design by the executable."""

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from mirrorball import Profile
from mirrorball.mirror import lima2001

ROOT = Path(__file__).parents[1]
PROGRAM = ROOT / "target/release/mirrorball"


def mirrorball(*arguments: str | Path, **environment: str) -> subprocess.CompletedProcess[str]:
    """The environment of these tests, unless the test says otherwise."""
    whole = {**os.environ, "VIRTUAL_ENV": sys.prefix, **environment}
    return subprocess.run([PROGRAM, *map(str, arguments)], capture_output=True, text=True, env=whole, timeout=120)


def written(folder: Path, text: str) -> Path:
    path = folder / "script.py"
    path.write_text(text)
    return path


def test_script_imports_embedded_package_with_argv_and_venv(tmp_path: Path) -> None:
    (tmp_path / "neighbour.py").write_text("word = 'here'\n")
    script = written(
        tmp_path,
        "import sys, mirrorball, mirrorball._core, mirrorball.mirror, neighbour, numpy\n"
        "from mirrorball.mirror import lima2001\n"
        "print(__name__, sys.argv[1:], sys.prefix, mirrorball.__spec__.origin, neighbour.word)\n"
        "print(mirrorball.Profile is mirrorball._core.Profile, type(lima2001().profile()).__module__)\n",
    )
    done = mirrorball("script", script, "one", "--two")
    assert done.returncode == 0, done.stderr
    first, second = done.stdout.splitlines()
    assert first == f"__main__ ['one', '--two'] {sys.prefix} <mirrorball>/mirrorball.py here"
    assert second == "True mirrorball._core"


@pytest.mark.parametrize(
    ("text", "code", "words"),
    [
        ("print('fine')\n", 0, ""),
        ("raise SystemExit\n", 0, ""),
        ("raise SystemExit(0)\n", 0, ""),
        ("raise SystemExit(3)\n", 3, "code 3"),
        ("import sys; sys.exit('no mirror')\n", 1, "no mirror"),
        ("1 / 0\n", 1, "ZeroDivisionError"),
        # The lines of what the executable carries are shown too.
        ("from mirrorball.mirror import design\ndesign([], pinhole_height_m=1, apex_above_pinhole_m=1)\n", 1, "if not parts"),
        ("import atexit; atexit.register(lambda: print('bye', flush=False))\n", 0, ""),
        ("import threading, time\nthreading.Thread(target=lambda: (time.sleep(0.3), print('bye'))).start()\n", 0, ""),
        ("from concurrent.futures import ThreadPoolExecutor\nThreadPoolExecutor(1).submit(print, 'bye')\n", 0, ""),
    ],
)
def test_script_exit_status_becomes_command_exit_status(text: str, code: int, words: str, tmp_path: Path) -> None:
    if words == "if not parts":
        text, words = text, "at least one part"
    done = mirrorball("script", written(tmp_path, text))
    assert (done.returncode, words in done.stderr) == (code, True), done.stderr
    if "bye" in text:
        assert done.stdout == "bye\n"


def test_modules_beside_a_script_are_found_after_it_left_its_folder(tmp_path: Path) -> None:
    (tmp_path / "sibling.py").write_text("word = 'here'\n")
    script = written(tmp_path, "import os\nos.chdir('/')\nimport sibling\nprint(sibling.word)\n")
    done = subprocess.run([PROGRAM, "script", script.name], cwd=tmp_path, capture_output=True, text=True, check=True,
                          env={**os.environ, "VIRTUAL_ENV": sys.prefix})  # fmt: skip
    assert done.stdout == "here\n"


def test_sigint_ends_script_without_traceback(tmp_path: Path) -> None:
    script = written(tmp_path, "import time\nprint('up', flush=True)\ntime.sleep(600)\n")
    with subprocess.Popen([PROGRAM, "script", script], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
                          env={**os.environ, "VIRTUAL_ENV": sys.prefix}) as running:  # fmt: skip
        assert running.stdout is not None
        assert running.stdout.readline() == "up\n"
        running.send_signal(signal.SIGINT)
        # Long before the script would end by itself.
        _, errors = running.communicate(timeout=60)
    assert running.returncode == 1 and errors.strip() == "mirrorball: interrupted"


def test_missing_interpreter_is_reported_with_its_path(tmp_path: Path) -> None:
    script = written(tmp_path, "")
    for done in (mirrorball("script", "--python", tmp_path, script), mirrorball("script", script, VIRTUAL_ENV=str(tmp_path))):
        assert done.returncode == 1 and str(tmp_path) in done.stderr and "no interpreter" in done.stderr
    assert mirrorball("script", "--python", sys.prefix, script, VIRTUAL_ENV=str(tmp_path)).returncode == 0
    assert mirrorball("script", tmp_path / "none.py").returncode == 1
    assert mirrorball("script").returncode == 2


def test_venv_of_other_python_version_is_rejected(tmp_path: Path) -> None:
    (tmp_path / "bin").mkdir()
    (tmp_path / "bin/python3").touch()
    (tmp_path / "pyvenv.cfg").write_text("version = 3.4.10\n")
    done = mirrorball("script", "--python", tmp_path, written(tmp_path, ""))
    assert done.returncode == 1 and "Python 3.4.10" in done.stderr


def test_mirror_design_writes_profile_csv_and_summary(tmp_path: Path) -> None:
    done = mirrorball("mirror", "design", ROOT / "config/mirrors/lima2001.toml", "--out", tmp_path / "m.csv", "--json")
    assert done.returncode == 0, done.stderr
    result = json.loads(done.stdout)
    assert [part["part"] for part in result["parts"]][-1] == "planar"
    assert result["parts"][-1]["ground_to_m"] == pytest.approx(0.51)
    profile = Profile.load(tmp_path / "m.csv")
    assert profile.radius_m[-1] == pytest.approx(lima2001().radius_m, abs=1e-9)


def test_report_render_and_export_write_their_files(tmp_path: Path) -> None:
    done = mirrorball("mirror", "report", "nubot2013", "--out", tmp_path / "report", "--mirrors", "50", "--json")
    assert done.returncode == 0, done.stderr
    assert (tmp_path / "report/index.html").is_file() and len(json.loads(done.stdout)["errors"]) > 5
    assert "/100" in done.stderr and "mirror/s" in done.stderr
    done = mirrorball("mirror", "render", "minho_like", "--pose=-3,1,30", "--ball=-1,0", "--out", tmp_path / "view.png")
    assert done.returncode == 0, done.stderr
    assert (tmp_path / "view.png").read_bytes()[:4] == b"\x89PNG"
    done = mirrorball("mirror", "export", "lima2001", "--out", tmp_path, "--formats", "csv,dxf,stl", "--json")
    assert done.returncode == 0, done.stderr
    for entry in json.loads(done.stdout)["files"]:
        assert Path(entry["file"]).is_file() and 0.0 < entry["deviation_m"] < 1.1e-5


def test_requirements_are_optimised_on_the_command_line(tmp_path: Path) -> None:
    done = mirrorball("mirror", "design", ROOT / "config/mirrors/wishes.toml", "--out", tmp_path / "m.csv", "--json")
    assert done.returncode == 0, done.stderr
    result = json.loads(done.stdout)
    assert result["share"] > 1.0 and result["conflicts"] == [] and len(result["wishes"]) == 4
    assert np.isfinite(result["smallest_curvature_radius_m"]) and result["smallest_curvature_radius_m"] >= 0.0039


def test_invalid_design_file_gives_one_line_error(tmp_path: Path) -> None:
    (tmp_path / "bad.toml").write_text("apex = 0.2\n")
    done = mirrorball("mirror", "design", tmp_path / "bad.toml")
    assert done.returncode == 1
    assert done.stderr.strip() == f"mirrorball: {tmp_path / 'bad.toml'}: the file needs 'camera'"


@pytest.mark.parametrize("name", ["lima2001", "sphere_cone_1999", "nubot2013", "minho_like"])
def test_mirror_examples_write_an_image(name: str, tmp_path: Path) -> None:
    done = mirrorball("script", ROOT / f"py/examples/{name}.py", "--out", tmp_path / "picture.png")
    assert done.returncode == 0, done.stderr
    assert (tmp_path / "picture.png").stat().st_size > 50_000


@pytest.mark.parametrize("asked", [signal.SIGINT, signal.SIGTERM])
def test_interrupted_report_leaves_no_files(tmp_path: Path, asked: signal.Signals) -> None:
    out = tmp_path / "report"
    command: list[str | Path] = [PROGRAM, "mirror", "report", "lima2001", "--mirrors", "100000", "--out", out]
    environment = {**os.environ, "VIRTUAL_ENV": sys.prefix}
    with subprocess.Popen(
        command, env=environment, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True, start_new_session=True
    ) as running:
        end = time.monotonic() + 60.0
        while not list(out.glob(".report-*/*.png")) and time.monotonic() < end:
            time.sleep(0.05)
        os.killpg(running.pid, asked)
        _, said = running.communicate(timeout=60)
    assert running.returncode == 1
    assert "interrupted" in said and "Traceback" not in said
    assert list(out.iterdir()) == []


def test_cargo_run_starts_mirrorball_where_no_binary_is_named() -> None:
    # As `make run` does: the workspace has other binaries, too.
    command = ["cargo", "metadata", "--format-version", "1", "--no-deps", "--offline"]
    packages = json.loads(subprocess.run(command, cwd=ROOT, capture_output=True, check=True).stdout)["packages"]
    programs = {binary["name"] for package in packages for binary in package["targets"] if binary["kind"] == ["bin"]}
    defaults = {package["default_run"] for package in packages if package["default_run"]}
    assert "mirrorball" in programs and defaults == {"mirrorball"}


def test_report_lists_findings_and_compares_two_logs(game: Path, tmp_path: Path) -> None:
    done = mirrorball("report", game, "--out", tmp_path / "one", "--json")
    assert done.returncode == 0, done.stderr
    result = json.loads(done.stdout)
    assert result["frames"] == 60 and Path(result["page"]).is_file()
    assert all({"kind", "start_s", "sentence"} <= set(row) for row in result["findings"])
    done = mirrorball("report", game, game, "--out", tmp_path / "both")
    assert done.returncode == 0, done.stderr
    assert "difference 0.00 cm (95 %: 0.00 to 0.00 cm)" in done.stdout
    done = mirrorball("report", tmp_path / "none.mcap", "--out", tmp_path / "none")
    assert done.returncode == 1 and done.stderr.count("\n") == 1 and "none.mcap" in done.stderr


@pytest.mark.parametrize("delay_s", [0.2, 0.4, 0.6, 0.8])
def test_interrupt_while_python_starts_is_one_line(delay_s: float, game: Path, tmp_path: Path) -> None:
    command = [str(PROGRAM), "report", str(game), "--out", str(tmp_path / "page")]
    whole = {**os.environ, "VIRTUAL_ENV": sys.prefix}
    with subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True, env=whole) as running:
        time.sleep(delay_s)
        running.send_signal(signal.SIGINT)
        _, errors = running.communicate(timeout=60)
    # A fast machine has written the page by then.
    assert errors.strip() in ("mirrorball: interrupted", ""), errors


def test_report_reads_a_log_whose_name_is_no_utf_8(game: Path, tmp_path: Path) -> None:
    log = tmp_path / os.fsdecode(b"run\xff.mcap")
    log.write_bytes(game.read_bytes())
    for options in ([], ["--json"]):
        done = mirrorball("report", log, "--out", tmp_path / "page", *options)
        assert done.returncode == 0, done.stderr
    assert "run\ufffd" in (tmp_path / "page" / "index.html").read_text(encoding="utf-8")


def test_empty_folder_is_no_bag(tmp_path: Path) -> None:
    bag = tmp_path / "empty"
    bag.mkdir()
    done = mirrorball("import", bag, tmp_path / "drive")
    assert done.returncode == 1 and f"{bag}: not the folder of a ROS 2 bag (it has no metadata.yaml)" in done.stderr


def test_negative_seed_is_refused_with_what_is_expected() -> None:
    done = mirrorball("sim", ROOT / "config/scenarios/demo.toml", "--seed", "-1")
    assert done.returncode == 2 and "expected a whole number from 0" in done.stderr and "-- -1" not in done.stderr


def test_setting_that_a_scenario_does_not_know_is_named_with_its_value() -> None:
    done = mirrorball("sim", ROOT / "config/scenarios/demo.toml", "--duration", "1", "--set", "path.sped=3")
    assert done.returncode == 1
    assert "path.sped = 3" in done.stderr and "demo.toml" in done.stderr and "speed" in done.stderr


def test_experiment_is_found_without_the_ending_of_its_file(tmp_path: Path) -> None:
    wanted = ROOT / "config/experiments/certainty"
    done = mirrorball("eval", wanted, "--out", tmp_path, "--only", "no such part")
    assert done.returncode == 2 and "no part's name contains" in done.stderr, done.stderr
    done = mirrorball("eval", tmp_path / "nothing", "--out", tmp_path)
    assert done.returncode == 1 and "no such experiment" in done.stderr, done.stderr
