"""What the measurements on photographs share: folders, running the program, comparison of poses and of maps.

Photographs without a licence are not part of the repository. They are tried where they lie; where they are not, a measurement
says so and goes on.
"""

import csv
import json
import math
import resource
import shutil
import subprocess
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

ROOT = Path(__file__).resolve().parents[1]
PROGRAM = ROOT / "target/release/mirrorball"
PHOTOGRAPHS = ROOT.parent / "shared/real"

Pose = NDArray[np.float64]


@dataclass
class Outcome:
    """Result of one command."""

    document: dict[str, Any] | None
    message: str
    seconds: float
    cpu_seconds: float


def run(program: Path, *arguments: str | Path) -> Outcome:
    """Runs the program with --json."""
    before, start = resource.getrusage(resource.RUSAGE_CHILDREN), time.monotonic()
    command = [str(program), *map(str, arguments), "--json"]
    done = subprocess.run(command, capture_output=True, text=True)
    seconds, after = time.monotonic() - start, resource.getrusage(resource.RUSAGE_CHILDREN)
    cpu = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    document = json.loads(done.stdout) if done.returncode == 0 else None
    lines = done.stderr.strip().splitlines()
    return Outcome(document, lines[-1] if lines else "", seconds, cpu)


def frames(folder: Path) -> list[dict[str, str]]:
    """The rows of frames.csv."""
    with (folder / "frames.csv").open() as file:
        return list(csv.DictReader(file))


def make_folder(out: Path, sources: Sequence[tuple[Path, list[dict[str, str]]]], field: Path | None = None) -> Path:
    """Makes a recording folder of pictures of other folders.

    Its robot.toml and field are those of the first one, if none is given. The stamps of further folders come after it.
    """
    shutil.rmtree(out, ignore_errors=True)
    out.mkdir(parents=True)
    first = sources[0][0]
    shutil.copy(first / "robot.toml", out / "robot.toml")
    shutil.copy(field or first / "field.toml", out / "field.toml")
    stamp = 0.0
    with (out / "frames.csv").open("w") as file:
        print("stamp_s,file", file=file)
        for folder, rows in sources:
            begin = stamp
            for row in rows:
                stamp = begin + float(row["stamp_s"])
                print(f"{stamp},{(folder / row['file']).resolve()}", file=file)
    return out


def compose(a: Pose, b: Pose) -> Pose:
    """Pose b of a frame, given in the frame a, in the frame of a."""
    sin, cos = math.sin(a[2]), math.cos(a[2])
    return np.array([a[0] + cos * b[0] - sin * b[1], a[1] + sin * b[0] + cos * b[1], a[2] + b[2]])


def difference(a: Pose, b: Pose) -> Pose:
    """Pose b in the frame a."""
    sin, cos = math.sin(a[2]), math.cos(a[2])
    x, y = b[0] - a[0], b[1] - a[1]
    return np.array([cos * x + sin * y, -sin * x + cos * y, wrap(b[2] - a[2])])


def wrap(angle: float) -> float:
    """Angle between -π and π."""
    return math.remainder(angle, 2.0 * math.pi)


HALF_TURN = np.array([0.0, 0.0, math.pi])


@dataclass
class PoseScore:
    """Poses of the pictures of one robot against the truth."""

    total: int
    near: int
    median_m: float
    confidently_wrong: list[str]


def score_poses(poses_csv: Path, truth_csv: Path, near_m: float = 0.15) -> PoseScore:
    """Compares poses with the truth, up to what pictures alone cannot tell.

    That is one offset and rotation of the robot frame for all pictures, mirrored pictures, and the half turn of each
    picture. A pose is confidently wrong if it is beyond `near_m` and beyond three of its standard deviations.
    """
    with poses_csv.open() as file:
        poses = {f"{float(row['stamp_s']):.3f}": row for row in csv.DictReader(file)}
    with truth_csv.open() as file:
        truth = {
            f"{float(row['stamp_s']):.3f}": np.array([float(row[key]) for key in ("x_m", "y_m", "theta_rad")])
            for row in csv.DictReader(file)
        }
    return max((score_one_way(poses, truth, near_m, mirrored) for mirrored in (False, True)), key=lambda score: score.near)


