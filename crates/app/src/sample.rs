//! What does a source yield? Stamped samples, the same from a robot, a simulation, a log or a folder.

use std::sync::Arc;

use localize::Pose;
use localize::Stamp;
use localize::frame::{At, FieldFrame};
use localize::sample::{Command, Compass, GoalSight, Imu, LinePoint, Odometry};
use localize::team::Report;
use vision::eyes::Seen;
use vision::image::Image;

/// Where things truly were.
#[derive(Debug, Clone, PartialEq)]
pub struct Truth {
    /// When.
    pub stamp: Stamp,
    /// The robot.
    pub pose: Pose,
    /// The ball, if the source knows it.
    pub ball: Option<At<FieldFrame>>,
    /// Other robots, if the source knows them.
    pub robots: Vec<At<FieldFrame>>,
}

/// One thing that arrived.
#[derive(Debug, Clone)]
pub enum Sample {
    /// From the wheels.
    Odometry(Odometry),
    /// From the compass.
    Compass(Compass),
    /// From the inertial unit.
    Imu(Imu),
    /// What the motors are told.
    Command(Command),
    /// What a team-mate says.
    Report(Report),
    /// For scoring alone; no stage sees it.
    Truth(Truth),
    /// A frame: it ends a cycle.
    Frame(Frame),
}

/// What vision starts from in a cycle.
#[derive(Debug, Clone)]
pub struct Frame {
    /// When it was exposed.
    pub stamp: Stamp,
    /// What it shows.
    pub content: Content,
}

/// A frame's content.
#[derive(Debug, Clone)]
pub enum Content {
    /// An image for our own vision.
    Image(Arc<Image>),
    /// What another vision (or an earlier run) found.
    Found {
        /// Line points.
        points: Vec<LinePoint>,
        /// Goals by their colours.
        goals: Vec<GoalSight>,
    },
    /// What our own vision found in an earlier run.
    Seen(Box<Seen>),
    /// A frame that could not be read; the cycle runs on without sight.
    Unreadable(String),
}
