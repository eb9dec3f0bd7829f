//! What does RViz draw? The field's markings once, then robot, ball and other robots with every image.

use localize::Field;
use localize::field::Marking;
use localize::frames::{At, FieldFrame};
use localize::math;
use localize::world::{AirborneState, TeamColour, TrackedObject};
use pipeline::Cycle;

use super::messages::{ColorRGBA, Duration, Header, Marker, MarkerArray, Point, Pose, Vector3};
use super::odometry_frame::PlanarPose;
use super::primitives::planar_pose_message;

const ARROW: i32 = 0;
const SPHERE: i32 = 2;
const CYLINDER: i32 = 3;
const LINE_LIST: i32 = 5;
/// Spacing of points along arcs, metres.
const ARC_STEP: f32 = 0.1;
/// Diameter of a size 5 ball, metres.
const BALL_DIAMETER: f64 = 0.22;
/// Size of the league's largest robot, metres.
const ROBOT_SIDE: f64 = 0.52;
const ROBOT_HEIGHT: f64 = 0.8;
/// Lifetime of moving objects after their last message, nanoseconds.
const LIFETIME_NS: u32 = 500_000_000;

const WHITE: [f32; 4] = [1.0, 1.0, 1.0, 1.0];
const BLUE: [f32; 4] = [0.2, 0.5, 1.0, 0.9];
const YELLOW: [f32; 4] = [1.0, 0.8, 0.2, 0.9];

/// The field's markings.
pub(crate) fn field_markers(field: &Field, header: Header) -> MarkerArray {
    let mut points = Vec::new();
    for marking in &field.markings {
        let corners = corners(marking);
        for pair in corners.windows(2) {
            points.extend(pair.iter().map(|at| point(*at, 0.0)));
        }
    }
    let lines = Marker {
        points,
        scale: size([f64::from(field.config.line_width), 0.0, 0.0]),
        ..marker(header, "field", 0, LINE_LIST, WHITE)
    };
    MarkerArray {
        markers: vec![Marker {
            lifetime: Duration::default(),
            ..lines
        }],
    }
}

/// The robot, its ball and the robots around it, in the frame of the field. Empty while lost.
pub(crate) fn cycle_markers(cycle: &Cycle, header: &Header) -> MarkerArray {
    let mut markers = Vec::new();
    if let Some(pose) = cycle.estimate.pose {
        let planar = PlanarPose {
            x: pose.x.into(),
            y: pose.y.into(),
            theta: pose.theta.into(),
        };
        markers.push(Marker {
            pose: planar_pose_message(planar),
            scale: size([0.6, 0.12, 0.12]),
            ..marker(header.clone(), "heading", 0, ARROW, BLUE)
        });
        markers.push(Marker {
            pose: at_height(At::new(pose.x, pose.y), ROBOT_HEIGHT / 2.0),
            scale: size([ROBOT_SIDE, ROBOT_SIDE, ROBOT_HEIGHT]),
            ..marker(
                header.clone(),
                "robot",
                0,
                CYLINDER,
                [BLUE[0], BLUE[1], BLUE[2], 0.4],
            )
        });
    }
    let on_field = |object: &TrackedObject| object.on_field.map(|on| on.at);
    let flight = cycle.world.ball_in_air.and_then(|ball| ball.on_field);
    let ball = match flight {
        Some(AirborneState { at: [x, y, z], .. }) => Some((At::new(x, y), z.into())),
        None => {
            let ball = cycle.world.ball.as_ref().and_then(on_field);
            ball.map(|at| (at, BALL_DIAMETER / 2.0))
        }
    };
    if let Some((at, height)) = ball {
        markers.push(Marker {
            pose: at_height(at, height),
            scale: size([BALL_DIAMETER; 3]),
            ..marker(header.clone(), "ball", 0, SPHERE, YELLOW)
        });
    }
    for robot in &cycle.world.robots {
        let Some(at) = on_field(robot) else {
            continue;
        };
        markers.push(Marker {
            pose: at_height(at, ROBOT_HEIGHT / 2.0),
            scale: size([ROBOT_SIDE, ROBOT_SIDE, ROBOT_HEIGHT]),
            ..marker(
                header.clone(),
                "robots",
                // Numbers of tracks stay far below 2³¹.
                robot.id as i32,
                CYLINDER,
                team_colour(robot.team),
            )
        });
    }
    MarkerArray { markers }
}

fn team_colour(team: Option<TeamColour>) -> [f32; 4] {
    match team {
        Some(TeamColour::Cyan) => [0.0, 0.8, 0.9, 0.6],
        Some(TeamColour::Magenta) => [0.9, 0.1, 0.8, 0.6],
        None => [0.9, 0.8, 0.2, 0.6],
    }
}

fn marker(header: Header, ns: &str, id: i32, kind: i32, [r, g, b, a]: [f32; 4]) -> Marker {
    Marker {
        header,
        ns: ns.to_owned(),
        id,
        r#type: kind,
        pose: planar_pose_message(PlanarPose::default()),
        color: ColorRGBA { r, g, b, a },
        lifetime: Duration {
            sec: 0,
            nanosec: LIFETIME_NS,
        },
        ..Marker::default()
    }
}

fn size([x, y, z]: [f64; 3]) -> Vector3 {
    Vector3 { x, y, z }
}

fn point(at: At<FieldFrame>, z: f64) -> Point {
    Point {
        x: at.x.into(),
        y: at.y.into(),
        z,
    }
}

fn at_height(at: At<FieldFrame>, z: f64) -> Pose {
    Pose {
        position: point(at, z),
        ..planar_pose_message(PlanarPose::default())
    }
}

/// The ends of a line, or points along an arc.
fn corners(marking: &Marking) -> Vec<At<FieldFrame>> {
    let arc = |centre: At<FieldFrame>, radius: f32, start: f32, sweep: f32| {
        let steps = (radius * sweep.abs() / ARC_STEP).ceil().max(8.0) as usize;
        (0..=steps)
            .map(|step| {
                let (sin, cos) = math::sin_cos(start + sweep * step as f32 / steps as f32);
                At::new(centre.x + radius * cos, centre.y + radius * sin)
            })
            .collect()
    };
    match *marking {
        Marking::Line { from, to } => vec![from, to],
        Marking::Arc {
            centre,
            radius,
            start,
            sweep,
        } => arc(centre, radius, start, sweep),
        Marking::Spot { centre, radius } => arc(centre, radius, 0.0, std::f32::consts::TAU),
    }
}
