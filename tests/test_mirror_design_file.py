"""Design files, reports and rendered images, and the messages about invalid ones."""

import contextlib
import re
import time
from pathlib import Path
from xml.etree import ElementTree

import matplotlib.image
import numpy as np
import pytest

from mirrorball import Camera, Field, GroundMap, Mount, Profile, ground_map, render, trace_rays
from mirrorball.mirror import Planar, design, fit_camera, judge, lima2001, load, nubot2013, plot_worker, report, reporting, view
from mirrorball.mirror.plot_worker import PlotWorker

ROOT = Path(__file__).parents[1]
VALID_DESIGN = """
apex = 0.2
[camera]
width_px = 480
height_px = 480
focal_px = 500.0
height = 0.6
[[part]]
kind = "horizontally isometric"
until_t = 0.22
until = 6.0
"""


def test_lima2001_toml_equals_reference_design() -> None:
    plan = load(ROOT / "config/mirrors/lima2001.toml")
    ready = lima2001()
    assert [part.part for part in plan.mirror.segments] == [part.part for part in ready.segments]
    assert plan.mirror.samples()[1] == pytest.approx(ready.samples()[1], abs=1e-12)
    assert plan.tolerances.tilt_deg == 0.2 and plan.lens.f_number == 2.0


def test_freeform_points_are_met(tmp_path: Path) -> None:
    points = "[[0, 0, 0], [0.1, 1.5, 0], [0.2, 4.0, 0.1], [0.3, 8.0, 0.3]]"
    free = VALID_DESIGN[: VALID_DESIGN.index("[[part]]")] + f'[[part]]\nkind = "free"\npoints = {points}\n'
    (tmp_path / "free.toml").write_text(free)
    mirror = load(tmp_path / "free.toml").mirror
    rays = mirror.rays(np.array([0.1, 0.2, 0.3]))
    assert rays.distance_at_m(0.1)[1] == pytest.approx(4.0, abs=1e-9)
    assert rays.distance_at_m(0.3)[2] == pytest.approx(8.0, abs=1e-9)


@pytest.mark.parametrize(
    ("wrong", "right", "words"),
    [
        ("until = 6.0", "untill = 6.0", r"part 1 \(horizontally isometric\): unknown key 'untill'"),
        ("until = 6.0", "", r"part 1 \(horizontally isometric\) needs 'until'"),
        ("until = 6.0", 'until = "far"', "until = 'far' must be a number"),
        ('kind = "horizontally isometric"', 'kind = "magic"', "part 1: no kind 'magic'; there are"),
        ("focal_px = 500.0", "", r"\[camera\] needs 'focal_px'"),
        ("apex = 0.2", "apex = 0.2\nnonsense = 1", "the file: unknown key 'nonsense'"),
        ("until_t = 0.22", "until_t = 0.62", r"part 1 \(horizontally isometric\), at t = 0.6200: the lens"),
        ("apex = 0.2", "apex = ", "line 2"),
    ],
)
def test_design_file_errors_name_file_and_key(wrong: str, right: str, words: str, tmp_path: Path) -> None:
    path = tmp_path / "mirror.toml"
    path.write_text(VALID_DESIGN.replace(wrong, right))
    with pytest.raises(ValueError, match=words) as caught:
        load(path)
    assert str(path) in str(caught.value)


FREE = 'kind = "free"\npoints = [[0.2, 4.0, 0], [0.24, 6.0, 0], [0.27, 7.5, 0], [0.3, 9.0, 0]]'
ISOMETRIC = 'kind = "horizontally isometric"\nuntil_t = 0.22\nuntil = 6.0'


@pytest.mark.parametrize(
    ("wrong", "right", "words"),
    [
        (ISOMETRIC, FREE, r"part 1 \(free\): the points begin at t = 0\.2, but the part at t = 0$"),
        (
            ISOMETRIC,
            f"{ISOMETRIC.replace('0.22', '0.14')}\n[[part]]\n{FREE}",
            r"part 2 \(free\): the points begin at t = 0\.2, but the part at t = 0\.14$",
        ),
        (
            ISOMETRIC,
            f"{ISOMETRIC.replace('0.22', '0.31')}\n[[part]]\n{FREE}",
            r"part 2 \(free\): the points end at t = 0\.3, but the part begins at t = 0\.31$",
        ),
        ("height = 0.6", "height = 10.0", r"height above the ground 10\.2\d* m is out of range \(expected at most 10 m, "),
        ("until = 6.0", "until = 0.0", r"until_m = 0 m is the ground distance where it begins"),
        (ISOMETRIC, 'kind = "cone"\nslope = 1.7\nuntil_t = 0.3', "shows no ground: all its rays go up"),
        (
            ISOMETRIC,
            'kind = "vertically isometric"\nuntil_t = 0.3\nuntil_height = 1.0',
            r"part 1 \(vertically isometric\): needs distance_m",
        ),
        ('"horizontally isometric"', '"isometric"', r"there are .*hyperboloid, free$"),
        ("[camera]", "lens = { focus = 0.003 }\n[camera]", r"focus_m = 0\.003 must exceed focal_length_m = 0\.006"),
        ("[camera]", "tolerances = { tilt_deg = 90 }\n[camera]", r"tilt_deg = 90 must be at most 20"),
    ],
)
def test_design_that_no_robot_can_use_is_rejected(wrong: str, right: str, words: str, tmp_path: Path) -> None:
    path = tmp_path / "mirror.toml"
    assert wrong in VALID_DESIGN
    path.write_text(VALID_DESIGN.replace(wrong, right))
    with pytest.raises(ValueError, match=words) as caught:
        load(path)
    assert str(caught.value).startswith(f"{path}: ")


