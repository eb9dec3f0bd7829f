//! Localization of one robot on one field: a state machine over pose filters.
//!
//! Each image is matched under the prediction while it agrees (Tracking), compared with the whole field when it does not
//! (Suspect), and searched on the whole field without a pose (Lost). Several hypotheses are kept until the images
//! decide between them (Ambiguous). `state` holds the states, `transitions` what leads from one to another.

mod candidates;
mod carried_back;
mod cooperative_config;
mod evidence;
mod field_half;
mod fit_monitor;
mod global_check;
mod global_localization;
mod gyro_conflict;
mod map_learning;
mod match_figures;
mod mate_record;
mod measurements;
mod motion_inputs;
mod output;
mod own_motion;
mod repeated_pose_error;
mod state;
mod stuck_compass;
mod supported_points;
mod team_sightings;
mod tilt_bias;
mod tilt_compensation;
mod tilt_spread;
mod track;
mod transitions;

use std::collections::VecDeque;
use std::sync::Arc;

use nalgebra::{Matrix3, Vector3};

use crate::advice::Advisor;
use crate::config::{LocalizeConfig, Tracker};
use crate::estimate::{Estimate, Reason};
use crate::field::Field;
use crate::field::goal_colours::ColouredGoals;
use crate::filter::{OdometryPrior, PoseFilter, TiltPrior};
use crate::frames::Pose;
use crate::global_search::branch_and_bound::BranchAndBound;
use crate::global_search::scan_map::ScanMap;
use crate::global_search::{GlobalSearch, GlobalSearchMethod};
use crate::map_correction::MapCorrection;
use crate::matching::Matcher;
use crate::matching::distance_field::DistanceField;
use crate::omni::{OmniKinematics, Twist};
use crate::sample::{Compass, GoalObservation, LinePoint};
use crate::stamp::Stamp;

use candidates::Candidates;
use carried_back::carry_back;
pub use cooperative_config::CooperativeConfig;
use field_half::HalfEvidence;
pub use field_half::HalfState;
use fit_monitor::{FitMarkings, FitMonitor};
use gyro_conflict::GyroConflict;
use match_figures::MatchFigures;
use motion_inputs::{MotionInputs, MotionMeasurement};
pub use own_motion::ImageMotion;
use own_motion::OwnMotion;
use repeated_pose_error::RepeatedPoseError;
use state::{GlobalCheck, State};
use stuck_compass::StuckCompass;
pub use team_sightings::{
    SightingDirection, SightingOutcome, SightingPair, SightingRival, TeamSighting,
};
use tilt_bias::TiltBias;
use tilt_spread::TiltSpread;

