"""Makes the recordings that train the object networks: simulated drives, and labelled_Y1 with a map of its own lines.

`python py/training/prepare_recordings.py --mirrorball target/release/mirrorball --labelled REAL --out DIR`

REAL holds the labelled photographs (labelled_Y1, labelled_Y3). labelled_Y1 has no map: it is calibrated from its lines,
from the map of labelled_Y3 enlarged about the axis. Then train_objects.py takes DIR.
"""

from __future__ import annotations

import argparse
import shutil
import subprocess
import tomllib
from pathlib import Path

import numpy as np

SCENARIOS = ["hall_bright", "hall_dim", "hall_glare", "hall_crowded", "game_18x12", "demo"]
SETTINGS = ["frame_rate_hz=2"]
# Robots and people are learnt without the simulator's people, who look too much alike.
NOBODY = ["people.count=0"]
DURATION_S = "24"
# All halls in the light of hall_dim, with its noise and motion blur.
DIM = ["film.full_well=3000.0", "film.read_noise=20.0", "film.shutter=0.012", "light.level=0.3"]
# First seeds of three sets; the balls of the second and third lie beside the path.
SETS: list[tuple[str, int, list[str]]] = [
    ("a", 101, NOBODY),
    ("b", 201, [*NOBODY, "ball.position=[1.0,-1.5]"]),
    ("c", 301, [*NOBODY, *DIM, "ball.position=[-1.5,1.0]"]),
]
# Only balls are learnt from these: feet on the field are none.
WITH_PEOPLE: list[tuple[str, int, list[str]]] = [
    ("p", 401, ["people.count=6", "people.on_field=0.6", "ball.position=[0.5,1.0]"]),
]
Y1_CENTRE_PX = (241.0, 239.0)
Y1_RIM_PX = 236
Y1_SCALE = 1.15


def drives(sets: list[tuple[str, int, list[str]]]) -> list[str]:
    """Names of the simulated recordings of sets, in the order of training."""
    return [f"{name}_{scenario}" for name, _, _ in sets for scenario in SCENARIOS]


def simulate(mirrorball: Path, out: Path) -> None:
    """Simulates and exports all drives."""
    scenarios = Path(__file__).parents[2] / "config" / "scenarios"
    for name, first_seed, extra in SETS + WITH_PEOPLE:
        for number, scenario in enumerate(SCENARIOS):
            folder, log = out / f"{name}_{scenario}", out / f"{name}_{scenario}.mcap"
            settings = [part for setting in SETTINGS + extra for part in ("--set", setting)]
            drive = [str(scenarios / f"{scenario}.toml"), "--seed", str(first_seed + number), "--duration", DURATION_S]
            subprocess.run([mirrorball, "sim", *drive, *settings, "--record", log], check=True, stdout=subprocess.DEVNULL)
            subprocess.run([mirrorball, "replay", log, "--export", folder], check=True, stdout=subprocess.DEVNULL)
            log.unlink()


def enlarged_map(sister: Path, size_px: int) -> dict[str, np.ndarray]:
    """A sister robot's map, read `Y1_SCALE` times as far from the axis."""
    centre = tomllib.loads((sister / "robot.toml").read_text())["camera"]["centre_px"]
    rows, columns = np.mgrid[0:size_px, 0:size_px]
    u = np.round((columns - Y1_CENTRE_PX[0]) * Y1_SCALE + centre[0]).astype(int)
    v = np.round((rows - Y1_CENTRE_PX[1]) * Y1_SCALE + centre[1]).astype(int)
    inside = (u >= 0) & (u < size_px) & (v >= 0) & (v < size_px)
    with np.load(sister / "map.npz") as arrays:
        maps = {name: arrays[name][v.clip(0, size_px - 1), u.clip(0, size_px - 1)] for name in ("x_m", "y_m")}
    return {name: np.where(inside, values, np.nan).astype(values.dtype) for name, values in maps.items()}


def calibrate_y1(mirrorball: Path, labelled: Path, out: Path) -> None:
    """Copies labelled_Y1, with its axis, rim and the map that its own lines give."""
    folder = out / "labelled_Y1"
    shutil.copytree(labelled / "labelled_Y1", folder)
    robot = f"""field = "field.toml"
[camera]
width_px = 480
height_px = 480
centre_px = [{Y1_CENTRE_PX[0]}, {Y1_CENTRE_PX[1]}]
forward_deg = 90.0
flipped = false
"""
    map_file = '[map]\nfile = "map.npz"\n'
    (folder / "robot.toml").write_text(f"{robot}outer_radius_px = {Y1_RIM_PX}\n{map_file}")
    np.savez(folder / "map.npz", **enlarged_map(labelled / "labelled_Y3", 480))
    calibrated = folder / "calibrated.npz"
    subprocess.run([mirrorball, "calibrate", "lines", folder, "--out", calibrated], check=True, stdout=subprocess.DEVNULL)
    calibrated.replace(folder / "map.npz")
    # Training reads a little less than the rim shows.
    (folder / "robot.toml").write_text(robot + map_file)


def main() -> None:
    """Makes all recordings in a new folder."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--mirrorball", type=Path, required=True)
    parser.add_argument("--labelled", type=Path, required=True, metavar="REAL")
    parser.add_argument("--out", type=Path, required=True)
    args = parser.parse_args()
    mirrorball = args.mirrorball.resolve()
    args.out.mkdir(parents=True)
    calibrate_y1(mirrorball, args.labelled, args.out)
    shutil.copytree(args.labelled / "labelled_Y3", args.out / "labelled_Y3")
    simulate(mirrorball, args.out)


if __name__ == "__main__":
    main()
