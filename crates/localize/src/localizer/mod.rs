//! Where is the robot now, and does it know? Tracking while the sights agree, suspicion when they do not, a search of
//! the whole field when there is no pose, and several hypotheses while nothing has decided between them.
//!
//! Track → suspect → lost → relocalise follows nubot2013 4 (five cycles), with more evidence than its two thresholds:
//! share of inliers, deviation from the prediction, the best pose of the whole field, the compass.

pub(crate) mod candidates;
mod field_half;
mod global_localization;
mod measurements;
mod motion_inputs;
mod output;
mod tilt_bias;
mod track;

use std::sync::Arc;

use nalgebra::{Matrix3, Vector3};

use crate::config::{LocalizeConfig, Tracker};
use crate::estimate::{Estimate, Reason};
use crate::field::Field;
use crate::field::goal_colours::ColouredGoals;
use crate::filter::{PoseFilter, TiltPrior};
use crate::frames::Pose;
use crate::global_search::branch_and_bound::BranchAndBound;
use crate::global_search::scan_map::ScanMap;
use crate::global_search::{GlobalSearch, GlobalSearchMethod};
use crate::localizer::candidates::Candidates;
use crate::matching::Matcher;
use crate::matching::distance_field::DistanceField;
use crate::sample::{Compass, GoalObservation, LinePoint};
use crate::stamp::Stamp;

use field_half::HalfEvidence;
use motion_inputs::{MotionInputs, MotionMeasurement};
use tilt_bias::TiltBias;

/// Follows one robot over one field.
#[derive(Debug, Clone)]
pub struct Localizer {
    config: LocalizeConfig,
    distance_field: DistanceField,
    search: BranchAndBound,
    global_search: GlobalSearch,
    /// For the relocaliser or the tracker that needs it.
    scan_map: Option<Arc<ScanMap>>,
    matcher: Matcher,
    /// Variances of "somewhere on the field".
    uniform_covariance: Matrix3<f32>,
    filter: Option<PoseFilter>,
    /// Up to when belief, rival and candidates have been moved.
    filter_stamp: Stamp,
    /// What inertial unit, wheels and commands said last.
    motion_inputs: MotionInputs,
    tilt_bias: TiltBias,
    /// Of the frame at hand.
    tilt_prior: TiltPrior,
    /// Variances of the lean that the last tracked frame left.
    tilt_variances: Option<[f32; 2]>,
    /// Up to when the relocaliser's particles have been moved.
    particles_stamp: Stamp,
    /// The last odometry sample and the rate of motion it showed (per second).
    last_odometry: Option<(Stamp, [f32; 3])>,
    /// No gap in the odometry since the last frame.
    odometry_continuous: bool,
    last_compass: Option<Compass>,
    /// Did the last reading of the magnetic field say nothing but that something is nearby?
    magnetic_disturbance: bool,
    coloured_goals: ColouredGoals,
    /// Goals that the frame of this stamp shows.
    pending_goals: Option<(Stamp, Vec<GoalObservation>)>,
    half_evidence: HalfEvidence,
    /// A pose that explains the points better than the belief, and in how many frames it did.
    alternative: Option<(PoseFilter, u32)>,
    /// Hypotheses that nothing has decided between yet; none while there is a belief.
    candidates: Candidates,
    /// Suspect frames in a row, by the rule of thresholds.
    suspect_frames: u32,
    mean_inlier_share: f32,
    last_global_check: Stamp,
    out_of_order_count: u32,
    /// As it was after the last frame: a frame that comes later than odometry of its time goes on from here.
    snapshot: Option<Box<Snapshot>>,
    /// What was heard since then.
    buffered: Vec<MotionMeasurement>,
}

/// What odometry moves, at one time.
#[derive(Debug, Clone)]
struct Snapshot {
    filter_stamp: Stamp,
    motion_inputs: MotionInputs,
    filter: Option<PoseFilter>,
    alternative: Option<(PoseFilter, u32)>,
    candidates: Candidates,
}

/// Most samples kept for a late frame: a second of wheels, inertial unit and commands at 1 kHz each.
const BUFFERED_MAX: usize = 3000;

