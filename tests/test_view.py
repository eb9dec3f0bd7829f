"""The view in a real window under Xvfb; skipped where that is not installed."""

import json
import os
import shutil
import signal
import subprocess
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest

from test_robot import StateOutput, ended, free_port, hardware, start, states  # noqa: F401

ROOT = Path(__file__).parent.parent
PROGRAM = ROOT / "target" / "release" / "mirrorball"
SCENARIO = ROOT / "config" / "scenarios" / "demo.toml"
# A loaded machine opens a window slowly; nothing waits for it to pass.
TIMEOUT_S = 120.0


def environment(folder: Path, display: str | None) -> dict[str, str]:
    """Nothing remembered from another window, and a display or none."""
    own = {key: value for key, value in os.environ.items() if key not in ("DISPLAY", "WAYLAND_DISPLAY")}
    own |= {"HOME": str(folder), "XDG_DATA_HOME": str(folder / "data")}
    return own | ({"DISPLAY": display} if display else {})


def has_view() -> bool:
    return subprocess.run([PROGRAM, "view", "--help"], capture_output=True, check=False).returncode == 0


@pytest.fixture(scope="module")
def display() -> Iterator[str]:
    if not has_view():
        pytest.skip("mirrorball was built without its view")
    server = shutil.which("Xvfb")
    if server is None:
        pytest.skip("Xvfb is not installed")
    read, write = os.pipe()
    arguments = [server, "-displayfd", str(write), "-screen", "0", "1280x800x24", "-nolisten", "tcp"]
    with subprocess.Popen(arguments, pass_fds=[write], stderr=subprocess.DEVNULL) as running:
        os.close(write)
        with os.fdopen(read) as told:
            number = told.readline().strip()
        if not number:
            pytest.skip("Xvfb does not start here")
        yield f":{number}"
        running.terminate()


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("view") / "demo.mcap"
    done = subprocess.run(
        [PROGRAM, "sim", SCENARIO, "--duration", "2", "--record", path], capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    return path


def picture(path: Path) -> np.ndarray:
    """Pixels of a PNG, by the program that every image here can be read with."""
    from PIL import Image

    return np.asarray(Image.open(path).convert("RGB")).astype(int)


@pytest.mark.parametrize("preset", ["watch", "eyes", "place", "simulate", "calibrate", "health"])
def test_every_panel_layout_draws_a_log(display: str, log: Path, tmp_path: Path, preset: str) -> None:
    pytest.importorskip("PIL")
    shot = tmp_path / "shot.png"
    arguments: list[str | Path] = [PROGRAM, "view", log, "--at", "1", "--preset", preset, "--screenshot", shot]
    done = subprocess.run(
        arguments,
        env=environment(tmp_path, display),
        capture_output=True,
        text=True,
        timeout=TIMEOUT_S,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    pixels = picture(shot)
    assert pixels.shape == (800, 1280, 3)
    colours = np.unique(pixels.reshape(-1, 3), axis=0)
    assert len(colours) > 500, "an image of the floor has many colours, an empty window few"


def test_missing_file_is_named_before_a_missing_display(tmp_path: Path) -> None:
    if not has_view():
        pytest.skip("mirrorball was built without its view")
    for arguments in (["nosuch.mcap"], ["--with", "nosuch.mcap"], ["--layout", "nosuch.json"]):
        done = subprocess.run([PROGRAM, "view", *arguments], capture_output=True, text=True, env=environment(tmp_path, None))
        assert done.returncode == 1 and len(done.stderr.splitlines()) == 1, done.stderr
        assert "nosuch" in done.stderr and "No such file" in done.stderr, done.stderr


def test_view_without_display_gives_one_line_error(tmp_path: Path) -> None:
    if not has_view():
        pytest.skip("mirrorball was built without its view")
    for display in (None, ":7777"):
        done = subprocess.run(
            [PROGRAM, "view", SCENARIO],
            env=environment(tmp_path, display),
            capture_output=True,
            text=True,
            timeout=TIMEOUT_S,
            check=False,
        )
        assert done.returncode == 1
        assert len(done.stderr.strip().splitlines()) == 1, done.stderr
        assert "display" in done.stderr or "window" in done.stderr


def visible_window(own: dict[str, str]) -> str:
    """Identifier of the program's window, when it is on the display."""
    found = subprocess.run(
        ["xdotool", "search", "--sync", "--onlyvisible", "--name", "Mirrorball"],
        env=own,
        capture_output=True,
        text=True,
        timeout=TIMEOUT_S,
        check=True,
    )
    return found.stdout.split()[0]


def test_screenshot_key_writes_png(display: str, log: Path, tmp_path: Path) -> None:
    if shutil.which("xdotool") is None:
        pytest.skip("xdotool is not installed")
    own = environment(tmp_path, display)
    with subprocess.Popen([PROGRAM, "view", log], env=own, cwd=tmp_path, stderr=subprocess.PIPE) as window:
        try:
            subprocess.run(["xdotool", "windowfocus", visible_window(own)], env=own, check=True)
            until = time.monotonic() + TIMEOUT_S
            # Keys pressed before the window listens are lost: press until it obeys.
            while not list(tmp_path.glob("mirrorball_*.png")) and time.monotonic() < until:
                subprocess.run(["xdotool", "mousemove", "640", "10", "key", "ctrl+s"], env=own, check=True)
                # The dialog asks where; Return accepts its proposal.
                subprocess.run(["xdotool", "sleep", "0.7", "key", "Return"], env=own, check=True)
                time.sleep(1.0)
            assert list(tmp_path.glob("mirrorball_*.png")), "Ctrl+S takes a picture"
        finally:
            window.kill()


def test_layout_file_of_another_kind_is_refused_in_one_line(log: Path, display: str, tmp_path: Path) -> None:
    path = tmp_path / "layout.json"
    path.write_text('{"panels": 3}')
    done = subprocess.run(
        [PROGRAM, "view", log, "--layout", path],
        env=environment(tmp_path, display),
        capture_output=True,
        text=True,
        timeout=TIMEOUT_S,
        check=False,
    )
    assert done.returncode == 1
    assert len(done.stderr.strip().splitlines()) == 1 and "layout.json" in done.stderr, done.stderr


def test_second_log_is_drawn_beside_the_first(log: Path, display: str, tmp_path: Path) -> None:
    pytest.importorskip("PIL")
    shots = [tmp_path / "alone.png", tmp_path / "both.png"]
    beside: list[list[str | Path]] = [[], ["--with", log]]
    for shot, others in zip(shots, beside, strict=True):
        arguments: list[str | Path] = [PROGRAM, "view", log, *others, "--at", "1", "--preset", "place", "--screenshot", shot]
        done = subprocess.run(
            arguments,
            env=environment(tmp_path, display),
            capture_output=True,
            text=True,
            timeout=TIMEOUT_S,
            check=False,
        )
        assert done.returncode == 0, done.stderr
    alone, both = (picture(shot) for shot in shots)
    # The field, without menu bar and plots: the other run's robot lies on this one, with its name beside it.
    field = (slice(90, 590), slice(10, 760))
    assert (alone[field] != both[field]).any(axis=2).sum() > 100


def test_closing_the_view_does_not_change_the_run(display: str, tmp_path: Path) -> None:
    if shutil.which("xdotool") is None:
        pytest.skip("xdotool is not installed")
    own = environment(tmp_path, display)
    poses = [tmp_path / "with.csv", tmp_path / "without.csv"]
    common: list[str | Path] = [PROGRAM, "sim", SCENARIO, "--duration", "3", "--json", "--out"]
    subprocess.run([*common, poses[1]], check=True, capture_output=True)
    with subprocess.Popen([*common, poses[0], "--view"], env=own, stdout=subprocess.PIPE, text=True) as run:
        found = subprocess.run(
            ["xdotool", "search", "--sync", "--onlyvisible", "--name", "Mirrorball"],
            env=own,
            capture_output=True,
            text=True,
            timeout=TIMEOUT_S,
            check=True,
        )
        name = found.stdout.split()[0]
        subprocess.run(["xdotool", "windowfocus", name], env=own, check=True)
        # Keys pressed before the window listens are lost: press until it is gone.
        while run.poll() is None:
            subprocess.run(["xdotool", "mousemove", "640", "10", "key", "ctrl+q"], env=own, check=True)
            time.sleep(0.5)
        out, _ = run.communicate(timeout=TIMEOUT_S)
    assert run.returncode == 0
    assert json.loads(out)["simulated_s"] == 3.0
    assert poses[0].read_bytes() == poses[1].read_bytes(), "the same bits, watched or not"


def test_sigterm_closes_the_view_of_a_running_robot(display: str, tmp_path: Path) -> None:
    if shutil.which("xdotool") is None:
        pytest.skip("xdotool is not installed")
    own = environment(tmp_path, display)
    robot = tmp_path / "robot"
    hardware = subprocess.Popen(
        [PROGRAM, "sim", SCENARIO, "--hardware", robot, "--own-path"], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
    )
    try:
        wait_for(robot / "hardware.toml")
        watched: list[str | Path] = [PROGRAM, "run", "--robot", robot, "--view", "--json"]
        with subprocess.Popen(watched, env=own, stdout=subprocess.PIPE, text=True) as run:
            search = ["xdotool", "search", "--sync", "--onlyvisible", "--name", "Mirrorball"]
            subprocess.run(search, env=own, capture_output=True, timeout=TIMEOUT_S, check=True)
            time.sleep(1.0)
            run.terminate()
            out, _ = run.communicate(timeout=TIMEOUT_S)
    finally:
        hardware.terminate()
        hardware.wait(TIMEOUT_S)
    said = json.loads(out)
    assert run.returncode == 0
    assert said["frames"] > 0 and said["wheels_stopped"]


def wait_for(path: Path) -> None:
    end = time.monotonic() + TIMEOUT_S
    while not path.exists():
        assert time.monotonic() < end, f"{path} does not come"
        time.sleep(0.05)


# Places in the window of 1280 × 800 pixels, layout "eyes": the parameters, reduced to one by the search.
KEY_FIELD, SEND, REVOKE, SEARCH, FIRST_SETTING = (778, 94), (904, 94), (989, 94), (834, 135), (955, 181)
KEY = "a phrase of the team"
SETTING = "localize.attitude.tilt_compensation"


def test_settings_sent_from_the_window_reach_the_robot_and_can_be_revoked(
    display: str,
    tmp_path: Path,
    states: StateOutput,  # noqa: F811
) -> None:
    if shutil.which("xdotool") is None:
        pytest.skip("xdotool is not installed")
    own, messages, log_path = environment(tmp_path, display), tmp_path / "messages", tmp_path / "a.mcap"
    port = free_port()
    stream = f'\n[stream]\nport = {port}\ntuning = true\nkey = "{KEY}"\n'
    states.network.write_text(states.network.read_text() + stream)
    sim = hardware(tmp_path / "robot")
    files = ["--network", states.network, "--record", log_path, "--images", "png"]
    arguments = [PROGRAM, "run", "--robot", tmp_path / "robot", *files, "--json"]
    with messages.open("w") as errors:
        run = subprocess.Popen([*map(str, arguments)], stdout=subprocess.PIPE, stderr=errors, text=True)
    states.wait(3)

    def act(*commands: object) -> None:
        subprocess.run(["xdotool", *map(str, commands)], env=own, check=True)

    def click(place: tuple[int, int]) -> None:
        # The window draws a few images a second, and takes a press and its release in different ones.
        act("mousemove", *place, "sleep", "0.3", "mousedown", "1", "sleep", "0.2", "mouseup", "1", "sleep", "0.3")

    def write(place: tuple[int, int], text: str) -> None:
        click(place)
        act("key", "ctrl+a", "sleep", "0.2", "type", "--delay", "30", text)

    def wait_for(change: str, *, prepare: Callable[[], None], button: tuple[int, int]) -> None:
        """Prepares and presses a button until the robot takes the change: a busy machine loses clicks."""
        until = time.monotonic() + TIMEOUT_S
        while f"{SETTING} {change}" not in messages.read_text():
            assert time.monotonic() < until, messages.read_text()
            prepare()
            unchanged = messages.read_text().count("no setting differs")
            click(button)
            for _ in range(50):
                states.wait(1)
                text = messages.read_text()
                if f"{SETTING} {change}" in text or text.count("no setting differs") > unchanged:
                    break

    def prepare_change() -> None:
        write(KEY_FIELD, KEY)
        write(SEARCH, SETTING.split(".")[-1])
        click(FIRST_SETTING)

    window = subprocess.Popen([PROGRAM, "view", f"127.0.0.1:{port}", "--preset", "eyes"], env=own, stderr=subprocess.DEVNULL)
    try:
        act("windowfocus", visible_window(own))
        wait_for("true → false", prepare=prepare_change, button=SEND)
        wait_for("false → true", prepare=lambda: None, button=REVOKE)
    finally:
        window.kill()
        window.wait()
    states.wait(10)
    run.send_signal(signal.SIGTERM)
    report = ended(run)
    sim.send_signal(signal.SIGTERM)
    ended(sim)
    changes = [change["reason"] for change in report["changes"] if change["device"] == "settings"]
    assert any(f"{SETTING} true → false" in change for change in changes), changes
    assert ended(start("replay", log_path, "--verify", "--json"))["verified"]["identical"]
