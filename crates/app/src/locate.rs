//! `mirrorball locate`: where was the robot in each frame of a recording folder?

use std::path::PathBuf;

use anyhow::{Result, ensure};
use localize::estimate::Mode;

use crate::cycle::{Cycle, Spine, SpineConfig};
use crate::recording::Recording;
use crate::score;
use crate::setup::Setup;
use crate::summary::Tally;
use crate::table::{Written, seconds};

/// Find the robot in every frame of a recording folder.
///
/// The folder holds robot.toml, frames.csv (or points.csv with line points of another vision) and, if there are any,
/// odometry.csv, compass.csv and truth.csv. Writes poses.csv into it.
#[derive(clap::Args)]
#[command(after_help = "Example: mirrorball locate samples/sequence --out poses.csv --json")]
pub struct Args {
    /// The recording folder.
    dir: PathBuf,
    /// Measure with this calibrated map (npz) in place of the robot's own.
    #[arg(long, value_name = "MAP.npz")]
    map: Option<PathBuf>,
    /// Where the poses go [default: DIR/poses.csv].
    #[arg(long, value_name = "FILE")]
    out: Option<PathBuf>,
    /// Also write every line point: stamp_s,x_m,y_m in the robot frame.
    #[arg(long, value_name = "FILE")]
    points: Option<PathBuf>,
    /// Also write ball, robots and goals: stamp_s,kind,x_m,y_m,std_m,score in the robot frame.
    #[arg(long, value_name = "FILE")]
    seen: Option<PathBuf>,
    /// Change settings of vision and localisation by a TOML overlay.
    #[arg(long, value_name = "FILE.toml")]
    config: Option<PathBuf>,
}

/// Standard deviation taken for line points of another vision, which come without one, metres.
const FOREIGN_POINT_STD: f32 = 0.04;

struct Outputs {
    poses: Written,
    points: Option<Written>,
    seen: Option<Written>,
}

/// Runs the command.
pub fn run(args: &Args, json: bool) -> Result<()> {
    ensure!(args.dir.is_dir(), "{} is not a folder", args.dir.display());
    let setup = Setup::load(&args.dir.join("robot.toml"), args.map.as_deref())?;
    let recording = Recording::open(&args.dir, FOREIGN_POINT_STD)?;
    let truth = recording.truth.clone();
    let mut spine = Spine::new(&setup, &SpineConfig::load(args.config.as_deref())?)?;
    let out = args
        .out
        .clone()
        .unwrap_or_else(|| args.dir.join("poses.csv"));
    let mut outputs = Outputs {
        poses: Written::create(
            &out,
            "stamp_s,x_m,y_m,theta_rad,std_x_m,std_y_m,std_theta_rad,mode,line_points",
        )?,
        points: args
            .points
            .as_deref()
            .map(|path| Written::create(path, "stamp_s,x_m,y_m"))
            .transpose()?,
        seen: args
            .seen
            .as_deref()
            .map(|path| Written::create(path, "stamp_s,kind,x_m,y_m,std_m,score"))
            .transpose()?,
    };
    let mut tally = Tally::default();
    let bar = crate::progress::bar(recording.frames() as u64, "frames");
    for cycle in recording.filter_map(|sample| spine.take(sample)) {
        if let Some(fault) = &cycle.fault {
            bar.suspend(|| eprintln!("frame at {} s skipped: {fault}", seconds(cycle.stamp)));
        }
        outputs.write(&cycle)?;
        let error = cycle
            .estimate
            .pose
            .and_then(|pose| score::pose_error(&truth, cycle.stamp, pose));
        tally.add(&cycle, error);
        bar.inc(1);
    }
    bar.finish_and_clear();
    outputs.finish()?;
    let summary = tally.summary();
    if json {
        println!("{}", serde_json::to_string(&summary)?);
    } else {
        summary.print();
        println!("poses: {}", out.display());
    }
    Ok(())
}

impl Outputs {
    fn write(&mut self, cycle: &Cycle) -> Result<()> {
        let stamp = seconds(cycle.stamp);
        let estimate = &cycle.estimate;
        let (mode, points) = (mode_name(estimate.mode), estimate.line_points);
        match estimate.pose {
            Some(pose) => {
                let [std_x, std_y, std_theta] =
                    [0, 1, 2].map(|i| estimate.covariance[(i, i)].max(0.0).sqrt());
                self.poses.row(format_args!(
                    "{stamp},{:.5},{:.5},{:.6},{std_x:.5},{std_y:.5},{std_theta:.6},{mode},{points}",
                    pose.x, pose.y, pose.theta
                ))?;
            }
            None => self
                .poses
                .row(format_args!("{stamp},,,,,,,{mode},{points}"))?,
        }
        if let Some(file) = &mut self.points {
            for point in &cycle.points {
                file.row(format_args!("{stamp},{:.5},{:.5}", point.at.x, point.at.y))?;
            }
        }
        if let (Some(file), Some(seen)) = (&mut self.seen, &cycle.seen) {
            let ball = seen
                .ball
                .iter()
                .map(|ball| ("ball", ball.at, ball.covariance, ball.score));
            let robots = seen
                .robots
                .iter()
                .map(|robot| ("robot", robot.at, robot.covariance, robot.score));
            let goals = seen
                .goals
                .iter()
                .map(|goal| ("goal", goal.at, goal.covariance, goal.score));
            for (kind, at, [var_xx, _, var_yy], score) in ball.chain(robots).chain(goals) {
                // One number for both directions: the root of the mean variance.
                let std = ((var_xx + var_yy) / 2.0).max(0.0).sqrt();
                file.row(format_args!(
                    "{stamp},{kind},{:.4},{:.4},{std:.4},{score:.3}",
                    at.x, at.y
                ))?;
            }
        }
        Ok(())
    }

    fn finish(self) -> Result<()> {
        self.poses.finish()?;
        self.points.map_or(Ok(()), Written::finish)?;
        self.seen.map_or(Ok(()), Written::finish)
    }
}

/// The mode's name in poses.csv.
pub fn mode_name(mode: Mode) -> &'static str {
    match mode {
        Mode::Tracking => "tracking",
        Mode::Global => "global",
        Mode::Lost => "lost",
    }
}