impl Localizer {
    /// Builds the field's tables, in parallel; knows nothing yet.
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
        let relocaliser = GlobalSearch::with_scan_map(
            field,
            &distances,
            &config.global_search,
            scan_map.as_ref(),
        );
        let (half_x, half_y) = field.carpet_half_extent();
        let turn = std::f32::consts::PI * std::f32::consts::PI / 3.0;
        Localizer {
            matcher: Matcher::new(config.matching.clone()),
            distance_field: distances,
            search,
            global_search: relocaliser,
            scan_map,
            uniform_covariance: Matrix3::from_diagonal(&Vector3::new(
                half_x * half_x / 3.0,
                half_y * half_y / 3.0,
                turn,
            )),
            filter: None,
            filter_stamp: Stamp(i64::MIN),
            motion_inputs: MotionInputs::default(),
            tilt_bias: TiltBias::new(&config.attitude),
            tilt_prior: TiltPrior::FromState,
            tilt_variances: None,
            particles_stamp: Stamp(i64::MIN),
            last_odometry: None,
            odometry_continuous: false,
            last_compass: None,
            magnetic_disturbance: false,
            coloured_goals: ColouredGoals::new(field),
            pending_goals: None,
            half_evidence: HalfEvidence::default(),
            alternative: None,
            candidates: Candidates::default(),
            suspect_frames: 0,
            mean_inlier_share: 0.0,
            last_global_check: Stamp(i64::MIN),
            out_of_order_count: 0,
            snapshot: None,
            buffered: Vec::new(),
            config,
        }
    }

    /// The configuration in use.
    pub fn config(&self) -> &LocalizeConfig {
        &self.config
    }

    /// The scan map, if the configuration needs one.
    pub fn scan_map(&self) -> Option<&ScanMap> {
        self.scan_map.as_deref()
    }

    /// The distance look-up, for drawing and for other matchers.
    pub fn distance_field(&self) -> &DistanceField {
        &self.distance_field
    }

    /// Memory held by the field's tables, bytes.
    pub fn memory_bytes(&self) -> usize {
        let scan_map = self.scan_map.as_ref().map_or(0, |map| map.memory_bytes());
        self.distance_field.memory_bytes()
            + self.search.memory_bytes()
            + self.global_search.memory_bytes()
            + scan_map
    }

    /// Particles of the relocaliser, if it has some.
    pub fn particles(&self) -> &[Pose] {
        self.global_search.particles()
    }

    /// Starts from a pose that is known (placed by hand, a team-mate's word), half included.
    pub fn set_pose(&mut self, stamp: Stamp, pose: Pose, covariance: &Matrix3<f32>) {
        self.reset();
        self.filter = Some(PoseFilter::new(pose, covariance, None, &self.config.filter));
        self.half_evidence = HalfEvidence::external(&self.config.compass);
        self.filter_stamp = stamp;
        self.particles_stamp = stamp;
        self.last_global_check = stamp;
        self.odometry_continuous = true;
    }

    /// Takes a frame's line points to a pose. Points that are not finite are left out.
    pub fn process_points(&mut self, stamp: Stamp, points: &[LinePoint]) -> Estimate {
        let mut points: Vec<LinePoint> = points
            .iter()
            .filter(|point| is_plausible(point))
            .copied()
            .collect();
        let exposed = stamp + -f64::from(self.latency());
        if let Some((of, _)) = &mut self.pending_goals
            && *of == stamp
        {
            *of = exposed;
        }
        let later = self.rewind_to(exposed);
        if self.has_pose_hypotheses() && self.filter_stamp.seconds_until(exposed) < 0.0 {
            self.count_out_of_order();
            if self.out_of_order_count > 0 {
                return self.estimate(stamp, Some(Reason::OutOfOrder), None, Vec::new());
            }
        }
        let led = self.odometry_covers(exposed);
        if led {
            self.predict_to(exposed);
        }
        if !led || self.config.tracker == Tracker::None {
            self.reset();
        }
        self.odometry_continuous = true;
        let passed = self.filter_stamp.seconds_until(exposed);
        self.filter_stamp = exposed;
        self.particles_stamp = self.particles_stamp.max(exposed);
        let lean = self.compensate_tilt(exposed, &mut points);
        let mut estimate = if self.filter.is_some() {
            self.track(exposed, &points)
        } else {
            self.localize_globally(exposed, &points)
        };
        if let Some((felt, expected)) = lean {
            self.update_tilt_bias(felt, &expected, &estimate, passed as f32);
            for (value, mean) in estimate.tilt.iter_mut().zip(expected.mean) {
                *value += mean;
            }
        }
        self.buffered.clear();
        self.snapshot = self.has_pose_hypotheses().then(|| {
            Box::new(Snapshot {
                filter_stamp: self.filter_stamp,
                motion_inputs: self.motion_inputs.clone(),
                filter: self.filter.clone(),
                alternative: self.alternative.clone(),
                candidates: self.candidates.clone(),
            })
        });
        for one in later {
            self.receive(one);
        }
        Estimate {
            stamp,
            line_points: points.len(),
            ..self.predict_estimate_to(stamp, estimate)
        }
    }

    /// An estimate of a frame's exposure moved on to its stamp, where the two differ.
    fn predict_estimate_to(&mut self, stamp: Stamp, estimate: Estimate) -> Estimate {
        let seconds = estimate.stamp.seconds_until(stamp);
        if !(seconds > 0.0) {
            return estimate;
        }
        // Beyond the last sample on a copy: later samples will tell it better.
        let beyond = self.filter_stamp.seconds_until(stamp);
        let Some(mut belief) = self.filter.clone() else {
            return estimate;
        };
        if beyond > 0.0 {
            let config = &self.config.attitude;
            let span =
                self.motion_inputs
                    .clone()
                    .prediction_input(self.filter_stamp, stamp, config);
            belief.predict(&span, &self.config.filter);
        }
        Estimate {
            pose: estimate.pose.and(Some(belief.pose())),
            covariance: estimate
                .pose
                .map_or(estimate.covariance, |_| belief.covariance()),
            twist: estimate.twist.and(Some(belief.twist())),
            ..estimate
        }
    }

    /// From a frame's exposure to its stamp, as far as is known, seconds.
    fn latency(&self) -> f32 {
        self.filter
            .as_ref()
            .map_or(self.config.filter.camera_latency, PoseFilter::latency)
    }

    fn reset(&mut self) {
        self.filter = None;
        self.candidates.clear();
        self.global_search.reset();
        self.half_evidence = HalfEvidence::default();
        self.alternative = None;
        self.suspect_frames = 0;
        self.snapshot = None;
        self.buffered.clear();
    }
}

/// Only points that a camera can have seen take part.
fn is_plausible(point: &LinePoint) -> bool {
    let value = |value: f32| value.is_finite() && value.abs() < 100.0;
    value(point.at.x)
        && value(point.at.y)
        && value(point.std_radial)
        && value(point.std_tangential)
        && point.std_radial >= 0.0
        && point.std_tangential >= 0.0
}
