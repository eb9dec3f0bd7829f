"""Each public function refuses what is no argument of it, by a message with the argument's name and what is expected."""

import ast
import importlib
import inspect
import re
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import mirrorball
from conftest import ROOT
from mirrorball import mirror as workshop
from mirrorball import samples, vision

DEMO = ROOT / "config/scenarios/demo.toml"
SEQUENCE = ROOT / "samples/sequence"
STUB = ROOT / "py/mirrorball/_core.pyi"
VECTOR, PAIR = (0.0, 0.0, 0.0), (0.0, 0.0)

WRONG: dict[str, Any] = {
    "a text": "wrong",
    "None": None,
    "NaN": float("nan"),
    "a wrong shape": np.zeros((2, 2, 2, 2)),
    "a wrong type": np.zeros((2, 2), dtype=complex),
    "objects": [object()],
}

RESULTS = {
    "Advice", "Certificate", "Cycle", "Detections", "Estimate", "Export", "Finding", "Fit", "GroundCost", "GroundErrors",
    "ImportSummary",
    "ImportedTopic",
    "BagTopic", "LogMessage", "Mirror", "ObjectSizes", "OpticalAnalysis", "OptimisationResult", "PaperFigure", "Pose",
    "Preview",
    "Rays", "Report", "Residual", "RunnerUp", "Segment", "Step", "TrackedObject", "View", "VisibleHeights", "DesignSpec",
}  # fmt: skip
"""Records that functions of the package fill in: they take what they are given, like any tuple."""

SAMPLES = {"CommandSample", "CompassSample", "ImageSample", "ImuSample", "OdometrySample", "TruthSample"}
"""Records, too: `Pipeline.process` checks what it takes from them (a test below)."""

OTHERS = {
    "LogError": "an exception",
    "ColourTable": "made by load, from_bytes and learn_colours, which are tested",
    "Part": "a protocol",
    "Requirement": "a union of classes, which are tested",
    "Sample": "a union of classes",
    "REFERENCE_DESIGNS": "a table",
    "__version__": "a text",
    "lima2001": "takes nothing",
    "nubot2013": "takes nothing",
    "sphere_cone_1999": "takes nothing",
    "detections_from_columns": "takes what the compiled half returns",
    "sample_from_core": "takes what the compiled half returns",
    "reflect": "arithmetic in the innermost loop: numbers in, NaN for NaN out",
    "slope_to_point": "arithmetic in the innermost loop",
    "RobotEnv": "abstract; DriveToBall is tested",
    "RobotEnv.__init__": "abstract",
}
"""Public names that are no function of arguments, with the reason."""


