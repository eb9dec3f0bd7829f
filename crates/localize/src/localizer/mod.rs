//! Where is the robot now, and does it know? Tracking while the sights agree, suspicion when they do not, a search of
//! the whole field when there is no pose, and several hypotheses while nothing has decided between them.
//!
//! Track → suspect → lost → relocalise follows nubot2013 4 (five cycles), with more evidence than its two thresholds:
//! share of inliers, deviation from the prediction, the best pose of the whole field, the compass.

mod half;
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
use crate::filter::Belief;
use crate::frame::Pose;
use crate::goals::ColouredGoals;
use crate::matching::Matcher;
use crate::relocalise::scan_map::{Origin, ScanMap};
use crate::relocalise::{Relocaliser, RelocaliserKind};
use crate::sample::{Compass, GoalSight, LinePoint, Odometry};
use crate::search::Search;
use crate::stamp::Stamp;

use half::HalfEvidence;

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
    /// The last odometry sample and the rate of motion it showed (per second).
    odometry: Option<(Stamp, [f32; 3])>,
    /// No gap in the odometry since the last frame.
    led: bool,
    compass: Option<Compass>,
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
    /// Moves since then.
    moves: Vec<Move>,
}

/// What odometry moves, at one time.
#[derive(Debug, Clone)]
struct Base {
    reached: Stamp,
    belief: Option<Belief>,
    rival: Option<(Belief, u32)>,
    candidates: Candidates,
}

/// A motion in the robot frame (metres, metres, radians) between two times.
#[derive(Debug, Clone, Copy)]
struct Move {
    from: Stamp,
    to: Stamp,
    motion: [f32; 3],
}

