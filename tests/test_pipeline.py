"""The pipeline in Python against the command line: the same numbers, other people's line points, other threads."""

import copy
import csv
import pickle
import subprocess
import threading
from itertools import pairwise
from pathlib import Path

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

import mirrorball
from mirrorball import Camera, Cycle, Field, GroundMap, Localizer, Mount, Pipeline, Profile, Simulation
from mirrorball.samples import ImageSample, Sample, TruthSample

ROOT = Path(__file__).parents[1]
PROGRAM = ROOT / "target/release/mirrorball"
SEQUENCE = ROOT / "samples/sequence"
FIELD = ROOT / "config/fields/msl_18x12.toml"


def rows(path: Path) -> list[dict[str, str]]:
    with path.open(newline="") as table:
        return list(csv.DictReader(table))


def cycles_of_recording(folder: Path, pipeline: Pipeline) -> list[Cycle]:
    events: list[tuple[float, int, dict[str, str]]] = []
    events += [(float(row["stamp_s"]), 1, row) for row in rows(folder / "odometry.csv")]
    events += [(float(row["stamp_s"]), 2, row) for row in rows(folder / "compass.csv")]
    events += [(float(row["stamp_s"]), 3, row) for row in rows(folder / "frames.csv")]
    found = []
    for stamp_s, kind, row in sorted(events, key=lambda event: event[:2]):
        if kind == 1:
            pipeline.odometry(stamp_s, [float(row[name]) for name in ("dx_m", "dy_m", "dtheta_rad")])
        elif kind == 2:
            pipeline.compass(stamp_s, float(row["heading_rad"]))
        else:
            image = cv2.imread(str(folder / row["file"]))
            assert image is not None
            found.append(pipeline.image(stamp_s, image))
    return found


@pytest.fixture(scope="module")
def sequence() -> list[Cycle]:
    return cycles_of_recording(SEQUENCE, Pipeline(SEQUENCE))


def test_pipeline_gives_the_poses_of_the_command_line(sequence: list[Cycle], tmp_path: Path) -> None:
    poses, detections = tmp_path / "poses.csv", tmp_path / "seen.csv"
    command: list[str | Path] = [PROGRAM, "locate", SEQUENCE, "--out", poses, "--seen", detections]
    subprocess.run(command, check=True, capture_output=True)
    for cycle, row in zip(sequence, rows(poses), strict=True):
        assert cycle.mode == row["mode"]
        assert cycle.pose is not None
        # The table is rounded to 10 µm, and JPEG decoders differ in the last bit.
        assert cycle.pose.x_m == pytest.approx(float(row["x_m"]), abs=2e-3)
        assert cycle.pose.theta_rad == pytest.approx(float(row["theta_rad"]), abs=1e-3)
        assert np.sqrt(cycle.covariance[0, 0]) == pytest.approx(float(row["std_x_m"]), rel=0.2)
    assert sum(len(cycle.detections.ball) for cycle in sequence if cycle.detections) > 0
    balls = sum(row["kind"] == "ball" for row in rows(detections))
    assert sum(len(cycle.detections.ball) for cycle in sequence if cycle.detections) == pytest.approx(balls, abs=3)


def test_cycle_has_tables_objects_and_figures(sequence: list[Cycle]) -> None:
    last = sequence[-1]
    assert len(last.line_points) > 50
    assert set(last.line_points.dtype.names or ()) == {"x_m", "y_m", "std_radial_m", "std_tangential_m"}
    assert set(last.refused.dtype.names or ()) == {"u_px", "v_px", "reason"}
    assert last.fit.on_markings > 0.5
    assert last.timings_ms["vision"] > 0.0
    assert last.ball is not None
    assert last.ball.field_position_m is not None
    assert np.all(np.linalg.eigvalsh(last.ball.covariance) > 0.0)
    assert repr(last).startswith("Cycle(stamp_s=")


def generated_points(rng: np.random.Generator, pose: tuple[float, float, float]) -> NDArray[np.float64]:
    """Points on some lines of the 18 × 12 field (lines 12.5 cm wide, measured to the outer edges) within 6 m."""
    x, y = 9.0 - 0.0625, 6.0 - 0.0625
    lines = [((-x, -y), (x, -y)), ((-x, y), (x, y)), ((-x, -y), (-x, y)), ((x, -y), (x, y)), ((0, -y), (0, y))]
    on_lines = [np.linspace(start, end, 400) for start, end in lines]
    angles = np.linspace(0.0, 2.0 * np.pi, 200)
    radius = 2.0 - 0.0625
    circle = np.stack([radius * np.cos(angles), radius * np.sin(angles)], axis=1)
    relative = np.concatenate([*on_lines, circle]) - pose[:2]
    cos, sin = np.cos(pose[2]), np.sin(pose[2])
    robot = relative @ np.array([[cos, -sin], [sin, cos]])
    near = robot[np.hypot(robot[:, 0], robot[:, 1]) < 6.0]
    chosen = near[rng.choice(len(near), size=min(120, len(near)), replace=False)]
    return np.asarray(chosen + rng.normal(0.0, 0.03, chosen.shape))


