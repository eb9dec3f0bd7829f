"""What a workshop and a buyer get: drawing, cost of imperfections, the papers' figures, one's own hall in the mirror."""

import json
import re
import subprocess
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
from scipy.interpolate import CubicSpline

from conftest import ROOT
from mirrorball import Camera, Mount, Profile, ground_map, trace_points
from mirrorball.mirror import (
    REFERENCE_DESIGNS,
    compare_with_papers,
    fit_camera,
    ground_costs,
    judge,
    lima2001,
    load,
    minho_like,
    nubot2013,
    plot_preview,
    preview,
    radius_table,
    sphere_cone_1999,
    write_pdf,
)

SCENARIO = ROOT / "config/scenarios/hall_bright.toml"


@pytest.mark.parametrize("name", REFERENCE_DESIGNS)
def test_radius_table_lies_on_the_profile_and_has_every_end(name: str) -> None:
    mirror = REFERENCE_DESIGNS[name]()
    table = radius_table(mirror)
    radius, height = mirror.samples(step_m=2e-5)
    expected = np.interp(1e-3 * table[:, 0], radius, height) - height[0]
    assert 1e-3 * table[:, 1] == pytest.approx(expected, abs=2e-7)
    for segment in mirror.segments:
        assert np.abs(table[:, 0] - 1e3 * segment.t_to * segment.end()[0]).min() < 1e-6
    # Slopes: those of a curve through the innermost part's own rows.
    end = 1e3 * mirror.segments[0].t_to * mirror.segments[0].end()[0]
    first = table[table[:, 0] <= end + 1e-6]
    curve = CubicSpline(*np.unique(first[:, :2], axis=0).T)
    middle = first[3:-3]
    assert np.degrees(np.arctan(curve(middle[:, 0], 1))) == pytest.approx(middle[:, 2], abs=0.1)


def test_drawing_is_written_with_the_deviation_of_its_table(tmp_path: Path) -> None:
    written = write_pdf(nubot2013(), tmp_path / "mirror.pdf")
    assert written.path.read_bytes().startswith(b"%PDF") and 1e-7 < written.deviation_m < 1e-4
    assert write_pdf(minho_like(), tmp_path / "mirror.png").path.stat().st_size > 20_000


def test_drawing_is_an_a3_sheet_to_scale_as_pdf_and_as_svg(tmp_path: Path) -> None:
    mirror = lima2001()
    page = write_pdf(mirror, tmp_path / "mirror.pdf").path.read_bytes()
    (box,) = re.findall(rb"/MediaBox \[ ([\d. ]+) \]", page)
    assert [float(value) / 72.0 * 25.4 for value in box.split()] == pytest.approx([0.0, 0.0, 420.0, 297.0], abs=0.01)
    root = ElementTree.parse(write_pdf(mirror, tmp_path / "mirror.svg").path).getroot()
    mm = 25.4 / 72.0
    assert [mm * float(root.attrib[side].removesuffix("pt")) for side in ("width", "height")] == pytest.approx([420.0, 297.0])
    # Half the size: the section's rim lies 57.6 mm off the axis on either side, and so do the ends of its parts.
    lines = [path.attrib.get("d", "") for path in root.iter("{http://www.w3.org/2000/svg}path")]
    ends = np.array([mm * float(x) for line in lines for x in re.findall(r"[ML] ([\d.]+) [\d.]+", line)])
    section = [segment.t_to * segment.end()[0] for segment in mirror.segments]
    axis = 115.5
    for radius in section:
        for side in (axis - 500.0 * radius, axis + 500.0 * radius):
            assert np.abs(ends - side).min() < 0.01


def test_design_says_what_it_assumes_and_what_to_build(tmp_path: Path) -> None:
    command: list[str | Path] = [
        ROOT / "target/release/mirrorball",
        "mirror",
        "design",
        "nubot2013",
        "--out",
        tmp_path / "m.csv",
    ]
    text = subprocess.run(command, check=True, capture_output=True, text=True).stdout
    for words in ("a pinhole camera", "looks straight up", "flat floor", "focal_px", "pinhole_height_m", "apex_above_ground_m"):
        assert words in text
    printed = json.loads(subprocess.run([*command, "--json"], check=True, capture_output=True, text=True).stdout)
    # A robot built by these numbers alone sees each part's ground where the design says, by the crates' tracer.
    width, height = map(int, printed["camera"]["image_px"].split(" × "))
    focal, pinhole = printed["camera"]["focal_px"], printed["camera"]["pinhole_height_m"]
    camera = Camera(width_px=width, height_px=height, focal_px=focal, pinhole_height_m=pinhole)
    built = Profile.load(tmp_path / "m.csv")
    assert built.height_m[0] == pytest.approx(printed["apex_above_ground_m"], abs=1e-6)
    assert built.height_m[-1] == pytest.approx(printed["rim_above_ground_m"], abs=1e-6)
    assert 2.0 * built.radius_m[-1] == pytest.approx(printed["diameter_m"], abs=1e-6)
    seen = 0
    for part in printed["parts"]:
        if part["ground_to_m"] is None:
            continue
        u_px = camera.centre_px[0] + focal * (part["until_t"] - 5e-5)
        origin, ray = trace_points(camera=camera, profile=built, u_px=[u_px], v_px=[camera.centre_px[1]])
        distance = np.hypot(*(origin[0, :2] - origin[0, 2] / ray[0, 2] * ray[0, :2]))
        assert distance == pytest.approx(part["ground_to_m"], rel=3e-3)
        seen += 1
    assert seen >= 1


