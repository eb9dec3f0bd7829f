"""Can the settings of a robot be changed while it plays? Over its stream, under the key, and a replay repeats every bit."""

import hmac
import json
import signal
from pathlib import Path
from typing import Any

import pytest

from test_robot import StateOutput, ended, free_port, hardware, start, states  # noqa: F401
from test_stream import Viewer

KEY = "a phrase of the team"


class Tuner(Viewer):
    """A viewer that changes settings."""

    def parameters(self, *names: str) -> dict[str, Any]:
        self.send(json.dumps({"op": "getParameters", "parameterNames": names, "id": "get"}).encode())
        while True:
            opcode, payload = self.receive()
            if opcode == 1 and (message := json.loads(payload)).get("id") == "get":
                return {one["name"]: one["value"] for one in message["parameters"]}

    def change(self, overlay: str, key: str | None) -> None:
        parameters = [{"name": "tuning.overlay", "value": overlay}]
        if key is not None:
            nonce = self.parameters("tuning.nonce")["tuning.nonce"]
            content = f"mirrorball settings\n{nonce}\n{overlay}".encode()
            seal = hmac.new(key.encode(), content, "sha256").digest()[:16].hex()
            parameters.append({"name": "tuning.seal", "value": seal})
        self.send(json.dumps({"op": "setParameters", "parameters": parameters, "id": "set"}).encode())

    def set_plainly(self, **parameters: object) -> None:
        """As Foxglove's own panel does: a parameter by its name, without a seal."""
        values = [{"name": name.replace("__", "."), "value": value} for name, value in parameters.items()]
        self.send(json.dumps({"op": "setParameters", "parameters": values, "id": "set"}).encode())

    def wait_for_message(self, text: str) -> None:
        for _ in range(100_000):
            if text in self.parameters("tuning.message")["tuning.message"]:
                return
        raise AssertionError(text)


def test_settings_change_between_two_images_and_the_log_verifies(tmp_path: Path, states: StateOutput) -> None:  # noqa: F811
    port = free_port()
    sim = hardware(tmp_path / "robot")
    tuning = f'\n[stream]\nport = {port}\ntuning = true\nkey = "{KEY}"\n'
    states.network.write_text(states.network.read_text() + tuning)
    log = tmp_path / "a.mcap"
    files = ["--network", states.network, "--record", log, "--images", "png"]
    run = start("run", "--robot", tmp_path / "robot", *files, "--json")
    states.wait(10)
    tuner = Tuner(port)
    overlay = "vision.scan.range_max = 7.5\n"
    tuner.change(overlay, None)
    tuner.wait_for_message("no seal")
    tuner.change(overlay, "another phrase")
    tuner.wait_for_message("not sealed under the key")
    tuner.change("vision.scan.range_max = -1\n", KEY)
    tuner.wait_for_message("must be between")
    tuner.change(overlay, KEY)
    tuner.wait_for_message("vision.scan.range_max 9 → 7.5")
    assert tuner.parameters("vision.scan.range_max") == {"vision.scan.range_max": 7.5}
    states.wait(20)
    tuner.change("revoke = true\n", KEY)
    tuner.wait_for_message("vision.scan.range_max 7.5 → 9")
    states.wait(20)
    Viewer.close_all()
    run.send_signal(signal.SIGTERM)
    report = ended(run)
    sim.send_signal(signal.SIGTERM)
    ended(sim)
    changes = [change["reason"] for change in report["changes"] if change["device"] == "settings"]
    assert len(changes) == 2 and all("range_max" in change for change in changes), report["changes"]
    verified = ended(start("replay", log, "--verify", "--json"))["verified"]
    assert verified["identical"] and verified["cycles"] > 10, verified


@pytest.mark.parametrize("key", [None, KEY])
def test_parameters_of_foxglove_are_refused_under_a_key_and_revoked_without(
    tmp_path: Path,
    states: StateOutput,  # noqa: F811
    key: str | None,
) -> None:
    name = "vision.scan.range_max"
    port = free_port()
    sim = hardware(tmp_path / "robot")
    sealed = f'key = "{key}"\n' if key else ""
    states.network.write_text(states.network.read_text() + f"\n[stream]\nport = {port}\ntuning = true\n{sealed}")
    run = start("run", "--robot", tmp_path / "robot", "--network", states.network, "--json")
    states.wait(10)
    tuner = Tuner(port)
    before = tuner.parameters(name)[name]
    if key is None:
        tuner.set_plainly(vision__scan__range_max=7.5)
        tuner.wait_for_message(f"{name} {before:g} → 7.5")
        assert tuner.parameters(name) == {name: 7.5}
        tuner.set_plainly(tuning__revoke=True)
        tuner.wait_for_message(f"{name} 7.5 → {before:g}")
        expected = 2
    else:
        # Changed with a seal, so that there is something to revoke.
        tuner.change(f"{name} = 7.5\n", key)
        tuner.wait_for_message(f"{name} {before:g} → 7.5")
        for plain in ({"vision__scan__range_max": 6.5}, {"tuning__revoke": True}, {"tuning__overlay": f"{name} = 6.5\n"}):
            # The message of the refusal, not that of the one before.
            tuner.change("vision.scan.range_max = -1\n", key)
            tuner.wait_for_message("must be between")
            tuner.set_plainly(**plain)
            tuner.wait_for_message("no seal")
        expected = 1
    states.wait(20)
    assert tuner.parameters(name)[name] == (before if key is None else 7.5)
    Viewer.close_all()
    run.send_signal(signal.SIGTERM)
    changes = [change["reason"] for change in ended(run)["changes"] if change["device"] == "settings"]
    assert len(changes) == expected, changes
    sim.send_signal(signal.SIGTERM)
    ended(sim)
