//! How far is an estimator from the truth, and does it know? Sums over the frames of all seeds.

use localize::config::LocalizeConfig;
use localize::estimate::{Estimate, Mode};
use localize::frame::{Pose, wrap_angle};
use localize::{Field, Localizer, Stamp, Tf};
use nalgebra::Vector3;

use super::drive::{Frame, Heard, RADIUS_SCALE, Recorded};
use super::{Course, Estimator, Row};

/// Scored from here on: the first search and the first second of learning are not fusion.
const BEGUN: f64 = 2.0;
/// The odometry's scale is judged from here on, seconds.
const SCALE_LEARNT: f64 = 60.0;
/// 2.5 and 97.5 % of χ² with three degrees of freedom.
const BAND: [f32; 2] = [0.216, 9.348];

/// Sums of one estimator on one course.
#[derive(Debug, Clone, Default)]
pub(super) struct Frames {
    count: usize,
    position: f64,
    position_max: f32,
    heading: f64,
    along: f64,
    moving: usize,
    nees: f64,
    inside: usize,
    judged: usize,
    searched: usize,
    blind: Vec<f32>,
    after_hits: Vec<f32>,
    scale_off: Option<f32>,
    latency: f32,
}

impl Frames {
    fn add(&mut self, frame: &Frame, pose: Pose) {
        if frame.stamp.seconds() < BEGUN {
            return;
        }
        let off = apart(pose, frame.truth);
        let distance = off[0].hypot(off[1]);
        if frame.blind_end {
            self.blind.push(distance);
        }
        if frame.blind {
            return;
        }
        self.count += 1;
        self.position += f64::from(distance);
        self.position_max = self.position_max.max(distance);
        self.heading += f64::from(off[2].abs().to_degrees());
        let [vx, vy] = frame.velocity;
        let speed = vx.hypot(vy);
        if speed > 0.5 {
            self.along += f64::from((off[0] * vx + off[1] * vy) / speed);
            self.moving += 1;
        }
    }

    fn judge(&mut self, frame: &Frame, estimate: &Estimate) {
        let (Some(pose), false) = (estimate.pose, frame.blind) else {
            return;
        };
        let off = apart(pose, frame.truth);
        let Some(inverse) = estimate.covariance.try_inverse() else {
            return;
        };
        let squared = off.dot(&(inverse * off));
        self.nees += f64::from(squared);
        self.inside += usize::from((BAND[0]..=BAND[1]).contains(&squared));
        self.judged += 1;
    }

    pub(super) fn row(&self, course: Course, estimator: Estimator) -> Row {
        let mean = |sum: f64, count: usize| (sum / count.max(1) as f64) as f32;
        let average =
            |all: &[f32]| (!all.is_empty()).then(|| all.iter().sum::<f32>() / all.len() as f32);
        Row {
            course,
            estimator,
            frames: self.count,
            position: mean(self.position, self.count),
            position_max: self.position_max,
            heading_deg: mean(self.heading, self.count),
            blind: average(&self.blind),
            blind_max: self.blind.iter().copied().reduce(f32::max),
            after_hit: average(&self.after_hits),
            along: mean(self.along, self.moving),
            nees: mean(self.nees, self.judged),
            nees_inside: self.inside as f32 / self.judged.max(1) as f32,
            searched: self.searched,
            scale_off: self.scale_off,
            latency: self.latency,
        }
    }
}

/// Lets a localizer follow the drive with the samples that this estimator has.
pub(super) fn follow(
    estimator: Estimator,
    config: LocalizeConfig,
    drive: &Recorded,
    field: &Field,
    frames: &mut Frames,
) {
    let mut localizer = Localizer::new(field, config);
    let wheels = !matches!(estimator, Estimator::Vision | Estimator::NoOdometry);
    let inertial = !matches!(estimator, Estimator::Vision | Estimator::NoImu);
    let mut last = None;
    let mut hits = Hits::new(&drive.hits);
    for one in &drive.heard {
        match one {
            Heard::Odometry(one) if wheels => localizer.add_odometry(one),
            Heard::Imu(one) if inertial => localizer.add_imu(one),
            Heard::Command(one) if inertial || wheels => localizer.add_command(one),
            Heard::Compass(one) => localizer.add_compass(one),
            Heard::Frame(frame) => {
                let estimate = localizer.process_points(frame.stamp, &frame.points);
                let begun = frame.stamp.seconds() >= BEGUN;
                // Alone, every frame is found by a search.
                let searched = estimate.mode != Mode::Tracking && estimator != Estimator::Vision;
                frames.searched += usize::from(begun && searched);
                last = estimate.pose.or(last);
                if let Some(pose) = last {
                    frames.add(frame, pose);
                    hits.add(frame, pose);
                }
                if begun {
                    frames.judge(frame, &estimate);
                }
                if frame.stamp.seconds() > SCALE_LEARNT && estimate.pose.is_some() && wheels {
                    let off = (estimate.odometry_scales[0] - RADIUS_SCALE).abs();
                    frames.scale_off = Some(frames.scale_off.unwrap_or(0.0).max(off));
                }
                frames.latency = estimate.latency;
            }
            _ => {}
        }
    }
    hits.finish(frames);
}

/// Adds the wheels' motions up from the true start.
pub(super) fn dead_reckoning(drive: &Recorded, frames: &mut Frames) {
    let mut pose = drive.start;
    let mut hits = Hits::new(&drive.hits);
    for one in &drive.heard {
        match one {
            Heard::Odometry(one) => pose = pose * Tf::new(one.dx, one.dy, one.dtheta),
            Heard::Frame(frame) => {
                frames.add(frame, pose);
                hits.add(frame, pose);
            }
            _ => {}
        }
    }
    hits.finish(frames);
}

/// The largest error in the second after each hit.
struct Hits<'a> {
    stamps: &'a [Stamp],
    largest: Vec<f32>,
}

impl<'a> Hits<'a> {
    fn new(stamps: &'a [Stamp]) -> Self {
        Hits {
            stamps,
            largest: vec![0.0; stamps.len()],
        }
    }

    fn add(&mut self, frame: &Frame, pose: Pose) {
        if frame.blind {
            return;
        }
        let off = apart(pose, frame.truth);
        for (stamp, largest) in self.stamps.iter().zip(&mut self.largest) {
            if (0.0..1.0).contains(&stamp.seconds_until(frame.stamp)) {
                *largest = largest.max(off[0].hypot(off[1]));
            }
        }
    }

    fn finish(self, frames: &mut Frames) {
        frames.after_hits.extend(self.largest);
    }
}

fn apart(a: Pose, b: Pose) -> Vector3<f32> {
    Vector3::new(a.x - b.x, a.y - b.y, wrap_angle(a.theta - b.theta))
}
