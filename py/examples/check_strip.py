"""Check a strip calibration as nubot2013 made its own: OpenCV's Canny finds the strip's edges, the map says how far they are.

`python check_strip.py samples/calibration --map map.npz` walks along the strip in each image and compares the distances
of Canny's edges with those of strip.toml.
"""

import argparse
import csv
import tomllib
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

import mirrorball

MAX_EDGE_DISTANCE_M = 0.08  # an edge farther off than this from where it should be is another one
SCAN_LINES = 5  # parallel walks over the strip's middle half; their median bridges noise


def edges_along(canny: NDArray[np.uint8], places_px: NDArray[np.float64]) -> NDArray[np.intp]:
    """Indices of the places along a walk at which Canny marked an edge."""
    u, v = np.round(places_px).astype(int).T
    inside = (u >= 0) & (v >= 0) & (u < canny.shape[1]) & (v < canny.shape[0])
    marked = np.zeros(len(places_px), dtype=bool)
    marked[inside] = canny[v[inside], u[inside]] > 0
    return np.flatnonzero(marked)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path, help="robot.toml, strip.toml, strip.csv and images")
    parser.add_argument("--map", type=Path, required=True, help="the calibrated map (npz)")
    arguments = parser.parse_args()
    ground = mirrorball.GroundMap.load(arguments.map)
    strip = tomllib.loads((arguments.folder / "strip.toml").read_text())
    wanted = strip["first_edge"] + strip["spacing"] * np.arange(strip["bars"] + 1)
    known = np.isfinite(ground.x_m)
    pixels = np.argwhere(known)[:, ::-1].astype(float)
    places = np.stack([ground.x_m[known], ground.y_m[known]], axis=1)
    all_off: list[float] = []
    with (arguments.folder / "strip.csv").open(newline="") as table:
        rows = list(csv.DictReader(table))
    for row in rows:
        grey = cv2.imread(str(arguments.folder / row["file"]), cv2.IMREAD_GRAYSCALE)
        if grey is None:
            raise FileNotFoundError(arguments.folder / row["file"])
        canny = np.asarray(cv2.Canny(cv2.GaussianBlur(grey, (3, 3), 0), 40, 100), dtype=np.uint8)
        direction = float(row["direction_rad"])
        along = np.array([np.cos(direction), np.sin(direction)])
        across = np.array([-along[1], along[0]])
        found: list[float] = []
        for side in np.linspace(-0.25, 0.25, SCAN_LINES) * strip["width"]:
            # Pixels that show this walk, in the order of their distance.
            off = places @ across - side
            distance = places @ along
            near = (np.abs(off) < 0.02) & (distance > 0)
            order = np.argsort(distance[near])
            walk, distances = pixels[near][order], distance[near][order]
            marks = edges_along(canny, walk)
            found += [float(distances[mark]) for mark in marks]
        for edge in wanted:
            close = [distance - edge for distance in found if abs(distance - edge) < MAX_EDGE_DISTANCE_M]
            if close:
                all_off.append(float(np.median(close)))
    off_cm = 100 * np.abs(all_off)
    print(f"{len(all_off)} of {len(rows) * len(wanted)} edges found by Canny in {len(rows)} images")
    print(f"distance from the map's value: median {np.median(off_cm):.1f} cm, 95 % below {np.percentile(off_cm, 95):.1f} cm")


if __name__ == "__main__":
    main()