/// Localizes one robot on one field.
///
/// Wheels and line points enter in the order in which they arrive.
///
/// ```
/// # fn main() -> Result<(), localize::field::FieldError> {
/// use std::path::Path;
///
/// use localize::omni::Twist;
/// use localize::sample::LinePoint;
/// use localize::{At, Field, LocalizeConfig, Localizer, Mode, Pose, Stamp};
/// use nalgebra::Matrix3;
///
/// let config = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../config/fields/msl_18x12.toml");
/// let mut localizer = Localizer::new(&Field::load(&config)?, LocalizeConfig::default());
/// localizer.set_pose(Stamp(0), Pose::new(0.1, 0.0, 0.0), &(Matrix3::identity() * 0.01));
///
/// // The robot stands at (0, 0) and sees the halfway line on both sides, and the centre circle of 2 m ahead.
/// let point = |x, y| LinePoint { at: At::new(x, y), std_radial: 0.02, std_tangential: 0.02 };
/// let mut points: Vec<LinePoint> = (10..40).flat_map(|i| [point(0.0, 0.1 * i as f32), point(0.0, -0.1 * i as f32)]).collect();
/// points.extend((-10..=10).map(|i| 0.05 * i as f32).map(|a| point(1.94 * a.cos(), 1.94 * a.sin())));
///
/// localizer.add_odometry(&Twist::default().integrate(Stamp(20_000_000), 0.0));
/// let estimate = localizer.process_points(Stamp(33_000_000), &points);
/// assert_ne!(estimate.mode, Mode::Lost);
/// assert!(estimate.pose.is_some_and(|pose| pose.x.abs() < 0.03));
/// # Ok(())
/// # }
/// ```
#[derive(Debug, Clone)]
pub struct Localizer {
    config: LocalizeConfig,
    distance_field: DistanceField,
    search: BranchAndBound,
    global_search: GlobalSearch,
    /// Only if the global search or the tracker uses it.
    scan_map: Option<Arc<ScanMap>>,
    matcher: Matcher,
    advisor: Advisor,
    coloured_goals: ColouredGoals,
    /// Covariance of a uniform distribution over the field.
    uniform_covariance: Matrix3<f32>,
    state: State,
    /// Time to which all filters of `state` are predicted.
    filter_stamp: Stamp,
    motion_inputs: MotionInputs,
    /// State after the last image, or at the start. An image older than newer samples restarts from it. None only while an image
    /// is processed.
    snapshot: Option<Box<Snapshot>>,
    /// Samples since the snapshot.
    buffered: Vec<MotionMeasurement>,
    /// For late measurements.
    own_motion: OwnMotion,
    /// Stamp of the last image that was used: the filters' motions begin there.
    last_image: Option<Stamp>,
    image_motion: Option<ImageMotion>,
    /// Time to which the particles of the global search are predicted.
    particles_stamp: Stamp,
    last_odometry: Option<LastOdometry>,
    /// No gap in the odometry since the last image.
    odometry_continuous: bool,
    out_of_order_count: u32,
    /// The last readings of the compass: an image is as old as the latency.
    compass_readings: VecDeque<Compass>,
    stuck_compass: StuckCompass,
    /// Goals in the image of this stamp.
    pending_goals: Option<(Stamp, Vec<GoalObservation>)>,
    tilt_bias: TiltBias,
    tilt_spread: TiltSpread,
    /// The tilt for which the current image's points are compensated, radians.
    expected_tilt: [f32; 2],
    /// Prior of the current image's tilt.
    tilt_prior: TiltPrior,
    /// Somebody found that field, map or sensors are not as configured.
    setup_is_doubted: bool,
    /// Posterior variances of the tilt in the last tracked image, rad².
    tilt_variances: Option<[f32; 2]>,
    repeated_error: RepeatedPoseError,
    gyro_conflict: GyroConflict,
    /// Check of the tracked pose against the whole field, a part in each image.
    global_check: Option<GlobalCheck>,
    /// Smoothed over about a second of tracked images.
    mean_inlier_share: f32,
    fit_monitor: FitMonitor,
    /// None: the map counts as exact.
    map_correction: Option<Box<MapCorrection>>,
    /// Standard deviation of the map's origin from the robot's centre, per axis, metres.
    map_origin_std: f32,
    map_turn_std: f32,
    /// Standard deviation of the field's markings, metres, if the field was measured.
    marking_std: f32,
    odometry_prior: OdometryPrior,
    /// Consecutive images that fit nowhere on the field.
    lost_images: u32,
}

/// What odometry changes, at the time of one image.
#[derive(Debug, Clone)]
struct Snapshot {
    filter_stamp: Stamp,
    motion_inputs: MotionInputs,
    state: State,
}

/// The last odometry sample.
#[derive(Debug, Clone, Copy)]
struct LastOdometry {
    stamp: Stamp,
    /// Mean over its interval. Zero for the first sample.
    twist: Twist,
}

/// Share of an image's points that lie off the markings in right set-ups.
const CLUTTER_SHARE: f32 = 0.1;
/// Most samples buffered for a late image: one second of wheels, inertial unit and commands at 1 kHz each.
const BUFFERED_MAX: usize = 3000;
/// Line points of an image: a camera shows a tenth of them, and searches take longer than in proportion to their number.
const POINTS_MAX: usize = 4096;
/// Most readings of the compass kept: a second and a half at 200 Hz.
const COMPASS_READINGS_MAX: usize = 300;

impl Localizer {
    /// Builds the field's tables in parallel. The pose is unknown at first.
    pub fn new(field: &Field, config: LocalizeConfig) -> Self {
        Localizer::with_scan_map(field, config, None)
    }

    /// True if the configuration needs a scan map, which takes a second to build.
    pub fn needs_scan_map(config: &LocalizeConfig) -> bool {
        config.global_search.method == GlobalSearchMethod::ScanMap
            || config.tracker == Tracker::ScanMap
    }