def test_localizer_finds_and_follows_a_pose_from_points_alone() -> None:
    rng = np.random.default_rng(5)
    localizer = Localizer(field=FIELD)
    pose = np.array([2.0, 1.0, 0.3])
    errors, nees = [], []
    for step in range(150):
        stamp_s = step / 30.0
        motion = np.array([0.03, 0.01, 0.01]) if step else np.zeros(3)
        cos, sin = np.cos(pose[2]), np.sin(pose[2])
        pose += [cos * motion[0] - sin * motion[1], sin * motion[0] + cos * motion[1], motion[2]]
        localizer.odometry(stamp_s, motion + rng.normal(0.0, [1e-3, 1e-3, 1e-3]))
        localizer.compass(stamp_s, pose[2] + rng.normal(0.0, 0.05))
        estimate = localizer.points(stamp_s, generated_points(rng, tuple(pose)))
        if step < 30:
            continue
        assert estimate.pose is not None
        error = np.array(estimate.pose) - pose
        error[2] = (error[2] + np.pi) % (2.0 * np.pi) - np.pi
        errors.append(np.hypot(error[0], error[1]))
        nees.append(error @ np.linalg.solve(estimate.covariance, error))
    assert estimate.mode == "tracking"
    assert np.mean(errors) < 0.02
    assert np.mean(nees) / 3.0 < 2.0


def test_invalid_arguments_name_the_argument_and_what_is_expected() -> None:
    pipeline = Pipeline(SEQUENCE)
    with pytest.raises(ValueError, match=r"invalid image: float64 array of shape \[4, 4\] \(expected uint8, rows"):
        pipeline.image(0.0, np.zeros((4, 4)))
    with pytest.raises(ValueError, match=r"invalid image: uint8 array of shape \[4, 4, 4\] \(expected uint8, rows"):
        pipeline.image(0.0, np.zeros((4, 4, 4), dtype=np.uint8))
    with pytest.raises(ValueError, match=r"invalid image: None"):
        pipeline.image(0.0, None)  # type: ignore[arg-type]
    localizer = Localizer(field=Field())
    with pytest.raises(ValueError, match=r"invalid points: .*\(expected numbers, n × 2 or n × 4\)"):
        localizer.points(0.0, [[1.0, 2.0, 3.0]])
    with pytest.raises(ValueError, match="invalid points: NaN"):
        localizer.points(0.0, [[1.0, np.nan]])
    with pytest.raises(ValueError, match=r"invalid motion: .* \(expected three finite numbers\)"):
        localizer.odometry(0.0, [1.0, 2.0])
    with pytest.raises(ValueError, match=r"invalid stamp_s: nan \(expected seconds"):
        localizer.points(float("nan"), [])
    with pytest.raises(ValueError, match=r"localize\.matching\.steps_max"):
        Localizer(field=Field(), config={"localize.matching.steps_max": -1})
    with pytest.raises(FileNotFoundError, match=r"none\.toml"):
        Localizer(field="none.toml")
    with pytest.raises(FileNotFoundError, match="none"):
        Pipeline("none/robot.toml")
    with pytest.raises(ValueError, match=r"invalid index: 99"):
        Simulation(ROOT / "config/scenarios/demo.toml", images=False).place_robot(99, (0.0, 0.0, 0.0))


def test_objects_can_be_copied_pickled_and_compared(sequence: list[Cycle], game: Path) -> None:
    camera, profile = Camera.load(SEQUENCE / "robot.toml"), Profile.load(SEQUENCE / "mirror.csv")
    ground = mirrorball.ground_map(camera=camera, profile=profile)
    objects = [camera, profile, ground, Field(FIELD), Mount(mirror_tilt_deg=(0.1, 0.2)), mirrorball.Log(game), sequence[3]]
    for value in objects:
        for twin in (pickle.loads(pickle.dumps(value)), copy.copy(value), copy.deepcopy(value)):
            assert type(twin) is type(value)
            assert twin == value
            assert repr(twin) == repr(value)
            assert "object at 0x" not in repr(value)
    assert camera != Camera(width_px=480, height_px=480)
    assert eval(repr(camera)) == camera
    assert Field(FIELD) != Field(ROOT / "config/fields/msl_12x8.toml")
    shifted = GroundMap(x_m=np.asarray(ground.x_m + np.float32(0.01)), y_m=ground.y_m)
    assert ground != shifted
    assert sequence[3] != sequence[4]


def cycles_of_simulation(seed: int) -> list[Cycle]:
    simulation = Simulation(ROOT / "config/scenarios/tracks_18x12.toml", seed=seed, duration_s=0.5)
    pipeline = simulation.pipeline()
    cycles = []
    for sample in simulation:
        if cycle := pipeline.process(sample):
            simulation.apply_camera_command(cycle)
            cycles.append(cycle)
    return cycles


