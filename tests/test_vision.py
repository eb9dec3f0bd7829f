"""Vision by Python on images as OpenCV reads them, against the samples' truth."""

import csv
import struct
from pathlib import Path

import cv2
import numpy as np
import pytest

import mirrorball
from mirrorball import Camera, ColourTable, GroundMap, Profile, vision

SEQUENCE = Path(__file__).parents[1] / "samples/sequence"
CALIBRATION = Path(__file__).parents[1] / "samples/calibration"


def image(path: Path, flags: int = cv2.IMREAD_COLOR) -> vision.Image:
    read = cv2.imread(str(path), flags)
    assert read is not None
    return np.asarray(read, dtype=np.uint8)


def rows(path: Path) -> list[dict[str, str]]:
    with path.open(newline="") as table:
        return list(csv.DictReader(table))


@pytest.fixture(scope="module")
def camera() -> Camera:
    return Camera.load(SEQUENCE / "robot.toml")


@pytest.fixture(scope="module")
def ground(camera: Camera) -> GroundMap:
    return mirrorball.ground_map(camera=camera, profile=Profile.load(SEQUENCE / "mirror.csv"))


@pytest.fixture(scope="module")
def first() -> vision.Image:
    return image(SEQUENCE / "frames/000.jpg")


def in_robot_frame(pose: dict[str, str], place: dict[str, str]) -> tuple[float, float]:
    dx, dy = float(place["x_m"]) - float(pose["x_m"]), float(place["y_m"]) - float(pose["y_m"])
    cos, sin = np.cos(float(pose["theta_rad"])), np.sin(float(pose["theta_rad"]))
    return cos * dx + sin * dy, -sin * dx + cos * dy


def test_ball_is_detected_within_15_cm(camera: Camera, ground: GroundMap, first: vision.Image) -> None:
    seen = vision.see(first, map=ground, camera=camera)
    ball = next(row for row in rows(SEQUENCE / "objects.csv") if row["kind"] == "ball")
    x, y = in_robot_frame(rows(SEQUENCE / "truth.csv")[0], ball)
    assert len(seen.ball) == 1 and bool(seen.ball["on_ground"][0])
    assert np.hypot(seen.ball["x_m"][0] - x, seen.ball["y_m"][0] - y) < 0.15


@pytest.mark.parametrize("frame", ["000", "007", "008"])
def test_pole_beside_the_carpet_is_no_ball(camera: Camera, ground: GroundMap, frame: str) -> None:
    seen = vision.see(image(SEQUENCE / f"frames/{frame}.jpg"), map=ground, camera=camera)
    assert len(seen.ball) == 1


def test_line_points_agree_with_the_ground_map(camera: Camera, ground: GroundMap, first: vision.Image) -> None:
    points = vision.see(first, map=ground, camera=camera).points
    assert len(points) > 100
    u, v = np.round(points["u_px"]).astype(int), np.round(points["v_px"]).astype(int)
    off = np.hypot(ground.x_m[v, u] - points["x_m"], ground.y_m[v, u] - points["y_m"])
    assert np.nanmedian(off) < 0.05
    assert np.all(points["std_radial_m"] > 0)


def test_grey_images_and_strided_arrays_are_accepted(camera: Camera, ground: GroundMap, first: vision.Image) -> None:
    grey = image(SEQUENCE / "frames/000.jpg", cv2.IMREAD_GRAYSCALE)
    assert len(vision.see(grey, map=ground, camera=camera).points) > 100
    wide = np.concatenate([first, first], axis=1)[:, : first.shape[1]]
    packed = vision.see(first, map=ground, camera=camera)
    assert np.array_equal(vision.see(wide, map=ground, camera=camera).points, packed.points)


def in_every_order(packed: vision.Image) -> dict[str, vision.Image]:
    """The same image in arrays whose bytes lie in other orders."""
    wide = np.concatenate([packed, packed], axis=1)
    double = np.repeat(np.repeat(packed, 2, axis=0), 2, axis=1)
    return {
        "C": packed,
        "Fortran": np.asfortranarray(packed),
        "negative rows": packed[::-1].copy()[::-1],
        "negative columns": packed[:, ::-1].copy()[:, ::-1],
        "columns of a wider array": wide[:, : packed.shape[1]],
        "each second pixel": double[::2, ::2],
        "last axis first": np.moveaxis(np.moveaxis(packed, -1, 0).copy(), 0, -1),
    }