    /// The same with a scan map built earlier from this field and configuration; one is built if needed and not given.
    pub fn with_scan_map(field: &Field, config: LocalizeConfig, stored: Option<ScanMap>) -> Self {
        let distances = DistanceField::new(field, &config.distance_field);
        let scan_map = || {
            let scan_config = config.global_search.scan_map.clone();
            let build = || ScanMap::new(field, &distances, scan_config);
            Localizer::needs_scan_map(&config).then(|| Arc::new(stored.unwrap_or_else(build)))
        };
        let search = || BranchAndBound::new(field, &distances, config.branch_and_bound.clone());
        let (search, scan_map) = rayon::join(search, scan_map);
        let global_search = GlobalSearch::with_scan_map(
            field,
            &distances,
            &config.global_search,
            scan_map.as_ref(),
        );
        let (half_x, half_y) = field.carpet_half_extent();
        let heading_variance = std::f32::consts::PI * std::f32::consts::PI / 3.0;
        let mut localizer = Localizer {
            map_correction: None,
            map_origin_std: 0.0,
            map_turn_std: 0.0,
            marking_std: field.marking_std(),
            odometry_prior: OdometryPrior::of_any_base(&config.filter),
            lost_images: 0,
            matcher: Matcher::new(config.matching.clone()),
            advisor: Advisor::new(field, config.advice.clone()),
            distance_field: distances,
            search,
            global_search,
            scan_map,
            uniform_covariance: Matrix3::from_diagonal(&Vector3::new(
                half_x * half_x / 3.0,
                half_y * half_y / 3.0,
                heading_variance,
            )),
            state: State::Lost,
            filter_stamp: Stamp(i64::MIN),
            motion_inputs: MotionInputs::default(),
            tilt_bias: TiltBias::new(&config.attitude),
            tilt_spread: TiltSpread::new(&config),
            global_check: None,
            tilt_prior: TiltPrior::STATE,
            setup_is_doubted: false,
            tilt_variances: None,
            expected_tilt: [0.0; 2],
            repeated_error: RepeatedPoseError::default(),
            gyro_conflict: GyroConflict::default(),
            particles_stamp: Stamp(i64::MIN),
            last_odometry: None,
            odometry_continuous: false,
            compass_readings: VecDeque::new(),
            stuck_compass: StuckCompass::default(),
            coloured_goals: ColouredGoals::new(field),
            pending_goals: None,
            mean_inlier_share: 0.0,
            fit_monitor: FitMonitor::new(field),
            out_of_order_count: 0,
            snapshot: None,
            buffered: Vec::new(),
            own_motion: OwnMotion::default(),
            last_image: None,
            image_motion: None,
            config,
        };
        localizer.set_map_basis(None);
        localizer.keep_snapshot();
        localizer
    }

    /// The scan map, if the configuration needs one.
    pub fn scan_map(&self) -> Option<&ScanMap> {
        self.scan_map.as_deref()
    }

    /// Size of the field's tables, bytes.
    pub fn memory_bytes(&self) -> usize {
        let scan_map = self.scan_map.as_ref().map_or(0, |map| map.memory_bytes());
        self.distance_field.memory_bytes()
            + self.search.memory_bytes()
            + self.global_search.memory_bytes()
            + scan_map
    }

    /// Particles of the Monte Carlo search. Empty for other methods.
    pub fn particles(&self) -> &[Pose] {
        self.global_search.particles()
    }

    /// Field, map or sensors are not as configured, or are so again: what does not fit the field is then no tilt of the robot.
    pub fn doubt_setup(&mut self, is_doubted: bool) {
        self.setup_is_doubted = is_doubted;
    }

    /// Starts tracking from a known pose (placed by hand, or a team-mate's message). Its field half counts as established.
    pub fn set_pose(&mut self, stamp: Stamp, pose: Pose, covariance: &Matrix3<f32>) {
        let half = HalfEvidence::external(&self.config.compass).state();
        self.resume_pose(stamp, pose, covariance, half);
    }

    /// Evidence for the field half of the tracked pose. None while no single pose is tracked.
    pub fn tracked_half(&self) -> Option<HalfState> {
        self.state.track().map(|track| track.half_evidence.state())
    }

    /// Tells which wheels measure the odometry, and the matrix by which their motion was multiplied, if any: which errors
    /// it may have follows from them. Holds for poses found from now on.
    pub fn set_wheels(&mut self, wheels: &OmniKinematics, calibration: Option<&[[f32; 3]; 3]>) {
        self.odometry_prior = OdometryPrior::of_wheels(&self.config.filter, wheels, calibration);
    }

