"""Every public class can be pickled, copied, compared and shown; completion shows what is meant; columns have units."""

import copy
import importlib
import multiprocessing
import pickle
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import mirrorball
from conftest import ROOT
from mirrorball import Field, GroundMap, Log, Mount, Pipeline, Pose, Run, Simulation, estimates, samples, vision
from mirrorball import mirror as workshop
from mirrorball.analysis.units import DIMENSIONLESS, UNIT
from mirrorball.estimates import RunnerUp
from mirrorball.mirror.preview import preview
from mirrorball.mirror.tolerances import monte_carlo

DEMO = ROOT / "config/scenarios/demo.toml"
SEQUENCE = ROOT / "samples/sequence"
MODULES = ("", *mirrorball._MODULES)

STATEFUL = {
    "Pipeline": "the state of a robot",
    "Localizer": "the state of a robot",
    "Simulation": "the state of a world",
    "Vision": "the state of a camera's vision",
    "RobotEnv": "an environment with a simulation",
    "DriveToBall": "an environment with a simulation",
}
"""Classes whose objects are processes, not values: they refuse to be pickled."""

NO_OBJECTS = {"Part": "a protocol"}


def along_the_ground(t: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    return 10.0 * t, 0.0 * t


class Samples:
    """An object of each class, made once."""

    def __init__(self, game: Path, folder: Path) -> None:
        self.game, self.folder = game, folder
        self.found: dict[str, Any] = {}

    def objects(self) -> dict[str, Callable[[], Any]]:
        design = workshop.lima2001()
        camera = workshop.fit_camera(design, size_px=120)
        simulation = Simulation(DEMO, seed=1)
        pipeline = simulation.pipeline()
        # A track needs a second image.
        for _ in range(10):
            step = simulation.step((0.5, 0.0, 0.0))
            cycle = next(found for sample in step.samples if (found := pipeline.process(sample)))
        kinds = {type(sample).__name__: sample for sample in step.samples}
        judged = workshop.judge(design, focal_px=camera.focal_px, rays_per_part=30)
        ground = mirrorball.ground_map(camera=camera, profile=design.profile())
        tracked = next(iter(cycle.robots), cycle.ball)
        return {
            "Advice": lambda: estimates.Advice("drive on", (0.5, 0.0, 0.1)),
            "Camera": lambda: camera,
            "Certificate": lambda: estimates.Certificate(120, 0.9, 0.6, 0.5, False),
            "ColourTable": self.colour_table,
            "Cycle": lambda: cycle,
            "Estimate": lambda: cycle.estimate,
            "Field": Field,
            "GroundMap": lambda: ground,
            "Log": lambda: Log(self.game),
            "Mount": lambda: Mount(mirror_tilt_deg=(0.1, 0.2)),
            "Pose": lambda: Pose(1.0, 2.0, 3.0),
            "Profile": design.profile,
            "Run": lambda: Run("a.toml", seed=3, change={"path.speed": 1.0}, files={"a.toml": b"x"}),
            "Fit": lambda: cycle.fit,
            "RunnerUp": lambda: RunnerUp(Pose(0.0, 1.0, 2.0), 0.1),
            "TrackedObject": lambda: tracked,
            "Step": lambda: step,
            "TruthSample": lambda: step.truth,
            "CompassSample": lambda: samples.CompassSample(0.0, 1.0, (0.1, 0.2)),
            "CommandSample": lambda: kinds["CommandSample"],
            "ImageSample": lambda: kinds["ImageSample"],
            "ImuSample": lambda: kinds["ImuSample"],
            "OdometrySample": lambda: kinds["OdometrySample"],
            "Detections": lambda: cycle.detections,
            "Residual": lambda: vision.Residual(0, 10, 0.5, None),
            "LogError": lambda: mirrorball.log.LogError("damaged"),
            "LogMessage": lambda: next(iter(Log(self.game).messages("/odometry"))),
            "Finding": self.finding,
            "Report": lambda: workshop.Report(self.folder, self.folder / "index.html", judged, None),
            "analysis.Report": self.analysis_report,
            "BagTopic": lambda: mirrorball.bags.BagTopic("/a", "b", 3, None),
            "ImportedTopic": self.imported_topic,
            "ImportSummary": lambda: mirrorball.bags.ImportSummary(0.0, 1.0, (self.imported_topic(),), (), ("odd",)),
            "Selection": lambda: mirrorball.bags.Selection(image="/a"),
            "Cone": lambda: workshop.Cone(slope=0.5, until_t=0.3),
            "ConstantCurvature": lambda: workshop.ConstantCurvature(
                until_t=0.3, through_distance_m=1.0, through_height_m=0.5
            ),
            "DesignSpec": lambda: workshop.load(ROOT / "config/mirrors/lima2001.toml"),
            "Export": lambda: workshop.Export(self.folder / "a.stl", 1e-6),
            "Free": lambda: workshop.Free(target=along_the_ground, until_t=0.2),
            "GroundCost": lambda: workshop.ground_costs(design, camera=camera, reach_m=3.0)[0],
            "GroundErrors": lambda: monte_carlo(design, camera=camera, count=10, reach_m=3.0, progress=False),
            "Heights": lambda: workshop.Heights(at_m=5.0, to_height_m=1.0),
            "HorizontallyIsometric": lambda: workshop.HorizontallyIsometric(until_t=0.3, until_m=5.0),
            "Hyperboloid": lambda: workshop.Hyperboloid(eccentricity=1.5, until_t=0.3),
            "Lens": workshop.Lens,
            "MaxDiameter": lambda: workshop.MaxDiameter(diameter_m=0.1),
            "MinCurvatureRadius": lambda: workshop.MinCurvatureRadius(radius_m=0.01),
            "Mirror": lambda: design,
            "ObjectSizes": lambda: judged.sizes,
            "OpticalAnalysis": lambda: judged,
            "OptimisationResult": lambda: workshop.OptimisationResult(
                design, workshop.Free(target=along_the_ground, until_t=0.2), 1.0, (), ()
            ),
            "PaperFigure": lambda: workshop.compare_with_papers(judged)[0],
            "Paraboloid": lambda: workshop.Paraboloid(focal_length_m=0.05, until_t=0.3),
            "Planar": lambda: workshop.Planar(until_t=0.1),
            "Preview": lambda: preview(design, scenario=DEMO, camera=camera, reach_m=2.0),
            "Rays": lambda: judged.views[0].rays,
            "Resolution": lambda: workshop.Resolution(from_m=1.0, to_m=2.0, px_per_m=10.0),
            "Segment": lambda: design.segments[0],
            "Sphere": lambda: workshop.Sphere(radius_m=0.1, until_t=0.2),
            "Tolerances": workshop.Tolerances,
            "VerticallyIsometric": lambda: workshop.VerticallyIsometric(until_t=0.3, until_height_m=1.0),
            "View": lambda: judged.views[0],
            "VisibleHeights": lambda: workshop.visible_heights(judged)[0],
        }  # fmt: skip

    def of(self, name: str) -> Any:
        if not self.found:
            self.found = dict(self.objects())
        return self.found[name]()

    def colour_table(self) -> Any:
        labels = self.folder / "labels.csv"
        image = np.zeros((8, 8, 3), dtype=np.uint8)
        image[:, :4], image[:, 4:] = (30, 120, 40), (230, 230, 230)
        from matplotlib.image import imsave

        imsave(self.folder / "a.png", image)
        labels.write_text("file,u,v,class\na.png,1,1,carpet\na.png,6,6,white\n")
        return vision.colours_from_labels(labels, over="uv")

    def finding(self) -> Any:
        from mirrorball.analysis import Finding

        return Finding("lost", 0.0, 1.0, 0.5, 2.0, ("few lines",), "bad", "lost for 1 s")

    def analysis_report(self) -> Any:
        from mirrorball.analysis import report

        return report(self.game, folder=self.folder / "report", images_every=0)

    def imported_topic(self) -> Any:
        return mirrorball.bags.ImportedTopic("image", "/a", "t", "f.csv", 3, 0.0, None, {"why": 1}, ("note",))


@pytest.fixture(scope="module")
def made(game: Path, tmp_path_factory: pytest.TempPathFactory) -> Samples:
    return Samples(game, tmp_path_factory.mktemp("conventions"))


def public_classes() -> list[str]:
    """Of all modules; the two classes Report are two."""
    names = set()
    for short in MODULES:
        module = importlib.import_module(f"mirrorball.{short}".removesuffix("."))
        for name in module.__all__:
            if isinstance(getattr(module, name), type):
                names.add("analysis.Report" if short == "analysis" and name == "Report" else name)
    return sorted(names)


VALUES = [name for name in public_classes() if name not in STATEFUL | NO_OBJECTS]


@pytest.mark.parametrize("name", VALUES)
def test_values_can_be_pickled_copied_compared_and_shown(name: str, made: Samples) -> None:
    value = made.of(name)
    assert type(value).__name__ == name.rpartition(".")[2]
    for twin in (pickle.loads(pickle.dumps(value)), copy.copy(value), copy.deepcopy(value)):
        assert type(twin) is type(value)
        if not isinstance(value, Exception):
            assert twin == value
            assert (twin != value) is False
        assert repr(twin) == repr(value)
    assert value != object()
    shown = repr(value)
    assert shown.startswith(type(value).__name__)
    assert " object at 0x" not in shown and "<locals>" not in shown


@pytest.mark.parametrize("name", [name for name in STATEFUL if not name.startswith("Robot")])
def test_running_things_refuse_to_be_pickled(name: str, made: Samples) -> None:
    running: dict[str, Callable[[], Any]] = {
        "Pipeline": lambda: Pipeline(SEQUENCE),
        "Localizer": lambda: mirrorball.Localizer(field=Field()),
        "Simulation": lambda: Simulation(DEMO, images=False),
        "Vision": lambda: vision.Vision(map=made.of("GroundMap"), camera=made.of("Camera")),
        "DriveToBall": lambda: pytest.importorskip("gymnasium") and mirrorball.gym.DriveToBall(DEMO),
    }
    with pytest.raises(TypeError, match="cannot pickle"):
        pickle.dumps(running[name]())


def test_values_that_differ_are_not_equal(made: Samples) -> None:
    step = made.of("Step")
    image = step.samples[-1]
    assert samples.ImageSample(image.stamp_s, image.image.copy()) == image
    changed = image.image.copy()
    changed[0, 0, 0] ^= 1
    assert samples.ImageSample(image.stamp_s, changed) != image
    assert step != Simulation(DEMO, seed=2).step((0.5, 0.0, 0.0))
    assert workshop.lima2001() != workshop.nubot2013()
    assert workshop.lima2001() == workshop.lima2001()
    ground = made.of("GroundMap")
    moved = GroundMap(x_m=ground.x_m + np.float32(0.001), y_m=ground.y_m)
    assert moved != ground
    table = made.of("ColourTable")
    assert vision.colours_from_labels(made.folder / "labels.csv") != table


def rim_of(mirror: workshop.Mirror) -> float:
    return mirror.radius_m


def test_designs_and_cameras_reach_other_processes(made: Samples) -> None:
    designs = [workshop.lima2001(), workshop.minho_like(), workshop.load(ROOT / "config/mirrors/lima2001.toml").mirror]
    with multiprocessing.get_context("spawn").Pool(1) as pool:
        assert pool.map(rim_of, designs) == [design.radius_m for design in designs]
        assert pool.map(repr, [made.of("Camera"), made.of("Profile")]) == [
            repr(made.of("Camera")), repr(made.of("Profile"))]  # fmt: skip


@pytest.mark.parametrize("short", MODULES)
def test_completion_shows_the_public_names_alone(short: str) -> None:
    module = importlib.import_module(f"mirrorball.{short}".removesuffix("."))
    shown = {name for name in dir(module) if not name.startswith("_")}
    expected = {name for name in module.__all__ if not name.startswith("_")}
    if short == "":
        expected |= set(mirrorball._MODULES)
    if short == "analysis":
        expected.add("video")
    assert shown == expected
    assert all(getattr(module, name) is not None for name in shown if name != "video")


@pytest.mark.parametrize("preset", ["default", "nubot2013"])
def test_every_column_has_a_unit_or_none_by_list(preset: str, tmp_path: Path) -> None:
    from mirrorball import analysis

    path = tmp_path / "game.mcap"
    mirrorball.simulate(DEMO, seed=3, duration_s=0.5, preset=preset, record=path)
    log = Log(path)
    run = analysis.cycles(log, counts=True)
    tables = {topic: analysis.table(log, topic) for topic in log.topics}
    tables |= {"cycles": run, "points": analysis.points(log), "exposure": analysis.exposure(log, every=5)}
    assert {"/cycle", "/odometry", "/imu", "/command", "/vision/ball", "/pose"} <= tables.keys()
    names = {f"{topic}: {name}" for topic, found in tables.items() for name in found.columns if not has_unit_or_none(name)}
    assert names == set()
    # A list that is too wide lets everything pass.
    plain = ("x", "ball_x", "dx", "theta", "rate_x", "acceleration_z", "residual", "slip", "covariance_00")
    assert not any(map(has_unit_or_none, plain))
    assert {"dx_m", "dtheta_rad", "slip_m"} <= set(tables["/odometry"])
    assert {"acceleration_x_mps2", "rate_z_radps"} <= set(tables["/imu"])
    assert {"x_mps", "theta_radps"} <= set(tables["/command"])
    assert np.allclose(run["std_x_m"] ** 2, run["covariance_xx_m2"])
    assert np.allclose(run["std_theta_rad"] ** 2, run["covariance_thetatheta_rad2"])


def has_unit_or_none(name: str) -> bool:
    return bool(UNIT.fullmatch(name) or DIMENSIONLESS.fullmatch(name))


def test_fields_of_detections_and_calibrations_have_units(made: Samples) -> None:
    detections = made.of("Detections")
    for table in (detections.points, detections.refused, detections.ball, detections.robots, detections.goals):
        assert [name for name in table.dtype.names if not has_unit_or_none(name) and name not in OWN_NAMES] == []
    cycle = made.of("Cycle")
    assert all(name.endswith("_m") for name in cycle.line_points.dtype.names)


OWN_NAMES = {"contrast", "marker", "kind"}
"""Of detections: levels of 255, and texts."""