def test_cost_of_a_tilt_is_the_difference_of_two_ground_maps() -> None:
    mirror = lima2001()
    camera = fit_camera(mirror)
    costs = {cost.imperfection: cost for cost in ground_costs(mirror, camera=camera)}
    tilt = costs["mirror tilted by 0.1°"]
    upright = ground_map(camera=camera, profile=mirror.profile())
    tilted = ground_map(camera=camera, profile=mirror.profile(), mount=Mount(mirror_tilt_deg=(0.1, 0.0)))
    distance = np.hypot(upright.x_m, upright.y_m)
    off = np.hypot(tilted.x_m - upright.x_m, tilted.y_m - upright.y_m)
    for wanted in (2.0, 4.0):
        ring = np.abs(distance - wanted) < 0.05
        # A pixel's height on the ground is 5 cm at 4 m.
        found = float(np.sqrt(np.nanmean(off[ring].astype(np.float64) ** 2)))
        assert tilt.rms_m[np.abs(tilt.distance_m - wanted).argmin()] == pytest.approx(found, rel=0.05)
    assert (tilt.largest_m >= tilt.rms_m).all()
    # Far away everything costs more, and a wavy surface most.
    wave = costs["surface wavy by ± 0.01 mm over 10 mm"]
    assert wave.rms_m[-1] > wave.rms_m[3] and wave.rms_m[-1] > tilt.rms_m[-1]


def test_each_paper_s_design_has_its_figures() -> None:
    def figures(name: str) -> dict[str, tuple[str, str]]:
        mirror = REFERENCE_DESIGNS[name]()
        rows = compare_with_papers(judge(mirror, focal_px=500.0))
        return {f"{row.source}: {row.quantity}": (row.paper, row.design) for row in rows}

    own = figures("lima2001")
    for quantity in ("greatest height seen at 11.2 m", "ground in the outermost part"):
        paper, design = own[f"lima2001 2.5: {quantity}"]
        assert design == paper
    assert own["lima2001 2.5: ground without distortion"][1] == "0.00 to 6.00 m"
    old = figures("sphere_cone_1999")
    assert old["lima2001 2.1 (1999): diameter"][1] == "185.0 mm"
    assert old["lima2001 2.1 (1999): farthest ground"][1] == "6.00 m"
    paper, design = figures("nubot2013")["nubot2013 3.1: parts from the axis outwards"]
    assert paper == design
    # A mirror that is none of theirs differs.
    assert figures("minho_like")["lima2001 2.1 (1999): diameter"][1] != "185.0 mm"
    assert sphere_cone_1999().radius_m == pytest.approx(0.0925)


def test_own_hall_is_shown_in_the_design_beside_its_ideal_map(tmp_path: Path) -> None:
    plan = load(ROOT / "config/mirrors/lima2001.toml")
    shown = preview(plan.mirror, scenario=SCENARIO, camera=plan.camera, time_s=0.1)
    assert shown.image.shape == (480, 480, 3) and 0.1 <= shown.time_s < 0.2
    # The scenario's mount is crooked: the map errs, and more so far away.
    assert 0.05 < shown.map_error_m[1] < shown.map_error_m[4] < 1.0
    # The scene's light is 2.4 times that of the empty field.
    assert shown.image.mean() > 1.2 * shown.ideal.mean()
    plot_preview(shown).savefig(tmp_path / "hall.png")
    with pytest.raises(ValueError, match="beyond the scenario"):
        preview(plan.mirror, scenario=SCENARIO, camera=plan.camera, time_s=1e4)
    empty = tmp_path / "empty.toml"
    empty.write_text("seed = 1\n")
    with pytest.raises(ValueError, match="names no robot"):
        preview(plan.mirror, scenario=empty, camera=plan.camera)