def test_missing_file_error_lists_reference_designs() -> None:
    with pytest.raises(FileNotFoundError, match="lima2001"):
        load("nowhere.toml")


def test_report_writes_svg_png_and_html(tmp_path: Path) -> None:
    written = report(nubot2013(), folder=tmp_path, mirrors=20, progress=False)
    names = ["profile", "ground", "heights", "surface", "sharpness", "sizes", "tolerances"]
    for name in names:
        ElementTree.parse(tmp_path / f"{name}.svg")
        image = matplotlib.image.imread(tmp_path / f"{name}.png")
        # Something is drawn on it.
        assert image.shape[1] == 1100 and (image[..., :3].min(axis=2) < 0.9).mean() > 0.01
    page = written.page.read_text(encoding="utf-8")
    assert page.count("data:image/png;base64,") == len(names)
    assert "131.80 mm" in page and "hyperboloid" in page
    # It stands alone: nothing is fetched from elsewhere.
    assert not re.search(r'(src|href)="(?!data:)', page)


@pytest.mark.filterwarnings("ignore:.*fork.*:DeprecationWarning")
def test_report_is_identical_with_and_without_plot_worker(tmp_path: Path) -> None:
    report(lima2001(), folder=tmp_path / "first")
    with PlotWorker() as drawer:
        report(lima2001(), folder=tmp_path / "second", drawer=drawer)
    for name in ("index.html", "ground.svg", "ground.png", "surface.svg", "sizes.png"):
        assert (tmp_path / "first" / name).read_bytes() == (tmp_path / "second" / name).read_bytes()


