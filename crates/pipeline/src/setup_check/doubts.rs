//! What is wrong although no edit is known? Points off the markings, sensors that do not agree.

use localize::setup_check::Explanation;
use localize::{Stamp, math};
use nalgebra::Matrix3;

use super::assess::{Assessment, FIRM_MIN};
use super::dead_sensors::FIT_FINE;
use super::inertial;
use super::latency::{OtherLatency, YOUTH_MIN};
use super::measurements::MeasuredKeyframe;
use super::origin_offset::OriginOffset;
use super::pose_covariance::unknown_pose_covariance;
use super::ranges::RangeFinding;
use super::report::SetupReport;
use crate::recording::Table;
use crate::setup::{SensorSource, Setup};

/// Share of points on markings below which the map is doubted even if no edit is found: half of the points are false in the
/// worst halls.
const POINTS_POOR: f32 = 0.45;
/// A larger contradiction between wheels and poses is a jump to another place of the field, and no slip, metres.
const JUMP_MIN: f32 = 0.5;
/// Share of the steps that jump: two of forty.
const JUMPS_MIN: f32 = 0.05;
/// Wheels or compass that agree less are doubted even if no edit is found.
const SENSORS_POOR: f32 = 0.4;

impl SetupReport {
    /// Adds a warning for which no edit is known.
    pub(super) fn doubt(&mut self, text: String) {
        self.doubts.push(text.clone());
        self.warnings.push(text);
    }

    /// Doubts what `explained`, with all edits made, leaves unexplained; `still_path`: path of
    /// the poses of wheels that report no motion, metres.
    pub(super) fn add_doubts(
        &mut self,
        assessment: &Assessment,
        explained: &Explanation,
        still_path: Option<f32>,
        ranges: &[RangeFinding],
    ) {
        if explained.on_markings() < POINTS_POOR {
            if !assessment.fits_no_better_than_random {
                self.doubt(format!(
                "only {:.0} % of the line points on markings: the map, height or focal length may be wrong",
                100.0 * explained.on_markings()
            ));
            }
        } else {
            let known = |table| ranges.iter().any(|finding| finding.table == table);
            let mut changes = assessment.improvements.iter().flatten();
            let is_named = changes.any(|found| found.change.is_unit_or_axis_of_wheels());
            if let Some(path) = still_path.filter(|_| !is_named) {
                let place = self.sensors.place(Table::Odometry);
                self.doubt(format!(
                    "{place}: the wheels report no motion, but the images show one of about {path:.1} m"
                ));
            } else if !known(Table::Odometry) {
                let agree = explained
                    .wheels_agree()
                    .filter(|share| *share < SENSORS_POOR);
                self.doubt_sensor("wheels", Table::Odometry, agree);
            }
            if !known(Table::Compass) {
                let agree = explained
                    .compass_agrees()
                    .filter(|share| *share < SENSORS_POOR);
                self.doubt_sensor("compass", Table::Compass, agree);
            }
        }
    }

    /// Adds that images and wheels have stamps of different times, and what that does to the poses.
    pub(super) fn doubt_latency(&mut self, latency: &OtherLatency) {
        let OtherLatency {
            age,
            configured,
            pose_error,
        } = latency;
        let late = configured - age;
        // No image is from the future. One that seems to be so by less than is ever named may be of its stamp's time.
        self.doubt(if *age < -YOUTH_MIN {
            let edit = match self.sensors {
                SensorSource::Tables => {
                    format!("odometry.csv: subtract {late:.3} from stamp_s, or let the base stamp its samples earlier")
                }
                SensorSource::Devices => "let the base stamp its samples earlier".to_owned(),
            };
            format!(
                "the wheels' motion seems {:.0} ms later than that of the images: {edit}; or the wheels slip",
                1e3 * late,
            )
        } else {
            let age = age.max(0.0);
            format!(
                "the images seem {:.0} ms older than their stamps, the set-up says {:.0} ms: robot.toml: [timing] camera_latency = {age:.3}, if `mirrorball calibrate latency` finds it by the gyro, too; else the stamps of {} are {}, or the wheels slip",
                1e3 * age,
                1e3 * configured,
                self.sensors.place(Table::Odometry),
                if late > 0.0 { "late" } else { "early" },
            )
        });
        self.add_covariance(Matrix3::from_diagonal(
            &pose_error.component_mul(pose_error),
        ));
    }

    /// Adds that the clock of images or wheels leapt: from an image on, images are `age` seconds older than their stamps say. What that
    /// does to the poses is unknown before the leap is mended.
    /// `images`: the file that has their stamps.
    pub(super) fn doubt_clock(&mut self, age: f64, from: Stamp, images: &str, setup: &Setup) {
        let late = age.abs();
        let ([late_table, other], shift) = if age > 0.0 {
            ([images, "odometry.csv"], "earlier")
        } else {
            (["odometry.csv", images], "later")
        };
        self.doubt(format!(
            "a clock leaps by {late:.2} s shortly before {:.3} s: from there on the wheels explain the images only at stamps {late:.2} s {shift}. \
             {late_table}: subtract {late:.2} from stamp_s of the rows after the leap, or {other}: add it there",
            from.seconds(),
        ));
        self.add_covariance(unknown_pose_covariance(setup));
    }