def small_things(folder: Path) -> dict[str, Any]:
    """One fitting value for each name of an argument."""
    design = workshop.lima2001()
    camera = workshop.fit_camera(design, size_px=120)
    ground = mirrorball.ground_map(camera=camera, profile=design.profile())
    judged = workshop.judge(design, focal_px=camera.focal_px, rays_per_part=50)
    blank = np.zeros((120, 120, 3), dtype=np.uint8)
    return {
        "apex_above_pinhole_m": 0.2, "at_m": 3.0, "back_m": 0.01, "bag": folder / "bag.mcap", "ball": PAIR, "bars": 10,
        "camera": camera, "centre_px": PAIR, "colours": None, "content": b"", "count": 10, "deviation_m": 1e-5,
        "diameter_m": 0.1, "directions_rad": [0.0], "distance_m": None, "duration_s": 0.1, "eccentricity": 1.5,
        "even_to_m": 1.5, "every": 1, "f_number": 2.0, "field": mirrorball.Field(), "first_edge_m": 0.5,
        "focal_length_m": 0.006, "focal_px": 100.0, "focal_share": 0.002, "folder": folder, "form_length_m": 0.01,
        "form_m": 5e-6, "forward_deg": 90.0, "from_height_m": 0.0, "from_m": 1.0, "gain": 1.0, "gap_factor": 1.5,
        "heading_rad": 0.0, "height_px": 120, "hard": False, "image": blank, "images": [blank], "impulse": PAIR,
        "index": 0, "judged": judged, "level": 1.0, "line_width_m": 0.125, "map": ground, "margin_px": 6, "mirror": design,
        "mirrors": 0, "motion": VECTOR, "offset_m": 0.0005, "parts": [workshop.Cone(slope=0.5, until_t=0.3)],
        "path": folder / "file",
        "pinhole_height_m": 0.6, "points": [[1.0, 2.0]], "pose": VECTOR, "position": PAIR, "profile": design.profile(),
        "px": 10.0, "px_per_m": 50.0, "radius_m": np.linspace(0.0, 0.1, 9), "height_m": np.linspace(0.7, 0.8, 9),
        "reach_m": 3.0, "requirements": [workshop.MaxDiameter(diameter_m=0.2)], "resamples": 10, "retries": 0, "rows": 5,
        "rays_per_part": 50, "run": DEMO, "scenario": DEMO, "seed": 1, "shown": None, "size_px": 120, "spacing_m": 0.2,
        "stamp_s": 0.0,
        "start": ground, "std": (0.1, 0.1, 0.1), "std_m": 0.05, "step_m": 1e-3, "target": lambda t: (t, t), "text": "",
        "through_distance_m": 1.0, "through_height_m": 0.0, "tilt_deg": 0.2, "time_s": 0.0, "to_height_m": 1.0, "to_m": 4.0,
        "tolerance_s": 0.002, "topic": "/cycle", "u_px": [1.0], "until_height_m": 1.0, "until_m": 3.0, "until_t": 0.3,
        "v_px": [1.0], "velocity": VECTOR, "width_m": 0.1, "width_px": 120, "x_m": ground.x_m, "y_m": ground.y_m,
        "specific_force_mps2": VECTOR, "angular_velocity_radps": VECTOR, "exposure": 1.0, "robot": SEQUENCE, "tasks": [],
        "source": ROOT / "config/mirrors/lima2001.toml", "found": [], "column": "error_m", "observe": "truth",
        "speed_max_mps": 1.0, "turn_max_radps": 1.0, "preset": "default",
    }  # fmt: skip


OWN_VALUES: dict[str, dict[str, Any]] = {
    "Log.rows": {"field": "points"},
    "MinCurvatureRadius": {"radius_m": 0.1},
    "Pipeline": {"map": None},
    "Simulation": {"images": True},
    "Run": {"scenario": "scenario.toml"},
    "Selection": dict.fromkeys(("image", "odometry", "imu", "compass", "truth")),
    "Sphere": {"radius_m": 0.1},
    "Tolerances": {"height_m": 0.001},
    "simulate": {"images": "png"},
}
"""Arguments that mean another thing than elsewhere."""


@pytest.fixture(scope="module")
def things(tmp_path_factory: pytest.TempPathFactory, game: Path) -> dict[str, Any]:
    from mirrorball.analysis import cycles

    found = small_things(tmp_path_factory.mktemp("arguments"))
    run = cycles(game)
    return {**found, "log": game, "first": run, "second": run, "cycles": run}


def parameters_of_stub() -> dict[str, dict[str, str]]:
    """Annotations of the compiled half by function, "Camera" or "Camera.load"."""
    found = {}

    def annotations(function: ast.FunctionDef) -> dict[str, str]:
        every = [*function.args.args, *function.args.kwonlyargs]
        # Of the compiled half, None stands for the default of an argument.
        defaults = [*function.args.defaults, *function.args.kw_defaults]
        default = dict(zip([each.arg for each in reversed(every)], reversed(defaults), strict=False))
        return {
            each.arg: ast.unparse(each.annotation) + (" | None" if default.get(each.arg) else "")
            for each in every
            if each.annotation
        }

    for node in ast.parse(STUB.read_text()).body:
        if isinstance(node, ast.FunctionDef):
            found[node.name] = annotations(node)
        elif isinstance(node, ast.ClassDef):
            for method in node.body:
                if isinstance(method, ast.FunctionDef):
                    name = node.name if method.name == "__new__" else f"{node.name}.{method.name}"
                    found[name] = annotations(method)
    return found


STUBS = parameters_of_stub()


def annotations_of(function: Any, name: str) -> dict[str, str]:
    if name in STUBS and getattr(function, "__module__", "") in ("builtins", "mirrorball._core", None):
        return STUBS[name]
    parameters = inspect.signature(function).parameters.values()
    named = [each for each in parameters if each.name != "self" and each.kind not in (each.VAR_KEYWORD, each.VAR_POSITIONAL)]
    return {each.name: str(each.annotation) for each in named}


