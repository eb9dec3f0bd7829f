//! What does a viewer draw on the ground? Field lines, poses and objects, in foxglove's messages.

use foxglove::messages::packed_element_field::NumericType;
use foxglove::messages::{
    ArrowPrimitive, Color, CubePrimitive, CylinderPrimitive, Duration, FrameTransform,
    LinePrimitive, PackedElementField, Point3, PointCloud, PoseInFrame, PosesInFrame, Quaternion,
    SceneEntity, SceneUpdate, SpherePrimitive, Vector3, line_primitive,
};
use localize::field::Marking;
use localize::frames::{At, FieldFrame};
use localize::math;
use localize::sample::LinePoint;
use localize::world::{BallInAir, TeamColour, TrackedObject};
use localize::{Field, Pose, Stamp};

use super::timestamp;
use crate::cycle::Cycle;

/// Name of the field frame in viewers.
const FIELD_FRAME: &str = "field";
/// Name of the robot frame in viewers.
pub(super) const ROBOT_FRAME: &str = "robot";
/// Spacing of points along markings, metres: a third of the league's line width.
const LINE_STEP: f32 = 0.04;
/// Width of the line below a ball in the air, metres.
const FALL_LINE_WIDTH: f64 = 0.02;
/// Diameter of a size 5 ball, metres.
const BALL_DIAMETER: f64 = 0.22;
/// Size of the league's largest robot, metres.
pub(super) const ROBOT_SIDE: f64 = 0.52;
const ROBOT_HEIGHT: f64 = 0.8;
/// Lifetime of drawn moving objects after their last message, seconds.
const LIFETIME_S: f64 = 0.5;

const WHITE: [f64; 4] = [1.0, 1.0, 1.0, 1.0];
const TRUTH: [f64; 4] = [0.2, 0.9, 0.3, 0.6];
const ESTIMATE: [f64; 4] = [0.2, 0.5, 1.0, 0.9];
const ORANGE: [f64; 4] = [1.0, 0.5, 0.0, 1.0];
/// Ball as tracked by this robot.
const OWN_BALL: [f64; 4] = [1.0, 0.8, 0.2, 0.9];
/// Ball as fused by the team.
const TEAM_BALL: [f64; 4] = [1.0, 0.2, 0.6, 0.9];
const GREY: [f64; 4] = [0.4, 0.4, 0.4, 0.7];

pub(crate) fn color([r, g, b, a]: [f64; 4]) -> Option<Color> {
    Some(Color { r, g, b, a })
}

/// The field's markings as points on their centre lines, for viewers without scene support.
pub(crate) fn field_points(field: &Field, stamp: Stamp) -> PointCloud {
    let points = field
        .markings
        .iter()
        .flat_map(sample_centre_line)
        .map(|at| [at.x, at.y, 0.0]);
    cloud(stamp, FIELD_FRAME, ["x", "y", "z"], points)
}

/// The field's markings and goals as a scene.
pub(crate) fn field_scene(field: &Field, stamp: Stamp) -> SceneUpdate {
    let line = |marking: &Marking| LinePrimitive {
        r#type: line_primitive::Type::LineStrip as i32,
        thickness: f64::from(field.config.line_width),
        points: sample_centre_line(marking)
            .into_iter()
            .map(|at| point3(at, 0.0))
            .collect(),
        color: color(WHITE),
        ..LinePrimitive::default()
    };
    let goal = &field.config.goal;
    let mut posts = Vec::new();
    for end in [1.0, -1.0].into_iter().filter(|_| field.has_goals()) {
        for side in [1.0, -1.0] {
            let out = (goal.width + goal.post) / 2.0;
            posts.push(CubePrimitive {
                pose: upright(
                    At::<FieldFrame>::new(end * field.config.length / 2.0, side * out),
                    goal.height / 2.0,
                ),
                size: vector([goal.post, goal.post, goal.height].map(f64::from)),
                color: color(WHITE),
            });
        }
    }
    let entity = SceneEntity {
        lines: field.markings.iter().map(line).collect(),
        cubes: posts,
        ..entity(stamp, "field", None)
    };
    SceneUpdate {
        deletions: Vec::new(),
        entities: vec![entity],
    }
}

