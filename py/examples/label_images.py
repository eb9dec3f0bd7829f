"""Label the colours of a folder of images, for `mirrorball calibrate colours --labels`.

`python label_images.py samples/sequence --box 000.jpg 210 80 230 95 goal_blue` labels every pixel of a box (columns and rows
of two corners) in an image of the recording. `--confirmed` adds confident detections: carpet beside line points, the points
themselves, the ball. A picture of each image with its labels shows whether they are right.
"""

import argparse
import csv
from pathlib import Path

import cv2
import numpy as np

import mirrorball
from mirrorball import vision

Label = tuple[str, int, int, str]
STEP_PX = 3  # labels this far apart: neighbours are alike


def box_labels(name: str, corners: tuple[int, int, int, int], word: str) -> list[Label]:
    """Labels all over a box."""
    u0, v0, u1, v1 = corners
    columns = range(min(u0, u1), max(u0, u1) + 1, STEP_PX)
    return [(name, u, v, word) for u in columns for v in range(min(v0, v1), max(v0, v1) + 1, STEP_PX)]


def confirmed_labels(name: str, seen: vision.Detections, centre_px: tuple[float, float]) -> list[Label]:
    """Lines, the carpet before them, and the ball's middle."""
    labels: list[Label] = []
    for point in seen.points[seen.points["contrast"] > np.median(seen.points["contrast"])]:
        u, v = float(point["u_px"]), float(point["v_px"])
        labels.append((name, round(u), round(v), "line"))
        # A tenth of the way towards the robot there is carpet: lines lie farther apart.
        away = np.array([u, v]) - centre_px
        u, v = np.array(centre_px) + 0.9 * away
        labels.append((name, round(u), round(v), "carpet"))
    labels += [(name, round(float(b["u_px"])), round(float(b["v_px"])), "ball") for b in seen.ball if b["score"] > 0.5]
    return labels


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path, help="a recording: robot.toml, images")
    parser.add_argument("--box", nargs=6, action="append", default=[], metavar=("FILE", "U0", "V0", "U1", "V1", "CLASS"))
    parser.add_argument("--confirmed", action="store_true", help="also label confident detections")
    parser.add_argument("--out", type=Path, default=Path("labels"), help="where labels.csv and the pictures go")
    arguments = parser.parse_args()
    with (arguments.folder / "frames.csv").open(newline="") as table:
        files = [row["file"] for row in csv.DictReader(table)]
    labels: list[Label] = []
    for name, u0, v0, u1, v1, word in arguments.box:
        # By its path in frames.csv, or by its name alone.
        found = [file for file in files if name in (file, Path(file).name)]
        if len(found) != 1:
            parser.error(f"{name}: {len(found)} images of this name in {arguments.folder / 'frames.csv'}")
        labels += box_labels(found[0], (int(u0), int(v0), int(u1), int(v1)), word)
    if arguments.confirmed:
        camera = mirrorball.Camera.load(arguments.folder / "robot.toml")
        profile = mirrorball.Profile.load(arguments.folder / "mirror.csv")
        detector = vision.Vision(map=mirrorball.ground_map(camera=camera, profile=profile), camera=camera)
        for file in files:
            detector.reset_colour_model()
            image = cv2.imread(str(arguments.folder / file))
            if image is None:
                raise FileNotFoundError(arguments.folder / file)
            labels += confirmed_labels(file, detector.process(image), camera.centre_px)
    arguments.out.mkdir(parents=True, exist_ok=True)
    with (arguments.out / "labels.csv").open("w", newline="") as table:
        writer = csv.writer(table)
        writer.writerow(["file", "u", "v", "class"])
        writer.writerows((str((arguments.folder / name).resolve()), u, v, word) for name, u, v, word in labels)
    for name in sorted({name for name, *_ in labels}):
        picture = cv2.imread(str(arguments.folder / name))
        if picture is None:
            raise FileNotFoundError(arguments.folder / name)
        for _, u, v, word in (label for label in labels if label[0] == name):
            # Any colour will do that is the same for the same word.
            colour = tuple(int(c) for c in np.random.default_rng(list(word.encode())).integers(80, 255, 3))
            cv2.circle(picture, (u, v), 1, colour, -1)
        cv2.imwrite(str(arguments.out / f"{Path(name).stem}_labels.png"), picture)
    print(f"{len(labels)} labels: {arguments.out / 'labels.csv'}")


if __name__ == "__main__":
    main()
