//! Which tables does a run write? Poses, line points and detections as CSV files.

use std::path::Path;

use anyhow::Result;
use localize::estimate::{Estimate, Mode};
use vision::objects::robots::ObstacleKind;

use crate::csv_table::{CsvWriter, format_seconds};
use crate::cycle::Cycle;
use crate::log::reason_text;

/// The requested tables of a run: poses, line points, detections.
pub struct CsvOutputs {
    poses: Option<CsvWriter>,
    points: Option<CsvWriter>,
    detections: Option<CsvWriter>,
}

impl CsvOutputs {
    /// Starts the tables that have a path.
    pub fn create(
        poses: Option<&Path>,
        points: Option<&Path>,
        detections: Option<&Path>,
    ) -> Result<Self> {
        let start = |path: Option<&Path>, header| {
            path.map(|path| CsvWriter::create(path, header)).transpose()
        };
        let poses_header = "stamp_s,x_m,y_m,theta_rad,std_x_m,std_y_m,std_theta_rad,mode,line_points,reason,\
                            on_markings,residual_m,markings_seen,wheels_agree,compass_agrees";
        Ok(CsvOutputs {
            poses: start(poses, poses_header)?,
            points: start(points, "stamp_s,x_m,y_m")?,
            detections: start(detections, "stamp_s,kind,x_m,y_m,std_m,score")?,
        })
    }

    /// Adds the rows of a cycle.
    pub fn write(&mut self, cycle: &Cycle) -> Result<()> {
        let stamp = format_seconds(cycle.stamp);
        if let Some(file) = &mut self.poses {
            write_pose(file, &stamp, &cycle.estimate)?;
        }
        if let Some(file) = &mut self.points {
            for point in &cycle.line_points {
                file.write_row(format_args!("{stamp},{:.5},{:.5}", point.at.x, point.at.y))?;
            }
        }
        if let (Some(file), Some(detections)) = (&mut self.detections, &cycle.detections) {
            let ball = detections
                .ball
                .iter()
                .chain(&detections.other_balls)
                .map(|ball| ("ball", ball.at, ball.covariance, ball.score));
            let robots = detections.robots.iter().map(|robot| {
                let kind = match robot.kind {
                    ObstacleKind::Robot => "robot",
                    ObstacleKind::Person => "person",
                };
                (kind, robot.at, robot.covariance, robot.score)
            });
            let goals = detections
                .goals
                .iter()
                .map(|goal| ("goal", goal.at, goal.covariance, goal.score));
            for (kind, at, [var_xx, _, var_yy], score) in ball.chain(robots).chain(goals) {
                // One value for both axes: the root of the mean variance.
                let std = ((var_xx + var_yy) / 2.0).max(0.0).sqrt();
                file.write_row(format_args!(
                    "{stamp},{kind},{:.4},{:.4},{std:.4},{score:.3}",
                    at.x, at.y
                ))?;
            }
        }
        Ok(())
    }

    /// Completes the files and gives them their names.
    pub fn finish(self) -> Result<()> {
        self.poses.map_or(Ok(()), CsvWriter::finish)?;
        self.points.map_or(Ok(()), CsvWriter::finish)?;
        self.detections.map_or(Ok(()), CsvWriter::finish)
    }
}

/// One row per image. Coordinates are empty while the robot is lost.
fn write_pose(file: &mut CsvWriter, stamp: &str, estimate: &Estimate) -> Result<()> {
    let (mode, points) = (mode_name(estimate.mode), estimate.line_points);
    let fit = fit_columns(estimate);
    let Some(pose) = estimate.pose else {
        return file.write_row(format_args!("{stamp},,,,,,,{mode},{points},{fit}"));
    };
    let [std_x, std_y, std_theta] = [0, 1, 2].map(|i| estimate.covariance[(i, i)].max(0.0).sqrt());
    file.write_row(format_args!(
        "{stamp},{:.5},{:.5},{:.6},{std_x:.5},{std_y:.5},{std_theta:.6},{mode},{points},{fit}",
        pose.x, pose.y, pose.theta
    ))
}

/// Reason of the mode, this image's points on markings and their residual, and the fit of the last seconds.
fn fit_columns(estimate: &Estimate) -> String {
    let reason = reason_text(estimate);
    let optional =
        |value: Option<f32>| value.map_or_else(String::new, |value| format!("{value:.3}"));
    format!(
        "{reason},{:.3},{:.4},{:.3},{},{}",
        estimate.inlier_share,
        estimate.inlier_rms,
        estimate.fit.markings_seen,
        optional(estimate.fit.wheel_agreement),
        optional(estimate.fit.compass_agreement)
    )
}

/// Name of a mode in poses.csv.
pub fn mode_name(mode: Mode) -> &'static str {
    match mode {
        Mode::Tracking => "tracking",
        Mode::Global => "global",
        Mode::Lost => "lost",
    }
}
