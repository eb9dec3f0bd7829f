//! What are the results of a run? Errors, detections and durations, as text and as data.

use localize::estimate::Mode;
use localize::frames::{At, RobotFrame};
use localize::tilt::ground_from_map;
use serde::Serialize;
use vision::config::ObjectDetectionConfig;
use vision::exposure::ExposureStatus;

use crate::cycle::Cycle;
use crate::sample::GroundTruth;
use crate::score::{self, PoseError, SampleStatistics};
use crate::setup::Setup;

/// Farther balls do not count as missed, metres.
const BALL_RANGE: f32 = 6.0;
/// Largest error of a correct ball detection: metres, plus a share of the distance.
const BALL_TOLERANCE: (f32, f32) = (0.15, 0.1);

/// Results of a run as `--json` prints them.
#[derive(Debug, Clone, Serialize)]
pub struct Summary {
    /// Number of images.
    pub frames: usize,
    /// Images in mode tracking that were matched to the field.
    pub tracking: usize,
    /// Images in mode tracking whose pose is predicted by the motion alone: the image could not be used or matched.
    pub predicted: usize,
    /// Images in mode global.
    pub global: usize,
    /// Images in mode lost.
    pub lost: usize,
    /// Images that could not be used.
    pub unreadable: usize,
    /// Line points per image, median. None without images, like the times.
    pub line_points: Option<f64>,
    /// Images with ground truth.
    pub scored: usize,
    /// Position error, metres.
    pub position_error_m: Option<SampleStatistics>,
    /// Magnitude of the heading error, radians.
    pub heading_error_rad: Option<SampleStatistics>,
    /// Ball results, if the ground truth includes the ball.
    pub ball: Option<BallSummary>,
    /// Exposure control, if it was active.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub exposure: Option<ExposureSummary>,
    /// Time from image to features, milliseconds, median.
    pub see_ms: Option<f64>,
    /// Time from features to pose, milliseconds, median.
    pub localize_ms: Option<f64>,
}

/// Results of ball detection.
#[derive(Debug, Clone, Default, Serialize)]
pub struct BallSummary {
    /// Images with the ball within range, occluded or not.
    pub within_range: usize,
    /// Number of these images with a correct detection.
    pub found: usize,
    /// Images with a false detection.
    pub false_finds: usize,
    /// Median error of correct detections, metres. None if there are none.
    pub error_m: Option<f64>,
}

/// Results of exposure control.
#[derive(Debug, Clone, Default, Serialize)]
pub struct ExposureSummary {
    /// Completed searches for the best setting.
    pub searches: usize,
    /// Longest search: images from its first command to the first well-exposed image.
    pub longest_frames: usize,
}

/// Statistics of a run, collected cycle by cycle.
pub struct RunStatistics {
    /// Height of the mirror's viewpoint, metres.
    viewpoint_height: f32,
    modes: [usize; 3],
    predicted: usize,
    unreadable: usize,
    line_points: Vec<f64>,
    position: Vec<f64>,
    heading: Vec<f64>,
    ball: BallSummary,
    ball_errors: Vec<f64>,
    exposure: ExposureSummary,
    /// Image at which the current exposure search began.
    search_began: Option<usize>,
    see_ms: Vec<f64>,
    localize_ms: Vec<f64>,
}

impl RunStatistics {
    /// Statistics of a run of this robot.
    pub fn new(setup: &Setup) -> Self {
        RunStatistics {
            viewpoint_height: setup
                .viewpoint_height
                .unwrap_or(ObjectDetectionConfig::default().viewpoint_height),
            modes: [0; 3],
            predicted: 0,
            unreadable: 0,
            line_points: Vec::new(),
            position: Vec::new(),
            heading: Vec::new(),
            ball: BallSummary::default(),
            ball_errors: Vec::new(),
            exposure: ExposureSummary::default(),
            search_began: None,
            see_ms: Vec::new(),
            localize_ms: Vec::new(),
        }
    }

    /// Adds a cycle, with its error if the truth is known.
    pub fn add_cycle(&mut self, cycle: &Cycle, error: Option<PoseError>) {
        let estimate = &cycle.estimate;
        if estimate.mode == Mode::Tracking && estimate.is_predicted() {
            self.predicted += 1;
        } else {
            self.modes[estimate.mode as usize] += 1;
        }
        self.unreadable += usize::from(cycle.image_fault.is_some());
        self.line_points.push(cycle.line_points.len() as f64);
        self.see_ms.push(f64::from(cycle.timings.see_ms));
        self.localize_ms.push(f64::from(cycle.timings.localize_ms));
        if let Some(error) = error {
            self.position.push(f64::from(error.position));
            self.heading.push(f64::from(error.heading.abs()));
        }
        if let Some(reading) = &cycle.exposure {
            self.add_exposure(reading);
        }
        if let (Some(truth), Some(detections)) = (&cycle.inputs.truth, &cycle.detections) {
            let found = detections.ball.map(|ball| {
                let at = [ball.at.x, ball.at.y];
                let [x, y] = ground_from_map(at, cycle.estimate.tilt, self.viewpoint_height);
                At::new(x, y)
            });
            self.add_ball(truth, found);
        }
    }