def test_simulation_and_pipeline_repeat_the_command_lines_run(tmp_path: Path) -> None:
    poses = tmp_path / "poses.csv"
    scenario = ROOT / "config/scenarios/tracks_18x12.toml"
    command: list[str | Path] = [PROGRAM, "sim", scenario, "--seed", "4", "--duration", "0.5", "--out", poses]
    subprocess.run(command, check=True, capture_output=True)
    cycles = cycles_of_simulation(4)
    for cycle, row in zip(cycles, rows(poses), strict=True):
        if cycle.pose is None:
            assert row["x_m"] == ""
        else:
            assert f"{cycle.pose.x_m:.5f},{cycle.pose.y_m:.5f}" == f"{row['x_m']},{row['y_m']}"


def test_two_threads_give_the_results_of_one() -> None:
    found: dict[int, list[Cycle]] = {}

    def run(seed: int) -> None:
        found[seed] = cycles_of_simulation(seed)

    threads = [threading.Thread(target=run, args=(seed,)) for seed in (1, 2)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert found[1] == cycles_of_simulation(1)
    assert found[1] != found[2]


def test_image_of_another_size_is_refused_with_both_sizes(sequence: list[Cycle]) -> None:
    pipeline = Pipeline(SEQUENCE)
    for rows_px, columns_px in [(0, 0), (240, 320), (480, 481)]:
        wrong = rf"wrong image size: {columns_px} × {rows_px} pixels \(expected 480 × 480"
        with pytest.raises(ValueError, match=wrong):
            pipeline.image(0.0, np.zeros((rows_px, columns_px, 3), np.uint8))
    # A refused image leaves the pipeline as it was.
    assert [cycle.pose for cycle in cycles_of_recording(SEQUENCE, pipeline)] == [cycle.pose for cycle in sequence]


def test_pipeline_in_use_by_another_thread_says_so() -> None:
    pipeline = Pipeline(SEQUENCE)
    image = cv2.imread(str(SEQUENCE / "frames/000.jpg"))
    assert image is not None
    messages: set[str] = set()
    barrier = threading.Barrier(4)

    def run() -> None:
        barrier.wait()
        for k in range(200):
            try:
                pipeline.image(k * 0.03, image)
            except RuntimeError as error:
                messages.add(str(error))
            if messages:
                return

    threads = [threading.Thread(target=run) for _ in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert messages == {"this Pipeline is in use by another thread (expected one Pipeline per thread)"}


def test_steps_drive_the_robot_as_commanded() -> None:
    simulation = Simulation(ROOT / "config/scenarios/tracks_18x12.toml", seed=1, images=False)
    start = simulation.step((0.0, 0.0, 0.0)).truth.pose
    for _ in range(30):
        step = simulation.step((1.0, 0.0, 0.0))
    end = step.truth.pose
    forward = np.cos(start.theta_rad) * (end.x_m - start.x_m) + np.sin(start.theta_rad) * (end.y_m - start.y_m)
    # A second at 1 m/s, less the acceleration.
    assert 0.6 < forward < 1.0
    assert step.image is None
    simulation.kidnap((3.0, -2.0, 1.0))
    assert simulation.step((0.0, 0.0, 0.0)).truth.pose == pytest.approx((3.0, -2.0, 1.0), abs=0.05)


def test_ball_robots_light_and_camera_obey() -> None:
    simulation = Simulation(ROOT / "config/scenarios/demo.toml", seed=1)
    before = simulation.step((0.0, 0.0, 0.0))
    assert before.image is not None
    simulation.place_ball((1.0, 2.0))
    simulation.place_robot(0, (-3.0, 0.0, 0.0))
    simulation.set_camera(exposure=0.25, gain=1.0)
    after = simulation.step((0.0, 0.0, 0.0))
    assert after.image is not None
    assert after.truth.ball == pytest.approx((1.0, 2.0), abs=0.1)
    assert after.truth.robots[0, :2] == pytest.approx((-3.0, 0.0), abs=0.1)
    assert after.image.mean() < 0.6 * before.image.mean()


def test_samples_come_in_order_with_truth_before_each_image() -> None:
    simulation = Simulation(ROOT / "config/scenarios/demo.toml", seed=1, duration_s=0.3)
    samples: list[Sample] = list(simulation)
    stamps = [sample.stamp_s for sample in samples]
    assert stamps == sorted(stamps)
    for before, sample in pairwise(samples):
        if isinstance(sample, ImageSample):
            assert isinstance(before, TruthSample) and before.stamp_s == sample.stamp_s
    assert {type(sample).__name__ for sample in samples} >= {"OdometrySample", "ImuSample", "CommandSample", "ImageSample"}