/// The estimated pose, the tracked objects and the ground truth; `stamp`: time of the message.
pub(crate) fn cycle_scene(cycle: &Cycle, stamp: Stamp) -> SceneUpdate {
    let mut entities = Vec::new();
    if let Some(pose) = cycle.estimate.pose {
        entities.push(SceneEntity {
            arrows: vec![arrow(pose, ESTIMATE)],
            ..entity(stamp, "estimate", Some(LIFETIME_S))
        });
    }
    let placed = |object: &TrackedObject| object.on_field.map(|on| on.at);
    entities.push(SceneEntity {
        spheres: own_ball(cycle).into_iter().collect(),
        lines: cycle
            .world
            .ball_in_air
            .iter()
            .filter_map(fall_line)
            .collect(),
        cylinders: cycle
            .world
            .robots
            .iter()
            .filter_map(|robot| Some(cylinder(placed(robot)?, team_color(robot.team))))
            .collect(),
        ..entity(stamp, "world", Some(LIFETIME_S))
    });
    if let Some(ball) = &cycle.team.ball {
        entities.push(SceneEntity {
            spheres: vec![sphere(ball.at, 0.0, TEAM_BALL)],
            ..entity(stamp, "team", Some(LIFETIME_S))
        });
    }
    if let Some(ball) = &cycle.team.triangulated {
        let [x, y, z] = ball.state.at;
        entities.push(SceneEntity {
            spheres: vec![sphere(
                At::new(x, y),
                z - BALL_DIAMETER as f32 / 2.0,
                TEAM_BALL,
            )],
            ..entity(stamp, "team_in_space", Some(LIFETIME_S))
        });
    }
    if let Some(truth) = &cycle.inputs.truth {
        entities.push(SceneEntity {
            arrows: vec![arrow(truth.pose, TRUTH)],
            spheres: truth
                .ball
                .map(|at| sphere(at, truth.ball_height, ORANGE))
                .into_iter()
                .collect(),
            cylinders: truth.robots.iter().map(|at| cylinder(*at, GREY)).collect(),
            ..entity(stamp, "truth", Some(LIFETIME_S))
        });
    }
    SceneUpdate {
        deletions: Vec::new(),
        entities,
    }
}

fn cylinder(at: At<FieldFrame>, shade: [f64; 4]) -> CylinderPrimitive {
    CylinderPrimitive {
        pose: upright(at, ROBOT_HEIGHT as f32 / 2.0),
        size: vector([ROBOT_SIDE, ROBOT_SIDE, ROBOT_HEIGHT]),
        bottom_scale: 1.0,
        top_scale: 1.0,
        color: color(shade),
    }
}

/// The robot's own ball, in the air or on the ground.
fn own_ball(cycle: &Cycle) -> Option<SpherePrimitive> {
    if let Some(flight) = cycle.world.ball_in_air.and_then(|ball| ball.on_field) {
        let [x, y, z] = flight.at;
        return Some(sphere(
            At::new(x, y),
            z - BALL_DIAMETER as f32 / 2.0,
            OWN_BALL,
        ));
    }
    let ball = cycle.world.ball.as_ref()?.on_field?;
    Some(sphere(ball.at, 0.0, OWN_BALL))
}

/// From a ball in the air down to the ground, and on to where it lands.
fn fall_line(ball: &BallInAir) -> Option<LinePrimitive> {
    let flight = ball.on_field?;
    let [x, y, z] = flight.at;
    let below = At::<FieldFrame>::new(x, y);
    let mut points = vec![point3(below, f64::from(z)), point3(below, 0.0)];
    if let Some(landing) = flight.landing {
        let [x, y] = landing.at;
        points.push(point3(At::<FieldFrame>::new(x, y), 0.0));
    }
    Some(LinePrimitive {
        r#type: line_primitive::Type::LineStrip as i32,
        thickness: FALL_LINE_WIDTH,
        points,
        color: color(OWN_BALL),
        ..LinePrimitive::default()
    })
}

/// A ball whose lowest point is at a height.
fn sphere(at: At<FieldFrame>, height: f32, shade: [f64; 4]) -> SpherePrimitive {
    SpherePrimitive {
        pose: upright(at, height + BALL_DIAMETER as f32 / 2.0),
        size: vector([BALL_DIAMETER; 3]),
        color: color(shade),
    }
}

fn team_color(team: Option<TeamColour>) -> [f64; 4] {
    match team {
        Some(TeamColour::Cyan) => [0.0, 0.8, 0.9, 0.6],
        Some(TeamColour::Magenta) => [0.9, 0.1, 0.8, 0.6],
        None => [0.9, 0.8, 0.2, 0.6],
    }
}

/// Line points in the robot frame with their standard deviations.
pub(crate) fn line_points(points: &[LinePoint], stamp: Stamp) -> PointCloud {
    let row = |point: &LinePoint| {
        [
            point.at.x,
            point.at.y,
            0.0,
            point.std_radial,
            point.std_tangential,
        ]
    };
    cloud(
        stamp,
        ROBOT_FRAME,
        ["x", "y", "z", "std_radial", "std_tangential"],
        points.iter().map(row),
    )
}

/// A pose on the field.
pub(crate) fn pose_in_frame(pose: Pose, stamp: Stamp) -> PoseInFrame {
    PoseInFrame {
        timestamp: timestamp(stamp),
        frame_id: FIELD_FRAME.to_owned(),
        pose: pose3(pose),
    }
}