    /// True while several hypotheses explain the images, so that no single pose describes what is known.
    pub fn has_several_hypotheses(&self) -> bool {
        matches!(self.state, State::Ambiguous(_))
    }

    /// Goes on from the pose that another localizer tracked, with what it knew about the field half.
    pub fn resume_pose(
        &mut self,
        stamp: Stamp,
        pose: Pose,
        covariance: &Matrix3<f32>,
        half: HalfState,
    ) {
        self.lose_pose();
        let filter = PoseFilter::new(
            pose,
            covariance,
            None,
            &self.config.filter,
            &self.odometry_prior,
        );
        let half_evidence = HalfEvidence::from_state(half);
        self.start_tracking(stamp, filter, half_evidence);
        self.filter_stamp = stamp;
        self.particles_stamp = stamp;
        self.odometry_continuous = true;
        self.keep_snapshot();
    }

    /// Estimates the pose from an image's line points. Points that are not finite are dropped. Of more than 4096 points those
    /// count that remain at equal steps.
    ///
    /// The image is applied at its exposure, `stamp` minus the camera latency (docs/methods.md 8.10).
    pub fn process_points(&mut self, stamp: Stamp, points: &[LinePoint]) -> Estimate {
        let step = points.len().div_ceil(POINTS_MAX).max(1);
        let points = points.iter().step_by(step);
        let mut points: Vec<LinePoint> = points
            .filter(|point| is_plausible(point))
            .copied()
            .collect();
        let exposed = stamp + -f64::from(self.latency());
        self.image_motion = None;
        if let Some((goals_stamp, _)) = &mut self.pending_goals
            && *goals_stamp == stamp
        {
            *goals_stamp = exposed;
        }
        let later = self.rewind_to(exposed);
        if self.has_pose_hypotheses() && self.filter_stamp.seconds_until(exposed) < 0.0 {
            // An image that was exposed before the pose was told is no sign of another clock.
            let is_out_of_order = self.filter_stamp.seconds_until(stamp) < 0.0;
            if is_out_of_order {
                self.count_out_of_order();
            }
            if !is_out_of_order || self.out_of_order_count > 0 {
                let reason = Some(Reason::OutOfOrder);
                let estimate = self.estimate(stamp, reason, MatchFigures::default(), Vec::new());
                return carry_back(estimate, self.filter_stamp);
            }
        }
        self.tilt_variances = None;
        let covered = self.odometry_covers(exposed);
        if covered {
            self.predict_to(exposed);
        }
        if !covered || self.config.tracker == Tracker::None {
            self.lose_pose();
        }
        self.odometry_continuous = true;
        let elapsed = self.filter_stamp.seconds_until(exposed);
        self.filter_stamp = exposed;
        self.particles_stamp = self.particles_stamp.max(exposed);
        self.correct_line_points(&mut points);
        let imu_tilt = self.compensate_tilt(exposed, &mut points);
        let mut estimate = match std::mem::take(&mut self.state) {
            State::Lost => {
                let estimate = self.localize_globally(exposed, &points, Candidates::default());
                self.restart_map(exposed, &points, &estimate);
                estimate
            }
            State::Ambiguous(candidates) => {
                let estimate = self.localize_globally(exposed, &points, candidates);
                self.restart_map(exposed, &points, &estimate);
                estimate
            }
            State::Tracking(track) => self.track(exposed, &points, track, None),
            State::Suspect(track, suspicion) => {
                self.track(exposed, &points, track, Some(suspicion))
            }
        };
        self.measure_fit(&mut estimate, &points);
        if let Some(imu_tilt) = imu_tilt {
            self.update_tilt_bias(&imu_tilt, &estimate, elapsed as f32);
            for (value, mean) in estimate.tilt.iter_mut().zip(imu_tilt.expected.mean) {
                *value += mean;
            }
        }
        self.take_image_motion(stamp);
        self.take_snapshot();
        let at_exposure = self.state.best_filter().map(PoseFilter::covariance);
        for measurement in later {
            self.receive(measurement);
        }
        let mut estimate = Estimate {
            stamp,
            line_points: points.len(),
            ..self.predict_estimate_to(stamp, estimate, at_exposure)
        };
        self.add_repeated_errors(&mut estimate);
        self.add_other_places(&mut estimate);
        self.refer_to_viewpoint(&mut estimate);
        if self
            .fit_monitor
            .is_doubtful(self.config.mode.inlier_share_min)
        {
            estimate.mark_setup_doubtful(&self.uniform_covariance);
        }
        estimate
    }

