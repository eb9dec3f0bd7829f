//! Where is the robot now, and does it know? Tracking while the sights agree, suspicion when they do not, a search of
//! the whole field when there is no pose, and several hypotheses while nothing has decided between them.
//!
//! Track → suspect → lost → relocalise follows nubot2013 4 (five cycles), with more evidence than its two thresholds:
//! share of inliers, deviation from the prediction, the best pose of the whole field, the compass.

mod half;
mod hearing;
mod lean;
mod motion;
mod relocate;
mod report;
mod track;

use std::path::Path;
use std::sync::Arc;

use nalgebra::{Matrix3, Vector3};

use crate::candidates::Candidates;
use crate::config::{LocalizeConfig, Tracker};
use crate::distance::DistanceField;
use crate::estimate::{Estimate, Reason};
use crate::field::Field;
use crate::filter::{Belief, LeanPrior};
use crate::frame::Pose;
use crate::goals::ColouredGoals;
use crate::matching::Matcher;
use crate::relocalise::scan_map::{Origin, ScanMap};
use crate::relocalise::{Relocaliser, RelocaliserKind};
use crate::sample::{Compass, GoalSight, LinePoint};
use crate::search::Search;
use crate::stamp::Stamp;

use half::HalfEvidence;
use lean::LeanOffset;
use motion::{Motion, Witness};

/// Follows one robot over one field.
#[derive(Debug, Clone)]
pub struct Localizer {
    config: LocalizeConfig,
    distances: DistanceField,
    search: Search,
    relocaliser: Relocaliser,
    /// For the relocaliser or the tracker that needs it.
    scan_map: Option<Arc<ScanMap>>,
    matcher: Matcher,
    /// Variances of "somewhere on the field".
    anywhere: Matrix3<f32>,
    belief: Option<Belief>,
    /// Up to when belief, rival and candidates have been moved.
    reached: Stamp,
    /// What inertial unit, wheels and commands said last.
    motion: Motion,
    lean: LeanOffset,
    /// Of the frame at hand.
    lean_prior: LeanPrior,
    /// Variances of the lean that the last tracked frame left.
    lean_left: Option<[f32; 2]>,
    /// Up to when the relocaliser's particles have been moved.
    carried: Stamp,
    /// The last odometry sample and the rate of motion it showed (per second).
    odometry: Option<(Stamp, [f32; 3])>,
    /// No gap in the odometry since the last frame.
    led: bool,
    compass: Option<Compass>,
    /// Did the last reading of the magnetic field say nothing but that something is nearby?
    iron_nearby: bool,
    coloured: ColouredGoals,
    /// Goals that the frame of this stamp shows.
    goals: Option<(Stamp, Vec<GoalSight>)>,
    half: HalfEvidence,
    /// A pose that explains the points better than the belief, and in how many frames it did.
    rival: Option<(Belief, u32)>,
    /// Hypotheses that nothing has decided between yet; none while there is a belief.
    candidates: Candidates,
    /// Suspect frames in a row, by the rule of thresholds.
    strikes: u32,
    usual_share: f32,
    checked: Stamp,
    past: u32,
    /// As it was after the last frame: a frame that comes later than odometry of its time goes on from here.
    base: Option<Box<Base>>,
    /// What was heard since then.
    heard: Vec<Witness>,
}

/// What odometry moves, at one time.
#[derive(Debug, Clone)]
struct Base {
    reached: Stamp,
    motion: Motion,
    belief: Option<Belief>,
    rival: Option<(Belief, u32)>,
    candidates: Candidates,
}

/// Most samples kept for a late frame: a second of wheels, inertial unit and commands at 1 kHz each.
const HEARD_MAX: usize = 3000;

impl Localizer {
    /// Builds the field's tables, in parallel; knows nothing yet.
    pub fn new(field: &Field, config: LocalizeConfig) -> Self {
        Localizer::build(field, config, None).0
    }

    /// The same with a folder where a scan map, which takes a second to build, is kept from run to run; says where it
    /// came from if the configuration needs one.
    pub fn cached(field: &Field, config: LocalizeConfig, folder: &Path) -> (Self, Option<Origin>) {
        Localizer::build(field, config, Some(folder))
    }

    fn build(
        field: &Field,
        config: LocalizeConfig,
        folder: Option<&Path>,
    ) -> (Self, Option<Origin>) {
        let distances = DistanceField::new(field, &config.distance);
        let by = config.relocalise.by;
        let needed = by == RelocaliserKind::ScanMap || config.tracker == Tracker::ScanMap;
        let scan_map = || {
            let config = config.relocalise.scan_map.clone();
            needed.then(|| match folder {
                Some(folder) => {
                    let (map, origin) = ScanMap::cached(folder, field, &distances, config);
                    (Arc::new(map), Some(origin))
                }
                None => (Arc::new(ScanMap::new(field, &distances, config)), None),
            })
        };
        let search = || Search::new(field, &distances, config.search.clone());
        let (search, scan_map) = rayon::join(search, scan_map);
        let (scan_map, origin) = scan_map.unzip();
        let relocaliser =
            Relocaliser::with_map(field, &distances, &config.relocalise, scan_map.as_ref());
        let (half_x, half_y) = field.carpet_half_extent();
        let turn = std::f32::consts::PI * std::f32::consts::PI / 3.0;
        let localizer = Localizer {
            matcher: Matcher::new(config.matching.clone()),
            distances,
            search,
            relocaliser,
            scan_map,
            anywhere: Matrix3::from_diagonal(&Vector3::new(
                half_x * half_x / 3.0,
                half_y * half_y / 3.0,
                turn,
            )),
            belief: None,
            reached: Stamp(i64::MIN),
            motion: Motion::default(),
            lean: LeanOffset::new(&config.attitude),
            lean_prior: LeanPrior::Own,
            lean_left: None,
            carried: Stamp(i64::MIN),
            odometry: None,
            led: false,
            compass: None,
            iron_nearby: false,
            coloured: ColouredGoals::new(field),
            goals: None,
            half: HalfEvidence::default(),
            rival: None,
            candidates: Candidates::default(),
            strikes: 0,
            usual_share: 0.0,
            checked: Stamp(i64::MIN),
            past: 0,
            base: None,
            heard: Vec::new(),
            config,
        };
        (localizer, origin.flatten())
    }

