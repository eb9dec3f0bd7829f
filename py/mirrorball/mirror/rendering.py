"""Rendered images of a robot with this mirror, and a figure of profile and image."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from mirrorball._core import Camera, Field, Mount, render
from mirrorball.arguments import checked
from mirrorball.mirror.profile_design import Mirror
from mirrorball.mirror.reporting import fit_camera

if TYPE_CHECKING:
    from matplotlib.figure import Figure


@checked
def view(
    mirror: Mirror,
    *,
    pose: tuple[float, float, float] = (0.0, 0.0, 0.0),
    camera: Camera | None = None,
    field: Field | None = None,
    mount: Mount | None = None,
    ball: tuple[float, float] | None = None,
    robots: Sequence[tuple[float, float, float]] = (),
    own_body: bool = True,
) -> NDArray[np.uint8]:
    """Image (rows × columns × red, green, blue) from a pose x, y (metres), θ (radians) on a field.

    Without a camera one whose image the mirror fills; without a field the league's of 18 × 12 m. Black rings stay black.
    """
    camera = camera or fit_camera(mirror)
    image = render(
        camera=camera,
        profile=mirror.profile(),
        field=field or Field(),
        pose=pose,
        mount=mount,
        ball=ball,
        robots=list(robots),
        own_body=own_body,
    )
    u, v = np.meshgrid(np.arange(camera.width_px), np.arange(camera.height_px))
    t = np.hypot(u - camera.centre_px[0], v - camera.centre_px[1]) / camera.focal_px
    for segment in mirror.segments:
        if not segment.reflects:
            image[(t > segment.t_from) & (t <= segment.t_to)] = 0
    return image


@checked
def plot_profile_and_image(mirror: Mirror, image: NDArray[np.uint8]) -> Figure:
    """The profile from rim to rim, as the papers draw it, next to the image that it gives."""
    from matplotlib.figure import Figure

    from mirrorball.mirror.figures import PART_COLOURS

    figure = Figure(figsize=(10.5, 4.8), dpi=100)
    left, right = figure.add_axes((0.07, 0.13, 0.42, 0.76)), figure.add_axes((0.54, 0.03, 0.43, 0.90))
    number = 0
    for segment in mirror.segments:
        t = np.linspace(segment.t_from, segment.t_to, 200)
        y = segment.height(t)
        colour = PART_COLOURS[number % len(PART_COLOURS)] if segment.reflects else "black"
        number += segment.reflects
        for side in (1.0, -1.0):
            label = segment.part if side > 0.0 else None
            left.plot(1e3 * side * t * y, 1e3 * y, color=colour, linewidth=2.5, label=label)
        seen = segment.rays(t, mirror.pinhole_height_m).distance_at_m(0.0)
        if segment.reflects and np.isfinite(seen[-1]):
            left.annotate(
                f"{seen[-1]:.3g} m",
                (1e3 * t[-1] * y[-1], 1e3 * y[-1]),
                xytext=(4, -12),
                textcoords="offset points",
                fontsize=8,
                color=colour,
            )
    left.set_aspect("equal", adjustable="datalim")
    left.grid(color="#e4e4e4", linewidth=0.7)
    left.spines[["top", "right"]].set_visible(False)
    left.set(xlabel="radius / mm", ylabel="above the pinhole / mm", title=mirror.name)
    left.legend(frameon=False, fontsize=8, loc="upper center")
    right.imshow(image)
    right.set_axis_off()
    return figure