    fn add_exposure(&mut self, reading: &ExposureStatus) {
        let frame = self.line_points.len();
        match (reading.searching, self.search_began) {
            (true, None) => self.search_began = Some(frame),
            (false, Some(began)) => {
                self.search_began = None;
                self.exposure.searches += 1;
                self.exposure.longest_frames = self.exposure.longest_frames.max(frame - began);
            }
            _ => {}
        }
    }

    fn add_ball(&mut self, truth: &GroundTruth, found: Option<At<RobotFrame>>) {
        let Some(ball) = truth.ball else { return };
        let ball = truth.pose.inverse() * ball;
        let (tolerance, share) = BALL_TOLERANCE;
        let error = found.map(|found| found.distance_to(ball));
        let hit = error.filter(|&error| error <= tolerance + share * ball.distance());
        self.ball_errors.extend(hit.map(f64::from));
        if ball.distance() <= BALL_RANGE {
            self.ball.within_range += 1;
            self.ball.found += usize::from(hit.is_some());
        }
        self.ball.false_finds += usize::from(found.is_some() && hit.is_none());
    }

    /// The results.
    pub fn summary(self) -> Summary {
        let median =
            |values: Vec<f64>| score::sample_statistics(values).map(|statistics| statistics.median);
        let [tracking, global, lost] = self.modes;
        let knows_ball = self.ball.within_range > 0 || self.ball.false_finds > 0;
        Summary {
            frames: self.line_points.len(),
            tracking,
            predicted: self.predicted,
            global,
            lost,
            unreadable: self.unreadable,
            line_points: median(self.line_points),
            scored: self.position.len(),
            position_error_m: score::sample_statistics(self.position),
            heading_error_rad: score::sample_statistics(self.heading),
            ball: knows_ball.then(|| BallSummary {
                error_m: median(self.ball_errors),
                ..self.ball
            }),
            exposure: (self.exposure.searches > 0).then_some(self.exposure),
            see_ms: median(self.see_ms),
            localize_ms: median(self.localize_ms),
        }
    }
}

/// A count with its noun: `1 frame`, `2 frames`.
pub fn pluralize(count: usize, thing: &str) -> String {
    let plural = if count == 1 { "" } else { "s" };
    format!("{count} {thing}{plural}")
}

/// A number for a reader, "–" for none.
pub(crate) fn figure(value: Option<f64>, decimals: usize) -> String {
    value.map_or("–".to_owned(), |value| format!("{value:.decimals$}"))
}

impl Summary {
    /// Prints the results as text.
    pub fn print(&self) {
        let unreadable = match self.unreadable {
            0 => String::new(),
            count => format!("; {count} could not be used"),
        };
        let predicted = match self.predicted {
            0 => String::new(),
            count => format!("{count} predicted (no image matched), "),
        };
        println!(
            "{}: {} tracked, {predicted}{} found anew, {} lost{unreadable}",
            pluralize(self.frames, "frame"),
            self.tracking,
            self.global,
            self.lost
        );
        println!(
            "{} line points a frame (median)",
            figure(self.line_points, 0)
        );
        if let (Some(position), Some(heading)) = (self.position_error_m, self.heading_error_rad) {
            println!(
                "position error: mean {:.1} cm, median {:.1} cm, 95 % below {:.1} cm, largest {:.1} cm ({})",
                100.0 * position.mean,
                100.0 * position.median,
                100.0 * position.p95,
                100.0 * position.max,
                pluralize(self.scored, "frame")
            );
            println!(
                "heading error:  mean {:.2}°, median {:.2}°, 95 % below {:.2}°, largest {:.2}°",
                heading.mean.to_degrees(),
                heading.median.to_degrees(),
                heading.p95.to_degrees(),
                heading.max.to_degrees()
            );
        }
        if let Some(ball) = &self.ball {
            println!(
                "ball: found in {} of {} frames within {BALL_RANGE} m (hidden ones counted), {} cm off (median), {} false",
                ball.found,
                ball.within_range,
                figure(ball.error_m.map(|error| 100.0 * error), 1),
                ball.false_finds
            );
        }
        if let Some(exposure) = &self.exposure {
            println!(
                "exposure: followed the light {} times, settled within {} frames",
                exposure.searches, exposure.longest_frames
            );
        }
        println!(
            "time a frame (median): vision {} ms, localization {} ms",
            figure(self.see_ms, 2),
            figure(self.localize_ms, 3)
        );
    }
}

#[cfg(test)]
mod tests {
    use localize::{Pose, Stamp};

    use super::*;
    use crate::testing::sample_recording;

    #[test]
    fn medians_of_nothing_are_absent() {
        let robot = sample_recording().join("robot.toml");
        let setup = Setup::load(&robot, None).expect("a setup");
        let mut statistics = RunStatistics::new(&setup);
        let truth = GroundTruth {
            stamp: Stamp(0),
            pose: Pose::new(0.0, 0.0, 0.0),
            ball: Some(At::new(1.0, 0.0)),
            ball_height: 0.0,
            robots: Vec::new(),
            robot_headings: Vec::new(),
            people: Vec::new(),
        };
        statistics.add_ball(&truth, None);
        let summary = statistics.summary();
        let ball = summary.ball.expect("within range");
        assert_eq!((ball.within_range, ball.found, ball.error_m), (1, 0, None));
        assert_eq!(summary.line_points, None);
        assert_eq!((summary.see_ms, summary.localize_ms), (None, None));
        assert_eq!(figure(ball.error_m, 1), "–");
    }
}