/// Further pose hypotheses for the same line points.
pub(crate) fn poses_in_frame(poses: impl Iterator<Item = Pose>, stamp: Stamp) -> PosesInFrame {
    PosesInFrame {
        timestamp: timestamp(stamp),
        frame_id: FIELD_FRAME.to_owned(),
        poses: poses.filter_map(pose3).collect(),
    }
}

/// Transform from the robot frame to the field frame.
pub(crate) fn robot_transform(pose: Pose, stamp: Stamp) -> FrameTransform {
    FrameTransform {
        timestamp: timestamp(stamp),
        parent_frame_id: FIELD_FRAME.to_owned(),
        child_frame_id: ROBOT_FRAME.to_owned(),
        translation: vector([f64::from(pose.x), f64::from(pose.y), 0.0]),
        rotation: Some(yaw_quaternion(pose.theta)),
    }
}

fn cloud<const N: usize>(
    stamp: Stamp,
    frame: &str,
    names: [&str; N],
    rows: impl Iterator<Item = [f32; N]>,
) -> PointCloud {
    let field = |(index, name): (usize, &str)| PackedElementField {
        name: name.to_owned(),
        offset: 4 * index as u32,
        r#type: NumericType::Float32 as i32,
    };
    let data: Vec<u8> = rows.flatten().flat_map(f32::to_le_bytes).collect();
    PointCloud {
        timestamp: timestamp(stamp),
        frame_id: frame.to_owned(),
        pose: upright(At::<FieldFrame>::new(0.0, 0.0), 0.0),
        point_stride: 4 * N as u32,
        fields: names.into_iter().enumerate().map(field).collect(),
        data: data.into(),
    }
}

/// Points along a marking's centre line, ends included.
fn sample_centre_line(marking: &Marking) -> Vec<At<FieldFrame>> {
    let steps = |length: f32| (length / LINE_STEP).ceil().max(1.0) as usize;
    let along = |count: usize| (0..=count).map(move |step| step as f32 / count as f32);
    match *marking {
        Marking::Line { from, to } => along(steps(from.distance_to(to)))
            .map(|part| {
                At::new(
                    from.x + part * (to.x - from.x),
                    from.y + part * (to.y - from.y),
                )
            })
            .collect(),
        Marking::Arc {
            centre,
            radius,
            start,
            sweep,
        } => along(steps(radius * sweep.abs()))
            .map(|part| on_circle(centre, radius, start + part * sweep))
            .collect(),
        Marking::Spot { centre, radius } => along(steps(std::f32::consts::TAU * radius))
            .map(|part| on_circle(centre, radius, part * std::f32::consts::TAU))
            .collect(),
    }
}

fn on_circle(centre: At<FieldFrame>, radius: f32, angle: f32) -> At<FieldFrame> {
    let (sin, cos) = math::sin_cos(angle);
    At::new(centre.x + radius * cos, centre.y + radius * sin)
}

fn entity(stamp: Stamp, id: &str, shown_s: Option<f64>) -> SceneEntity {
    SceneEntity {
        timestamp: timestamp(stamp),
        frame_id: FIELD_FRAME.to_owned(),
        id: id.to_owned(),
        lifetime: shown_s.map(Duration::saturating_from_secs_f64),
        ..SceneEntity::default()
    }
}

fn arrow(pose: Pose, shade: [f64; 4]) -> ArrowPrimitive {
    ArrowPrimitive {
        pose: pose3(pose),
        shaft_length: 0.4,
        shaft_diameter: 0.1,
        head_length: 0.2,
        head_diameter: 0.25,
        color: color(shade),
    }
}

fn pose3(pose: Pose) -> Option<foxglove::messages::Pose> {
    Some(foxglove::messages::Pose {
        position: vector([f64::from(pose.x), f64::from(pose.y), 0.0]),
        orientation: Some(yaw_quaternion(pose.theta)),
    })
}

pub(super) fn upright<F>(at: At<F>, height: f32) -> Option<foxglove::messages::Pose> {
    Some(foxglove::messages::Pose {
        position: vector([at.x, at.y, height].map(f64::from)),
        orientation: Some(yaw_quaternion(0.0)),
    })
}

fn yaw_quaternion(theta: f32) -> Quaternion {
    let (z, w) = math::sin_cos(f64::from(theta) / 2.0);
    Quaternion {
        x: 0.0,
        y: 0.0,
        z,
        w,
    }
}

pub(super) fn vector([x, y, z]: [f64; 3]) -> Option<Vector3> {
    Some(Vector3 { x, y, z })
}

fn point3<F>(at: At<F>, z: f64) -> Point3 {
    Point3 {
        x: f64::from(at.x),
        y: f64::from(at.y),
        z,
    }
}