def score_one_way(poses: dict[str, dict[str, str]], truth: dict[str, Pose], near_m: float, mirrored: bool) -> PoseScore:
    """The score if the pictures are mirrored or not."""
    pairs = []
    for stamp, true in truth.items():
        row = poses.get(stamp)
        if row is None or row["x_m"] == "":
            continue
        if mirrored:
            true = np.array([true[0], -true[1], -true[2]])
        pose = np.array([float(row[key]) for key in ("x_m", "y_m", "theta_rad")])
        std = np.array([float(row[key]) for key in ("std_x_m", "std_y_m")])
        pairs.append((stamp, true, pose, std))

    def errors(offset: Pose) -> list[Pose]:
        """Of each pose, in the field frame, after the better half turn."""
        found = []
        for _, true, pose, _ in pairs:
            wanted = compose(true, offset)
            both = [compose(HALF_TURN, pose) if turn else pose for turn in (False, True)]
            apart = [np.array([*(p[:2] - wanted[:2]), wrap(p[2] - wanted[2])]) for p in both]
            found.append(min(apart, key=lambda error: math.hypot(error[0], error[1]) + abs(error[2])))
        return found

    def is_near(error: Pose, distance: float) -> bool:
        return math.hypot(error[0], error[1]) < distance and abs(error[2]) < math.radians(10.0)

    best, most = np.zeros(3), -1
    for _, true, pose, _ in pairs:
        for turned in (pose, compose(HALF_TURN, pose)):
            offset = difference(true, turned)
            count = sum(is_near(error, near_m) for error in errors(offset))
            if count > most:
                best, most = offset, count
    # The offset of all that are near, by their mean in the robot frame.
    for _ in range(5):
        shifts = []
        for (_, true, _, _), error in zip(pairs, errors(best), strict=True):
            if is_near(error, near_m):
                theta = true[2]
                x, y = error[0], error[1]
                shifts.append(
                    [
                        math.cos(theta) * x + math.sin(theta) * y,
                        -math.sin(theta) * x + math.cos(theta) * y,
                        error[2],
                    ]
                )
        if shifts:
            best = best + np.mean(np.array(shifts), axis=0)
    wrong, distances = [], []
    for (stamp, _, _, std), error in zip(pairs, errors(best), strict=True):
        distance = math.hypot(error[0], error[1])
        distances.append(distance)
        if distance > near_m and math.hypot(error[0] / std[0], error[1] / std[1]) > 3.0:
            wrong.append(f"{stamp} ({distance:.2f} m)")
    near = sum(distance <= near_m for distance in distances)
    median = float(np.median(distances)) if distances else math.nan
    return PoseScore(len(truth), near, median, wrong)


def compare_maps(found: NDArray[np.float64], right: NDArray[np.float64], bands: Sequence[tuple[float, float]]) -> list[float]:
    """Median distance of two maps (rows × columns × 2) in bands of range, after the best shift and rotation.

    Also tries the mirrored map: lines cannot tell it.
    """
    results = []
    for sign in (1.0, -1.0):
        p = found * np.array([1.0, sign])
        valid = np.isfinite(p).all(axis=2) & np.isfinite(right).all(axis=2)
        valid &= (np.hypot(*np.moveaxis(right, 2, 0)) < 5.0) & (np.hypot(*np.moveaxis(p, 2, 0)) < 10.0)
        a = p[valid][:, 0] + 1j * p[valid][:, 1]
        b = right[valid][:, 0] + 1j * right[valid][:, 1]
        weight = np.ones(len(a))
        turn, shift = 1.0 + 0.0j, 0.0j
        for _ in range(20):
            mean_a, mean_b = (weight * a).sum() / weight.sum(), (weight * b).sum() / weight.sum()
            turn = (weight * (b - mean_b) * np.conj(a - mean_a)).sum()
            turn /= abs(turn)
            shift = mean_b - turn * mean_a
            weight = 1.0 / (1.0 + (np.abs(turn * a + shift - b) / 0.05) ** 2) ** 2
        apart = np.abs(turn * a + shift - b)
        results.append([float(np.median(apart[(np.abs(b) >= near) & (np.abs(b) < far)])) for near, far in bands])
    return min(results, key=lambda values: values[0])


def load_map(path: Path) -> NDArray[np.float64]:
    """Ground points of a map file: rows × columns × 2, metres."""
    with np.load(path) as file:
        return np.stack([file["x_m"], file["y_m"]], axis=2).astype(np.float64)