@pytest.mark.parametrize("flags", [cv2.IMREAD_COLOR, cv2.IMREAD_GRAYSCALE])
def test_result_does_not_depend_on_the_order_of_the_bytes(camera: Camera, ground: GroundMap, flags: int) -> None:
    packed = image(SEQUENCE / "frames/000.jpg", flags)
    expected = vision.see(packed, map=ground, camera=camera)
    assert len(expected.points) > 100
    # Random classes: neighbouring colours differ.
    classes_of_colours = np.random.default_rng(1).integers(0, 2, 1 << 24, dtype=np.uint8).tobytes()
    names = b"other\nwhite"
    table = ColourTable.from_bytes(b"MBCOLOUR" + struct.pack("<3I", 1, 1, len(names)) + names + classes_of_colours)
    classes = table.classify(packed)
    assert 0.1 < np.mean(classes) < 0.9
    line_points = mirrorball.Pipeline(SEQUENCE).image(0.0, packed).line_points
    assert len(line_points) > 100
    for order, array in in_every_order(packed).items():
        assert np.array_equal(array, packed), order
        seen = vision.see(array, map=ground, camera=camera)
        assert np.array_equal(seen.points, expected.points), order
        assert np.array_equal(table.classify(array), classes), order
        cycle = mirrorball.Pipeline(SEQUENCE).image(0.0, array)
        assert np.array_equal(cycle.line_points, line_points), order


def test_image_of_another_size_is_refused_before_it_is_copied(camera: Camera, ground: GroundMap) -> None:
    huge = np.broadcast_to(np.zeros(3, np.uint8), (100_000, 100_000, 3))
    sizes = r"wrong image size: 100000 × 100000 pixels \(expected 480 × 480"
    with pytest.raises(ValueError, match=sizes):
        vision.see(huge, map=ground, camera=camera)
    with pytest.raises(ValueError, match=sizes):
        mirrorball.Pipeline(SEQUENCE).image(0.3, huge)
    with pytest.raises(ValueError, match=r"invalid images\[0\]: uint8 array .* at most 67108864 pixels"):
        vision.calibrate_mask(camera=camera, images=[huge] * 6)
    names = b"other"
    table = ColourTable.from_bytes(b"MBCOLOUR" + struct.pack("<3I", 1, 0, len(names)) + names + bytes(1 << 16))
    with pytest.raises(ValueError, match=r"invalid image: .* at most 67108864 pixels"):
        table.classify(huge[:, :, 0])


def test_camera_is_derived_from_the_ground_map(camera: Camera, ground: GroundMap) -> None:
    found = Camera.of_map(ground)
    assert found.centre_px == pytest.approx(camera.centre_px, abs=0.5)
    assert found.forward_deg == pytest.approx(camera.forward_deg, abs=0.5)
    assert found.flipped == camera.flipped


def test_images_of_wrong_size_or_format_are_rejected(camera: Camera, ground: GroundMap, first: vision.Image) -> None:
    detector = vision.Vision(map=ground, camera=camera)
    with pytest.raises(ValueError, match="480"):
        detector.process(first[:100])
    with pytest.raises(ValueError, match="rows × columns"):
        detector.process(np.zeros((480, 480, 4), dtype=np.uint8))
    with pytest.raises(ValueError, match="black image"):
        detector.process(np.zeros_like(first))
    assert 0.1 < detector.scan_coverage < 0.5


def test_unsupervised_colour_table_classifies_carpet_and_lines(
    camera: Camera, ground: GroundMap, first: vision.Image, tmp_path: Path
) -> None:
    images = [image(SEQUENCE / row["file"]) for row in rows(SEQUENCE / "frames.csv")[::5]]
    table, residuals = vision.learn_colours(map=ground, images=images, camera=camera)
    assert all(residual.left_out is None for residual in residuals)
    classes = table.classify(first)
    points = vision.see(first, map=ground, camera=camera).points
    strong = points[points["contrast"] > np.median(points["contrast"])]
    on_lines = classes[np.round(strong["v_px"]).astype(int), np.round(strong["u_px"]).astype(int)]
    assert np.mean(on_lines == table.names.index("white")) > 0.8
    assert np.mean(classes == table.names.index("carpet")) > 0.2
    table.save(tmp_path / "colours.table")
    assert np.array_equal(ColourTable.load(tmp_path / "colours.table").classify(first), classes)


def test_calibrated_mask_covers_rods_and_not_ground() -> None:
    strip = rows(CALIBRATION / "strip.csv")
    camera = Camera.load(CALIBRATION / "robot.toml")
    free = vision.calibrate_mask(camera=camera, images=[image(CALIBRATION / row["file"]) for row in strip])
    assert free.shape == (camera.height_px, camera.width_px)
    ground = mirrorball.ground_map(camera=camera, profile=Profile.load(CALIBRATION / "mirror.csv"))
    on_floor = np.hypot(ground.x_m, ground.y_m) < 4.0
    assert 0.85 < np.mean(free[on_floor]) < 0.999


def test_measured_line_width_matches_the_ground_map(camera: Camera, ground: GroundMap) -> None:
    images = [image(SEQUENCE / row["file"]) for row in rows(SEQUENCE / "frames.csv")[::2]]
    sizes = vision.calibrate_sizes(map=ground, images=images, camera=camera)
    near = sizes[(sizes["distance_m"] < 4.0) & (sizes["lines"] >= 20)]
    assert len(near) >= 3
    # Blur widens a line that is hardly wider than a pixel.
    assert np.all(np.abs(near["line_px"] - near["line_px_by_map"]) < 1.5)
