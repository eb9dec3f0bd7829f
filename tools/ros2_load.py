"""What do 1,000 messages of ROS 2 a second cost a robot's cycle? (root; the executable with `--features ros2`; an idle machine)

Runs the virtual robot with its node in turn without and with a flood of commands by Cyclone DDS, in a network namespace
of its own, and prints median and 99th percentile of the time from exposure to published pose, milliseconds.

    .venv/bin/python tools/ros2_load.py --rounds 5 --seconds 20
"""

import argparse
import os
import statistics
import sys
import tempfile
import time
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
sys.path[:0] = [str(ROOT / "tests"), str(ROOT / "py")]
os.environ["MIRRORBALL_REQUIRE_TOOLS"] = "1"

import ros_types as ros  # noqa: E402
import test_ros  # noqa: E402


def measure(rate_hz: float, seconds: float) -> tuple[float, float, float, int]:
    """Median and 99th percentile of a run with this many commands a second, their rate, and the number that arrived."""
    with tempfile.TemporaryDirectory() as folder:
        sim, run = test_ros.run_robot(Path(folder), "[ros2]\naccept_commands = true\n")
        peer = test_ros.Peer()
        writer, odometry = peer.writer("rt/cmd_vel", ros.Twist), peer.reader("rt/odom", ros.Odometry)
        assert test_ros.wait(writer.get_matched_subscriptions) and test_ros.first(odometry)
        start, sent = time.monotonic(), 0
        while (elapsed := time.monotonic() - start) < seconds:
            # Those that are due, then a pause of a millisecond.
            while sent < elapsed * rate_hz:
                writer.write(ros.Twist())
                sent += 1
            time.sleep(0.001)
        peer.close()
        report, _ = test_ros.finish(sim, run)
    latency = report["latency_ms"]
    return latency["median"], latency["p99"], sent / seconds, report["ros2"]["accepted"]


def main() -> None:
    """Prints each run and the difference of the medians."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rounds", type=int, default=5, help="pairs of runs (default: %(default)s)")
    parser.add_argument("--seconds", type=float, default=20.0, help="of each run (default: %(default)s)")
    parser.add_argument("--rate", type=float, default=1000.0, help="commands a second (default: %(default)s)")
    options = parser.parse_args()
    p99: dict[float, list[float]] = {0.0: [], options.rate: []}
    with test_ros.network_namespace():
        for _ in range(options.rounds):
            for rate_hz, tails in p99.items():
                median, tail, sent, arrived = measure(rate_hz, options.seconds)
                tails.append(tail)
                print(f"{sent:6.0f} commands/s, {arrived} arrived: median {median:.2f} ms, 99 % {tail:.2f} ms", flush=True)
    without, loaded = (statistics.median(tails) for tails in p99.values())
    print(f"99 %: {without:.2f} ms without, {loaded:.2f} ms with: {loaded - without:+.2f} ms (median of {options.rounds} runs)")


if __name__ == "__main__":
    main()