/// Most moves kept for a late frame: a second of odometry at 1 kHz.
const MOVES_MAX: usize = 1000;

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
            odometry: None,
            led: false,
            compass: None,
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
            moves: Vec::new(),
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
        self.checked = stamp;
        self.led = true;
    }

    /// Moves the expected pose. Samples come in the order of their stamps, before the frame of
    /// the same stamp; a frame may come later than newer odometry.
    pub fn odometry(&mut self, sample: &Odometry) {
        let motion = [sample.dx, sample.dy, sample.dtheta];
        if motion.iter().any(|value| !value.is_finite()) {
            self.led = false;
            return;
        }
        let gap = self.config.mode.gap_max;
        let Some((previous, _)) = self.odometry else {
            self.odometry = Some((sample.stamp, [0.0; 3]));
            // Its interval began at the last frame, if at all.
            let seconds = self.reached.seconds_until(sample.stamp);
            self.led = self.follows() && (0.0..=gap).contains(&seconds);
            if self.led {
                self.move_on(sample.stamp, motion);
            }
            return;
        };
        let interval = previous.seconds_until(sample.stamp);
        if interval <= 0.0 {
            self.note_past();
            return;
        }
        self.past = 0;
        self.odometry = Some((sample.stamp, motion.map(|value| value / interval as f32)));
        if interval > gap {
            self.led = false;
            return;
        }
        // A part of the interval may have been bridged already, for a frame between two samples.
        let left = self.reached.seconds_until(sample.stamp).min(interval);
        if left > 0.0 {
            let part = (left / interval) as f32;
            self.move_on(sample.stamp, motion.map(|value| value * part));
        }
    }

    /// Notes a compass reading; it decides the half of the field, and where a search begins.
    pub fn compass(&mut self, sample: &Compass) {
        if !sample.heading.is_finite() {
            return;
        }
        self.compass = Some(*sample);
        let config = &self.config.compass;
        if let Some(belief) = &self.belief
            && self.reached.seconds_until(sample.stamp).abs() <= config.age_max
        {
            self.half
                .hear(sample.stamp, belief.pose().theta, sample.heading, config);
        }
    }

    /// Notes the goals that the frame of this stamp shows, before its line points are seen; where their colours differ,
    /// they decide the half of the field too.
    pub fn goals(&mut self, stamp: Stamp, sights: &[GoalSight]) {
        let sane = |sight: &&GoalSight| {
            let sizes = [sight.at.x, sight.at.y, sight.std, sight.width];
            sizes.iter().all(|value| value.is_finite()) && sight.std >= 0.0
        };
        self.goals = Some((stamp, sights.iter().filter(sane).copied().collect()));
    }

    /// The goals noted for a frame.
    fn goals_of(&mut self, stamp: Stamp) -> Vec<GoalSight> {
        let noted = self.goals.take().filter(|(of, _)| *of == stamp);
        noted.map_or_else(Vec::new, |(_, sights)| sights)
    }

    /// Hears log odds for the half of the field in which the belief is, rather than the other one, of a source that is
    /// no compass: the team's ball (`team::TeamView::half_evidence`).
    pub fn half_evidence(&mut self, odds: f32) {
        if self.belief.is_some() {
            self.half.add(odds, &self.config.compass);
        }
    }

    /// Takes a frame's line points to a pose. Points that are not finite are left out.
    pub fn see(&mut self, stamp: Stamp, points: &[LinePoint]) -> Estimate {
        let points: Vec<LinePoint> = points.iter().filter(|point| sane(point)).copied().collect();
        let later = self.go_back(stamp);
        if self.follows() && self.reached.seconds_until(stamp) < 0.0 {
            self.note_past();
            if self.past > 0 {
                return self.estimate(stamp, Some(Reason::FromThePast), None, Vec::new());
            }
        }
        let led = self.leads_to(stamp);
        if led {
            self.bridge(stamp);
        }
        if !led || self.config.tracker == Tracker::None {
            self.forget();
        }
        self.led = true;
        self.reached = stamp;
        let estimate = if self.belief.is_some() {
            self.track(stamp, &points)
        } else {
            self.relocate(stamp, &points)
        };
        self.moves.clear();
        self.base = self.follows().then(|| {
            Box::new(Base {
                reached: self.reached,
                belief: self.belief.clone(),
                rival: self.rival.clone(),
                candidates: self.candidates.clone(),
            })
        });
        for one in later {
            self.shift(one);
        }
        Estimate {
            line_points: points.len(),
            ..estimate
        }
    }

    /// For a frame that is older than the odometry heard since (cameras are slow): back to the last frame, forward to
    /// this one; the moves after it are returned.
    fn go_back(&mut self, stamp: Stamp) -> Vec<Move> {
        let Some(base) = self
            .base
            .take_if(|base| base.reached <= stamp && stamp < self.reached)
        else {
            return Vec::new();
        };
        self.reached = base.reached;
        self.belief = base.belief;
        self.rival = base.rival;
        self.candidates = base.candidates;
        let mut later = Vec::new();
        for one in std::mem::take(&mut self.moves) {
            let (all, part) = (
                one.from.seconds_until(one.to),
                one.from.seconds_until(stamp),
            );
            let part = (part / all).clamp(0.0, 1.0) as f32;
            if part > 0.0 {
                self.shift(Move {
                    to: one.to.min(stamp),
                    motion: one.motion.map(|value| value * part),
                    ..one
                });
            }
            if part < 1.0 {
                later.push(Move {
                    from: one.from.max(stamp),
                    motion: one.motion.map(|value| value * (1.0 - part)),
                    ..one
                });
            }
        }
        later
    }

    /// Is there anything that odometry moves?
    fn follows(&self) -> bool {
        self.belief.is_some() || !self.candidates.is_empty() || self.relocaliser.active()
    }

    /// Has odometry been reported without a gap from the last frame to this one?
    fn leads_to(&self, stamp: Stamp) -> bool {
        let gap = self.config.mode.gap_max;
        self.led
            && self.follows()
            && self.reached.seconds_until(stamp) <= gap
            && self
                .odometry
                .is_some_and(|(last, _)| last.seconds_until(stamp) <= gap)
    }

    /// Carries on from the last odometry sample to the frame, at the rate last reported.
    fn bridge(&mut self, stamp: Stamp) {
        let seconds = self.reached.seconds_until(stamp) as f32;
        if seconds > 0.0 {
            let rate = self.odometry.map_or([0.0; 3], |(_, rate)| rate);
            self.move_on(stamp, rate.map(|value| value * seconds));
        }
    }

    fn move_on(&mut self, stamp: Stamp, motion: [f32; 3]) {
        self.shift(Move {
            from: self.reached,
            to: stamp,
            motion,
        });
        self.relocaliser.moved(motion);
    }

    /// Moves belief, rival and candidates, and notes it for a late frame.
    fn shift(&mut self, one: Move) {
        self.reached = one.to;
        let config = &self.config.filter;
        let seconds = one.from.seconds_until(one.to) as f32;
        let belief = self.belief.iter_mut();
        let rival = self.rival.iter_mut().map(|(belief, _)| belief);
        for belief in belief.chain(rival).chain(self.candidates.beliefs()) {
            belief.predict(one.motion, seconds, config);
        }
        if self.moves.len() >= MOVES_MAX {
            self.moves.clear();
            self.base = None;
        }
        self.moves.push(one);
    }

    /// A sample older than the last: left out, unless the source's clock was set back.
    fn note_past(&mut self) {
        self.past += 1;
        if self.past >= self.config.mode.past_max {
            self.past = 0;
            self.forget();
            self.odometry = None;
            self.compass = None;
            self.reached = Stamp(i64::MIN);
        }
    }

    fn forget(&mut self) {
        self.belief = None;
        self.candidates.clear();
        self.relocaliser.restart();
        self.half = HalfEvidence::default();
        self.rival = None;
        self.strikes = 0;
        self.base = None;
        self.moves.clear();
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
