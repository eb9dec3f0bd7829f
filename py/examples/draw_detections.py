"""Draw the detections into a recording's images: `python draw_detections.py samples/sequence out/`."""

import argparse
import csv
from pathlib import Path

import cv2
import numpy as np

import mirrorball
from mirrorball import vision

POINT, REJECTED, BALL, ROBOT, GOAL = (60, 0, 255), (0, 200, 255), (0, 140, 255), (255, 120, 0), (255, 255, 0)


def draw(image: vision.Image, seen: vision.Detections, *, scale: int = 2) -> vision.Image:
    """A larger copy with points, refused runs, ball, robots and goals drawn in."""
    drawn = cv2.resize(image, None, fx=scale, fy=scale, interpolation=cv2.INTER_NEAREST)
    if drawn.ndim == 2:
        drawn = cv2.cvtColor(drawn, cv2.COLOR_GRAY2BGR)

    def place(row: np.void) -> tuple[int, int]:
        # The middle of a pixel lies half a pixel from its corner.
        return round(scale * (float(row["u_px"]) + 0.5)), round(scale * (float(row["v_px"]) + 0.5))

    for row in seen.refused:
        cv2.circle(drawn, place(row), 1, REJECTED, -1)
    for row in seen.points:
        cv2.circle(drawn, place(row), 2, POINT, -1)
    for rows, colour, name in ((seen.ball, BALL, "ball"), (seen.robots, ROBOT, "robot"), (seen.goals, GOAL, "goal")):
        for row in rows:
            u, v = place(row)
            cv2.circle(drawn, (u, v), 10, colour, 2)
            word = f"{name} {np.hypot(row['x_m'], row['y_m']):.1f} m"
            cv2.putText(drawn, word, (u + 12, v), cv2.FONT_HERSHEY_SIMPLEX, 0.5, colour, 1, cv2.LINE_AA)
    return np.asarray(drawn, dtype=np.uint8)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path, help="a recording: robot.toml, frames.csv")
    parser.add_argument("out", type=Path, help="where the pictures go")
    parser.add_argument("--map", type=Path, help="a calibrated map; else the one that the mirror should have")
    arguments = parser.parse_args()
    camera = mirrorball.Camera.load(arguments.folder / "robot.toml")
    ground = arguments.map or mirrorball.ground_map(
        camera=camera, profile=mirrorball.Profile.load(arguments.folder / "mirror.csv")
    )
    detector = vision.Vision(map=ground, camera=camera)
    arguments.out.mkdir(parents=True, exist_ok=True)
    with (arguments.folder / "frames.csv").open(newline="") as table:
        names = [row["file"] for row in csv.DictReader(table)]
    for name in names:
        image = cv2.imread(str(arguments.folder / name))
        if image is None:
            raise FileNotFoundError(arguments.folder / name)
        detector.reset_colour_model()
        seen = detector.process(image)
        cv2.imwrite(str(arguments.out / f"{Path(name).stem}.png"), draw(image, seen))
        print(f"{name}: {len(seen.points)} points, {len(seen.ball)} ball, {len(seen.robots)} robots, {len(seen.goals)} goals")


if __name__ == "__main__":
    main()
