"""Writes the profiles of this folder: radius_m,height_m (above the ground).

isometric_2001.csv  horizontally isometric to 6 m, constant curvature to 0.6 m height at 11.2 m, flat rim (lima2001 2.2 to 2.4)
isometric.csv       horizontally isometric all the way to 9 m (nubot2013)
hyperbolic.csv      hyperboloid with the pinhole in its second focus: one viewpoint

Needs Python alone: python3 make_profiles.py
"""

from math import atan, sqrt, tan
from pathlib import Path

SAMPLE_STEP = 0.0002  # metres between samples


def isometric(pinhole: float, apex: float, eta: float, t_end: float) -> list[tuple[float, float]]:
    """The design equation with h = 0 and d = eta * t, by Runge and Kutta from the apex (height over the pinhole)."""

    def slope(x: float, y: float) -> float:
        t = x / y
        return tan((atan((eta * t - x) / (y + pinhole)) - atan(t)) / 2)

    points = [(0.0, apex)]
    while points[-1][0] / points[-1][1] < t_end:
        x, y = points[-1]
        k1 = slope(x, y)
        k2 = slope(x + SAMPLE_STEP / 2, y + SAMPLE_STEP / 2 * k1)
        k3 = slope(x + SAMPLE_STEP / 2, y + SAMPLE_STEP / 2 * k2)
        k4 = slope(x + SAMPLE_STEP, y + SAMPLE_STEP * k3)
        points.append((x + SAMPLE_STEP, y + SAMPLE_STEP * (k1 + 2 * k2 + 2 * k3 + k4) / 6))
    return points


def constant_curvature(
    points: list[tuple[float, float]], pinhole: float, t_end: float, distance: float, height: float
) -> list[tuple[float, float]]:
    """From the last point on, slopes grow evenly to the one that shows `height` at `distance` on the ray t_end."""
    (x0, y0), (x1, y1) = points[-2:]
    start = (y1 - y0) / (x1 - x0)

    def miss(x_end: float) -> float:
        y_end = x_end / t_end
        end = tan((atan((distance - x_end) / (y_end + pinhole - height)) - atan(t_end)) / 2)
        return y1 + (start + end) / 2 * (x_end - x1) - y_end

    low, high = x1, 3 * x1
    for _ in range(60):
        middle = (low + high) / 2
        low, high = (middle, high) if miss(middle) > 0 else (low, middle)
    x_end = (low + high) / 2
    y_end = x_end / t_end
    end = tan((atan((distance - x_end) / (y_end + pinhole - height)) - atan(t_end)) / 2)
    count = round((x_end - x1) / SAMPLE_STEP)
    for i in range(1, count + 1):
        way = (x_end - x1) * i / count
        bend = (end - start) / (x_end - x1)
        points.append((x1 + way, y1 + start * way + bend * way * way / 2))
    return points


def planar(points: list[tuple[float, float]], t_end: float) -> list[tuple[float, float]]:
    """A flat rim from the last point to the ray t_end."""
    x0, y = points[-1]
    count = round((y * t_end - x0) / SAMPLE_STEP)
    return points + [(x0 + (y * t_end - x0) * i / count, y) for i in range(1, count + 1)]


def hyperbolic(a: float, c: float, radius: float) -> list[tuple[float, float]]:
    """Foci at the pinhole and 2c above it, vertex a beyond the middle."""
    b2 = c * c - a * a
    count = round(radius / SAMPLE_STEP)
    return [(radius * i / count, c + a * sqrt(1 + (radius * i / count) ** 2 / b2)) for i in range(count + 1)]


def write(name: str, points: list[tuple[float, float]], pinhole: float) -> None:
    rows = "".join(f"{x:.7f},{y + pinhole:.9f}\n" for x, y in points)
    (Path(__file__).parent / name).write_text("radius_m,height_m\n" + rows)


if __name__ == "__main__":
    inner = isometric(0.60, 0.20, 6 / 0.22, 0.22)
    write("isometric_2001.csv", planar(constant_curvature(inner, 0.60, 0.30, 11.2, 0.6), 0.32), 0.60)
    write("isometric.csv", isometric(0.60, 0.17, 9 / 0.32, 0.32), 0.60)
    write("hyperbolic.csv", hyperbolic(0.05, 0.10, 0.14), 0.55)