def admits(annotation: str, wrong: str) -> bool:
    """Is it a value of this annotation, so that the function must find out by itself?"""
    if re.search(r"\bAny\b(?!\])|\bTask\b", annotation) and "NDArray" not in annotation:
        return True
    if wrong == "None":
        return "None" in annotation
    if wrong == "a text":
        return bool(re.search(r"\b(str|PathLike|Path|Config)\b", annotation)) and "Sequence[str]" not in annotation
    return False


METHODS = {
    "mirrorball": ["Camera.load", "Camera.of_map", "Profile.load", "Profile.height_and_slope", "GroundMap.load",
                   "GroundMap.save",
                   "Field.from_toml", "ColourTable.load", "ColourTable.from_bytes", "Log.columns", "Log.rows", "Log.messages",
                   "Log.images", "Log.log_times_ns", "Pipeline.odometry", "Pipeline.imu", "Pipeline.compass",
                   "Pipeline.command",
                   "Pipeline.set_pose", "Pipeline.image", "Pipeline.points", "Localizer.points", "Simulation.step",
                   "Simulation.kidnap", "Simulation.push", "Simulation.place_ball", "Simulation.place_robot",
                   "Simulation.set_light",
                   "Simulation.set_camera"],
    "mirrorball.vision": ["Vision.process"],
}  # fmt: skip


def public_functions() -> Iterator[tuple[str, str]]:
    for short in ("", *mirrorball._MODULES):
        if short in ("bags", "gym"):
            pytest.importorskip({"bags": "rosbags", "gym": "gymnasium"}[short])
        module = f"mirrorball.{short}".removesuffix(".")
        for name in (*importlib.import_module(module).__all__, *METHODS.get(module, [])):
            yield module, name


TESTED = [pair for pair in public_functions() if pair[1] not in RESULTS | SAMPLES | set(OTHERS)]


def test_every_public_name_is_tested_or_listed_with_a_reason() -> None:
    listed = RESULTS | SAMPLES | set(OTHERS)
    everything = {name for _, name in public_functions()}
    assert everything - listed == {name for _, name in TESTED}
    for module, name in public_functions():
        if name in RESULTS | SAMPLES:
            record = getattr(importlib.import_module(module), name)
            assert name == "Cycle" or hasattr(record, "__dataclass_fields__") or hasattr(record, "_fields"), name


def owner_of(things: dict[str, Any], module: str, name: str) -> tuple[Any, str]:
    """The function, and the name under which the stub has it."""
    owner, _, method = name.partition(".")
    found = getattr(importlib.import_module(module), owner)
    if not method:
        return found, name
    if owner in ("Camera", "ColourTable", "Field") or method == "load":
        return getattr(found, method), name
    instances: dict[str, Callable[[], Any]] = {
        "Profile": lambda: things["profile"],
        "GroundMap": lambda: things["map"],
        "Log": lambda: mirrorball.Log(things["log"]),
        "Pipeline": lambda: mirrorball.Pipeline(SEQUENCE),
        "Localizer": lambda: mirrorball.Localizer(field=mirrorball.Field()),
        "Simulation": lambda: mirrorball.Simulation(DEMO, seed=1, images=False),
        "Vision": lambda: vision.Vision(map=things["map"], camera=things["camera"]),
    }
    return getattr(instances[owner](), method), name


@pytest.mark.parametrize(("module", "name"), TESTED)
def test_wrong_arguments_are_refused_by_name(module: str, name: str, things: dict[str, Any]) -> None:
    function, stub = owner_of(things, module, name)
    annotations = annotations_of(function, stub)
    fitting = {key: things[key] for key in annotations if key in things} | OWN_VALUES.get(name, {})
    if name == "compare":
        fitting |= {"first": things["log"], "second": things["log"]}
    tried = 0
    for key, annotation in annotations.items():
        for wrong, value in WRONG.items():
            if admits(annotation, wrong):
                continue
            tried += 1
            with pytest.raises((TypeError, ValueError)) as raised:
                call(function, {**fitting, key: value})
            message = str(raised.value)
            assert key in message and "expected" in message, f"{name}({key}={wrong}): {message}"
            assert "\n" not in message
    assert tried > 0 or set(annotations.values()) <= {"str | PathLike[str]", "Any"}