def test_plot_worker_write_failure_raises_os_error(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    with PlotWorker() as drawer, pytest.raises(OSError, match=r"nowhere/ground.svg'$"):
        drawer.draw(judge(lima2001(), focal_px=700.0), ["ground"], tmp_path / "nowhere")
        drawer.finish()
    assert capfd.readouterr().err == ""


@pytest.mark.filterwarnings("ignore:.*fork.*:DeprecationWarning")
def test_error_of_a_report_is_not_hidden_by_figures_that_are_still_drawn(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def draw_on(_subject: object, _names: object, folder: Path) -> None:
        end = time.monotonic() + 3.0
        while time.monotonic() < end:
            with contextlib.suppress(OSError):
                folder.mkdir(exist_ok=True)
                (folder / f"{time.monotonic_ns() % 100}.svg").touch()

    def fail_while_drawing(*_: object, **__: object) -> None:
        while not list(tmp_path.glob(".report-*/*.svg")):
            time.sleep(0.01)
        raise ValueError("no such mirror")

    monkeypatch.setattr(plot_worker, "draw", draw_on)
    monkeypatch.setattr(reporting, "monte_carlo", fail_while_drawing)
    with PlotWorker() as drawer, pytest.raises(ValueError, match="no such mirror"):
        report(lima2001(), folder=tmp_path, mirrors=20, progress=False, drawer=drawer)
    assert not list(tmp_path.iterdir())


def test_rendered_ball_lies_at_isometric_radius() -> None:
    mirror = lima2001()
    camera = fit_camera(mirror)
    image = view(mirror, pose=(-1.0, 0.0, 0.0), ball=(1.0, 0.0), own_body=False)
    assert image.shape == (480, 480, 3) and image.dtype == np.uint8
    # Forward is up in the image; the ball's bottom two metres ahead lies at its isometric radius, and it is orange.
    red, green, blue = (image[..., colour].astype(int) for colour in range(3))
    v, u = np.nonzero((red > 140) & (red > green + 40) & (green > blue + 20))
    near = np.hypot(u - 239.5, v - 239.5) < camera.focal_px * 0.22
    radius = 239.5 - v[near].max()
    wanted = camera.focal_px * 0.22 / 6.0 * 2.0
    assert np.abs(u[near] - 239.5).max() < 15 and wanted - 2.0 < radius < wanted + 3.0
    # The black ring is black.
    ring = mirror.segment("black ring")
    middle = int(camera.focal_px * (ring.t_from + ring.t_to) / 2.0)
    assert (image[240, 239 + middle] == 0).all()


def test_rendering_is_deterministic() -> None:
    mirror = nubot2013()
    camera, profile = fit_camera(mirror, size_px=200), mirror.profile()
    first, second, other = (
        render(camera=camera, profile=profile, field=Field(), pose=(1.0, 2.0, 0.5), seed=seed) for seed in (3, 3, 4)
    )
    assert (first == second).all() and (first != other).any()


def test_ground_map_matches_traced_rays_and_round_trips(tmp_path: Path) -> None:
    mirror = lima2001()
    camera, profile = fit_camera(mirror, size_px=120), mirror.profile()
    made = ground_map(camera=camera, profile=profile, mount=Mount(mirror_tilt_deg=(0.5, 0.0)))
    origin, direction = trace_rays(camera=camera, profile=profile, mount=Mount(mirror_tilt_deg=(0.5, 0.0)))
    assert made.x_m.shape == (120, 120) and made.x_m.dtype == np.float32
    down = direction[..., 2] < -1e-3
    x = origin[..., 0] - origin[..., 2] / direction[..., 2] * direction[..., 0]
    assert np.allclose(made.x_m[down], x[down], rtol=1e-4, atol=1e-4)
    made.save(tmp_path / "map.npz")
    read = GroundMap.load(tmp_path / "map.npz")
    assert np.array_equal(made.y_m, read.y_m, equal_nan=True)
    with np.load(tmp_path / "map.npz") as archive:
        assert np.array_equal(archive["x_m"], made.x_m, equal_nan=True)


def test_ground_map_arrays_are_not_copied() -> None:
    mirror = lima2001()
    made = ground_map(camera=fit_camera(mirror, size_px=64), profile=mirror.profile())
    assert made.x_m is made.x_m and made.x_m.flags.c_contiguous


def test_invalid_arguments_raise_builtin_exceptions(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError, match=r"none\.csv"):
        Profile.load(tmp_path / "none.csv")
    with pytest.raises(FileNotFoundError, match=r"none\.toml"):
        Field(tmp_path / "none.toml")
    with pytest.raises(ValueError, match="folds back"):
        Profile(radius_m=np.array([0.0, 0.1, 0.2, 0.15, 0.3]), height_m=np.ones(5))
    with pytest.raises(ValueError, match=r"invalid focal_px: -5.0 \(expected a number above 0\)"):
        Camera(width_px=10, height_px=10, focal_px=-5.0, pinhole_height_m=0.6)
    with pytest.raises(ValueError, match="focal_px"):
        trace_rays(camera=Camera(width_px=10, height_px=10), profile=lima2001().profile())
    with pytest.raises(ValueError, match="finite"):
        render(camera=fit_camera(lima2001()), profile=lima2001().profile(), field=Field(), pose=(float("nan"), 0.0, 0.0))


@pytest.mark.parametrize(
    ("wrong", "said"),
    [
        ("apex = 1e300", "apex = 1e+300 must be positive, and at most 5 metres"),
        ("apex = true", "apex = True must be a number"),
        ("apex = 0.2\nreach = 0", "reach = 0 must be positive"),
        ("apex = 0.2\nname = '../x'", "must do as a file's name"),
        ("apex = 0.2\nlens = 3", "lens"),
        ("apex = 0.2\nlens = { f_number = 0.0 }", "f_number = 0 must be positive"),
        ("apex = 0.2\ntolerances = { form = -1.0 }", "form_m = -1 must not be negative"),
    ],
)
def test_invalid_values_name_file_and_key(tmp_path: Path, wrong: str, said: str) -> None:
    camera = "[camera]\nwidth_px = 480\nheight_px = 480\nfocal_px = 700.0\nheight = 0.6\n"
    path = tmp_path / "slip.toml"
    path.write_text(f"{wrong}\n{camera}[[part]]\nkind = 'planar'\nuntil_t = 0.2\n")
    with pytest.raises(ValueError, match=r"slip\.toml") as refused:
        load(path)
    assert said in str(refused.value)


def test_report_of_flat_mirror_succeeds(tmp_path: Path) -> None:
    flat = design([Planar(until_t=0.2)], pinhole_height_m=0.6, apex_above_pinhole_m=0.2)
    assert report(flat, folder=tmp_path).page.exists()
    assert not list(tmp_path.glob(".report-*"))