    /// The configuration in use.
    pub fn config(&self) -> &LocalizeConfig {
        &self.config
    }

    /// The distance look-up, for drawing and for other matchers.
    pub fn distances(&self) -> &DistanceField {
        &self.distances
    }

    /// Memory held by the field's tables, bytes.
    pub fn bytes(&self) -> usize {
        let scan_map = self.scan_map.as_ref().map_or(0, |map| map.bytes());
        self.distances.bytes() + self.search.bytes() + self.relocaliser.bytes() + scan_map
    }

    /// Particles of the relocaliser, if it has some.
    pub fn particles(&self) -> &[Pose] {
        self.relocaliser.particles()
    }

    /// Starts from a pose that is known (placed by hand, a team-mate's word), half included.
    pub fn set_pose(&mut self, stamp: Stamp, pose: Pose, covariance: &Matrix3<f32>) {
        self.forget();
        self.belief = Some(Belief::new(pose, covariance, None, &self.config.filter));
        self.half = HalfEvidence::told(&self.config.compass);
        self.reached = stamp;
        self.carried = stamp;
        self.checked = stamp;
        self.led = true;
    }

    /// Takes a frame's line points to a pose. Points that are not finite are left out.
    pub fn see(&mut self, stamp: Stamp, points: &[LinePoint]) -> Estimate {
        let mut points: Vec<LinePoint> =
            points.iter().filter(|point| sane(point)).copied().collect();
        let exposed = stamp + -f64::from(self.latency());
        if let Some((of, _)) = &mut self.goals
            && *of == stamp
        {
            *of = exposed;
        }
        let later = self.go_back(exposed);
        if self.follows() && self.reached.seconds_until(exposed) < 0.0 {
            self.note_past();
            if self.past > 0 {
                return self.estimate(stamp, Some(Reason::FromThePast), None, Vec::new());
            }
        }
        let led = self.leads_to(exposed);
        if led {
            self.bridge(exposed);
        }
        if !led || self.config.tracker == Tracker::None {
            self.forget();
        }
        self.led = true;
        let passed = self.reached.seconds_until(exposed);
        self.reached = exposed;
        self.carried = self.carried.max(exposed);
        let lean = self.bend(exposed, &mut points);
        let mut estimate = if self.belief.is_some() {
            self.track(exposed, &points)
        } else {
            self.relocate(exposed, &points)
        };
        if let Some((felt, expected)) = lean {
            self.learn_lean(felt, &expected, &estimate, passed as f32);
            for (value, mean) in estimate.lean.iter_mut().zip(expected.mean) {
                *value += mean;
            }
        }
        self.heard.clear();
        self.base = self.follows().then(|| {
            Box::new(Base {
                reached: self.reached,
                motion: self.motion.clone(),
                belief: self.belief.clone(),
                rival: self.rival.clone(),
                candidates: self.candidates.clone(),
            })
        });
        for one in later {
            self.hear(one);
        }
        Estimate {
            stamp,
            line_points: points.len(),
            ..self.at_stamp(stamp, estimate)
        }
    }

    /// An estimate of a frame's exposure moved on to its stamp, where the two differ.
    fn at_stamp(&mut self, stamp: Stamp, estimate: Estimate) -> Estimate {
        let seconds = estimate.stamp.seconds_until(stamp);
        if !(seconds > 0.0) {
            return estimate;
        }
        // Beyond the last sample on a copy: later samples will tell it better.
        let beyond = self.reached.seconds_until(stamp);
        let Some(mut belief) = self.belief.clone() else {
            return estimate;
        };
        if beyond > 0.0 {
            let config = &self.config.attitude;
            let span = self.motion.clone().span(self.reached, stamp, config);
            belief.advance(&span, &self.config.filter);
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
        self.belief
            .as_ref()
            .map_or(self.config.filter.camera_latency, Belief::latency)
    }

    fn forget(&mut self) {
        self.belief = None;
        self.candidates.clear();
        self.relocaliser.restart();
        self.half = HalfEvidence::default();
        self.rival = None;
        self.strikes = 0;
        self.base = None;
        self.heard.clear();
    }
}

/// Only points that a camera can have seen take part.
fn sane(point: &LinePoint) -> bool {
    let value = |value: f32| value.is_finite() && value.abs() < 100.0;
    value(point.at.x)
        && value(point.at.y)
        && value(point.std_radial)
        && value(point.std_tangential)
        && point.std_radial >= 0.0
        && point.std_tangential >= 0.0
}