def test_samples_are_checked_by_what_takes_them() -> None:
    pipeline = mirrorball.Pipeline(SEQUENCE)
    wrong: list[tuple[Any, str]] = [
        (samples.OdometrySample(0.0, (0.0, 0.0)), "motion"),  # type: ignore[arg-type]
        (samples.ImuSample(0.0, VECTOR, (0.0, float("nan"), 0.0)), "angular_velocity_radps"),
        (samples.CompassSample(0.0, "north", None), "heading_rad"),  # type: ignore[arg-type]
        (samples.CommandSample(None, VECTOR), "stamp_s"),  # type: ignore[arg-type]
        (samples.ImageSample(0.0, np.zeros((4, 4))), "image"),  # type: ignore[arg-type]
        ("image", "sample"),
    ]
    for sample, name in wrong:
        with pytest.raises((TypeError, ValueError), match=rf"invalid {name}: .* \(expected "):
            pipeline.process(sample)


def test_a_mask_of_another_shape_is_refused(things: dict[str, Any]) -> None:
    camera = workshop.fit_camera(workshop.lima2001(), size_px=120)
    turned = np.ones((60, 240), dtype=bool)
    assert turned.size == camera.width_px * camera.height_px
    with pytest.raises(ValueError, match=r"invalid mask: bool array of shape \[60, 240\] .*\[120, 120\]"):
        vision.Vision(map=things["map"], camera=camera, mask=turned)


def test_a_mask_that_hides_all_ground_is_named(things: dict[str, Any]) -> None:
    camera = workshop.fit_camera(workshop.lima2001(), size_px=120)
    with pytest.raises(ValueError, match="the mask hides all ground"):
        vision.Vision(map=things["map"], camera=camera, mask=np.zeros((120, 120), dtype=bool))


@pytest.mark.parametrize(
    "mount",
    [{"lean_deg": (180.0, 0.0)}, {"mirror_tilt_deg": (0.0, -90.0)}, {"mirror_offset_m": (10.0, 0.0)}, {"mirror_raise_m": -5.0}],
)
def test_a_mount_whose_mirror_is_out_of_sight_is_refused(mount: dict[str, Any]) -> None:
    (name,) = mount
    with pytest.raises(ValueError, match=f"invalid {name}: "):
        mirrorball.Mount(**mount)


def test_a_mirror_has_no_height_at_a_negative_radius() -> None:
    with pytest.raises(ValueError, match=r"invalid radius_m: -1.* \(expected at least 0\)"):
        workshop.lima2001().profile().height_and_slope([0.01, -1.0])


def test_largest_numbers_that_are_accepted_do_no_harm(things: dict[str, Any]) -> None:
    simulation = mirrorball.Simulation(DEMO, seed=1, images=False)
    simulation.kidnap((1000.0, -1000.0, 1000.0))
    simulation.push((10_000.0, -10_000.0))
    simulation.place_ball((-1000.0, 1000.0), velocity=(1000.0, -1000.0))
    simulation.place_robot(0, (1000.0, 1000.0, 0.0))
    for _ in range(5):
        assert np.all(np.isfinite(simulation.step((1000.0, 1000.0, -1000.0)).truth.pose))
    far = mirrorball.render(**{key: things[key] for key in ("camera", "profile", "field")}, pose=(1e30, -1e30, 1e30))
    assert far.shape == (120, 120, 3)
    unseen = mirrorball.GroundMap(x_m=np.full((4, 4), np.nan), y_m=np.full((4, 4), np.nan))
    with pytest.raises(ValueError, match="invalid map: too little ground"):
        mirrorball.Camera.of_map(unseen)


def call(function: Any, arguments: dict[str, Any]) -> Any:
    """By keyword where that is possible."""
    parameters = inspect.signature(function).parameters
    alone = [key for key in arguments if parameters[key].kind == inspect.Parameter.POSITIONAL_ONLY]
    by_name = {key: value for key, value in arguments.items() if key not in alone}
    return function(*(arguments[key] for key in alone), **by_name)