    /// Motion from the image before to the last one. None unless one pose was followed from one to the other.
    pub fn image_motion(&self) -> Option<&ImageMotion> {
        self.image_motion.as_ref()
    }

    /// At the end of an image: the motion to it, and the begin of the next one.
    fn take_image_motion(&mut self, stamp: Stamp) {
        let before = self.last_image.replace(stamp);
        let estimate = self.state.best_filter().and_then(PoseFilter::image_motion);
        self.image_motion = before.zip(estimate).map(|(from, estimate)| ImageMotion {
            from,
            to: stamp,
            estimate,
        });
        self.state.for_each_filter(PoseFilter::begin_image_motion);
    }

    /// Adds the errors of the map that filtering does not average away.
    fn add_repeated_errors(&self, estimate: &mut Estimate) {
        let averaged = estimate.covariance;
        if self.state.track().is_some() {
            estimate.covariance +=
                self.repeated_error.covariance() + self.gyro_conflict.covariance();
        }
        self.add_map_uncertainty(estimate);
        estimate.repeated_covariance = estimate.covariance - averaged;
    }

    /// Under a doubted set-up a wrong place may explain most of an image's points for seconds: the share that it does not explain is the
    /// probability of another one.
    fn add_other_places(&self, estimate: &mut Estimate) {
        if self.setup_is_doubted && estimate.pose.is_some() && estimate.inlier_share > 0.0 {
            let unexplained = (1.0 - CLUTTER_SHARE - estimate.inlier_share).max(0.0);
            estimate.covariance = self.with_probability(1.0 - unexplained, &estimate.covariance);
        }
    }

    /// Adds the image to the figures of the fit. `points` are compensated for the tilt that was expected; the estimate's
    /// tilt is what remains.
    fn measure_fit(&mut self, estimate: &mut Estimate, points: &[LinePoint]) {
        let heading = self
            .heading_prior(estimate.stamp)
            .map(|prior| prior.heading);
        let markings = FitMarkings {
            distances: &self.distance_field,
            matching: &self.config.matching,
        };
        self.fit_monitor
            .add_image(estimate, points, &markings, heading);
        estimate.fit = self.fit_monitor.fit();
    }

    /// Predicts an estimate from the exposure to the image's stamp. `at_exposure`: covariance of the best hypothesis then. That of an
    /// estimate among several hypotheses is larger, and grows as much.
    fn predict_estimate_to(
        &mut self,
        stamp: Stamp,
        estimate: Estimate,
        at_exposure: Option<Matrix3<f32>>,
    ) -> Estimate {
        let seconds = estimate.stamp.seconds_until(stamp);
        if !(seconds > 0.0) {
            return estimate;
        }
        // The part after the last sample is predicted on a copy, since later samples will measure it.
        let unmeasured = self.filter_stamp.seconds_until(stamp);
        let best = self.state.best_filter().cloned();
        let Some((mut filter, before)) = best.zip(at_exposure) else {
            return estimate;
        };
        if unmeasured > 0.0 {
            let config = &self.config.attitude;
            let input =
                self.motion_inputs
                    .clone()
                    .prediction_input(self.filter_stamp, stamp, config);
            filter.predict(&input, &self.config.filter);
        }
        let covariance = match (estimate.pose, self.state.track()) {
            (None, _) => estimate.covariance,
            (Some(_), Some(_)) => filter.covariance(),
            (Some(_), None) => estimate.covariance + (filter.covariance() - before),
        };
        Estimate {
            pose: estimate.pose.and(Some(filter.pose())),
            covariance,
            twist: estimate.twist.and(Some(filter.twist())),
            ..estimate
        }
    }

    /// Time from an image's exposure to its stamp, seconds: estimated while tracking, else as configured.
    fn latency(&self) -> f32 {
        self.state
            .filter()
            .map_or(self.config.filter.camera_latency, PoseFilter::latency)
    }
}

/// Could a camera have measured this point?
fn is_plausible(point: &LinePoint) -> bool {
    let in_range = |value: f32| value.is_finite() && value.abs() < 100.0;
    in_range(point.at.x)
        && in_range(point.at.y)
        && in_range(point.std_radial)
        && in_range(point.std_tangential)
        && point.std_radial >= 0.0
        && point.std_tangential >= 0.0
}