    /// Adds that the camera was moved during the recording: the map explains the images until then. Localization learns the new mount
    /// while driving.
    pub(super) fn doubt_mount_after(&mut self, moved: Option<Stamp>) {
        let Some(stamp) = moved else { return };
        self.doubt(format!(
            "the camera was moved shortly before {:.3} s: the map explains the images until then, and no mount explains those before and after. \
             Calibrate it anew for what was recorded from there on",
            stamp.seconds(),
        ));
    }

    /// Adds that some poses contradict the wheels where many points lie off the markings, if no edit is known: other places of the
    /// field explain the points as well as the right ones. Nothing is known of the poses then. A compass does not count, since
    /// steel disturbs it.
    pub(super) fn doubt_markings(&mut self, setup: &Setup, assessment: &Assessment) {
        let configured = &assessment.configured;
        let steps = configured.steps();
        let jumps = steps.iter().filter(|step| {
            math::hypot(step.poses.x - step.wheels.x, step.poses.y - step.wheels.y) > JUMP_MIN
        });
        let jumps = jumps.count() as f32 / steps.len().max(1) as f32;
        let is_doubtful = configured.on_markings() < FIRM_MIN && jumps >= JUMPS_MIN;
        if !assessment.improvements.is_empty() || !is_doubtful {
            return;
        }
        self.doubt(format!(
            "only {:.0} % of the line points on markings, and {:.0} % of the steps between poses contradict the wheels: markings may be missing from the field file, or lie elsewhere",
            100.0 * configured.on_markings(),
            100.0 * jumps
        ));
        self.add_covariance(unknown_pose_covariance(setup));
    }

    /// Adds that poses and wheels turn about different points, and what that does to the poses.
    pub(super) fn doubt_origin(&mut self, offset: &OriginOffset) {
        let [x, y] = offset.at.into();
        self.doubt(format!(
            "the poses are those of a point that lies ({x:+.2}, {y:+.2}) m from the one that the wheels turn about: the map's origin is off (`mirrorball calibrate mount` moves it), or that of points.csv, or the wheels' matrix is wrong (`mirrorball calibrate wheels` measures it)"
        ));
        self.add_covariance(offset.pose_covariance());
    }

    /// Adds that a sensor's stamps are `late` seconds behind those of the wheels. `what`: what it measures.
    pub(super) fn doubt_stamps(&mut self, table: Table, what: &str, late: f32) {
        let (word, edit) = if late > 0.0 {
            ("late", "subtract")
        } else {
            ("early", "add")
        };
        let edit = match self.sensors {
            SensorSource::Tables => format!("{edit} {:.2} in the column stamp_s", late.abs()),
            SensorSource::Devices => {
                "let its driver stamp a sample when it was measured".to_owned()
            }
        };
        self.doubt(format!(
            "{}: its {what} come about {:.2} s too {word}, as the wheels turn (their stamps agree with the images): {edit}, or look for a filter in the sensor",
            self.sensors.place(table),
            late.abs()
        ));
    }

    /// Doubts an inertial unit that contradicts the poses or the wheels, and leaves it out. `late`: its stamps, seconds.
    pub(super) fn doubt_inertial_unit(
        &mut self,
        measured: &[MeasuredKeyframe],
        assessment: &Assessment,
        late: Option<f32>,
    ) {
        let explained = assessment.explained();
        if explained.on_markings() <= FIT_FINE {
            return;
        }
        if let Some(late) = late {
            self.unusable.push(Table::Imu);
            self.doubt_stamps(Table::Imu, "turns", late);
            return;
        }
        // The unit is compared with the wheels as they were measured, which such an edit calls wrong.
        let are_wheels_wrong = assessment.has_edit(|change| {
            change.is_unit_or_axis_of_wheels() || change.exceeds_learned_wheels()
        });
        let wheels_agree = explained
            .wheels_agree()
            .is_none_or(|share| share > FIT_FINE);
        let fault = inertial::find_fault(measured, explained, wheels_agree && !are_wheels_wrong);
        if let Some(fault) = fault {
            self.unusable.push(Table::Imu);
            let place = self.sensors.place(Table::Imu);
            self.doubt(format!("{place}: the inertial unit is not used: {fault}"));
        }
    }

    fn add_covariance(&mut self, covariance: Matrix3<f32>) {
        let before = self.added_pose_covariance.unwrap_or_default();
        self.added_pose_covariance = Some(before + covariance);
    }

    /// Adds a warning that a sensor agrees with few of the poses, if `agree` is given.
    fn doubt_sensor(&mut self, sensor: &str, table: Table, agree: Option<f32>) {
        if let Some(share) = agree {
            self.doubt(format!(
                "the {sensor} and the images agree by only {:.0} %: check units, signs and axes of {}",
                100.0 * share,
                self.sensors.place(table)
            ));
        }
    }
}
