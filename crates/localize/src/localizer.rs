//! Where is the robot now, and does it know? Tracking while the sights agree, suspicion when they do not, a search of
//! the whole field when there is no pose, and several hypotheses while nothing has decided between them.
//!
//! Track → suspect → lost → relocalise follows nubot2013 4 (five cycles), with more evidence than its two thresholds:
//! share of inliers, deviation from the prediction, the best pose of the whole field, the compass.

use nalgebra::{Matrix3, Vector3};

use crate::config::LocalizeConfig;
use crate::distance::DistanceField;
use crate::field::Field;
use crate::filter::Belief;
use crate::frame::{Pose, wrap_angle};
use crate::matching::{Match, Matcher};
use crate::sample::{Compass, LinePoint, Odometry};
use crate::search::{HeadingPrior, Hypothesis, Search};
use crate::stamp::Stamp;

/// How a frame's pose came about.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Mode {
    /// Carried on from the frame before, by odometry and matching.
    Tracking,
    /// Found on the whole field in this frame, or followed while the half of the field is not yet known.
    Global,
    /// Not known.
    Lost,
}

/// Why a frame's pose is not a plainly tracked one.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Reason {
    /// Too few line points: odometry alone carries the pose.
    FewPoints,
    /// The points do not lie on the markings as they use to, but no other pose explains them better.
    PoorMatch,
    /// Another pose explains the points better: suspected.
    Rival,
    /// The compass contradicts the pose: suspected, or turned to the other half.
    CompassContradicts,
    /// Odometry alone for too long.
    Blind,
    /// No pose on the whole field explains the points.
    NothingFits,
    /// Several poses explain the points: the runners-up.
    Ambiguous,
    /// The frame is older than what is known already; it was not used.
    FromThePast,
}

/// What one frame says about the place.
#[derive(Debug, Clone, PartialEq)]
pub struct Estimate {
    /// The frame's.
    pub stamp: Stamp,
    /// The pose, none when lost.
    pub pose: Option<Pose>,
    /// Of (x, y, θ), metres and radians, hypotheses that are not ruled out included; the field's own size when lost.
    pub covariance: Matrix3<f32>,
    /// How the pose came about.
    pub mode: Mode,
    /// Why it is not a plainly tracked one.
    pub reason: Option<Reason>,
    /// Root mean square distance of the inliers from the markings, metres.
    pub residual: f32,
    /// Share of the points on markings.
    pub inlier_share: f32,
    /// Line points used.
    pub line_points: usize,
    /// Lean (a, b) of the robot in this frame, radians.
    pub lean: [f32; 2],
    /// Is it known in which half the robot is (compass, prior pose, or a field that tells)?
    pub half_known: bool,
    /// Estimated metres per metre and radians per radian of the odometry.
    pub odometry_scales: [f32; 2],
    /// Poses that explain the points too, with their probabilities; without the pose itself.
    pub runners_up: Vec<Hypothesis>,
}

/// Follows one robot over one field.
#[derive(Debug, Clone)]
pub struct Localizer {
    config: LocalizeConfig,
    distances: DistanceField,
    search: Search,
    matcher: Matcher,
    /// Variances of "somewhere on the field".
    anywhere: Matrix3<f32>,
    belief: Option<Belief>,
    /// Up to when `belief` has been moved.
    reached: Stamp,
    /// The last odometry sample and the rate of motion it showed (per second).
    odometry: Option<(Stamp, [f32; 3])>,
    /// No gap in the odometry since the last frame.
    led: bool,
    compass: Option<Compass>,
    /// Log odds that the belief's half is right rather than the other one.
    half_evidence: f32,
    strikes: u32,
    usual_share: f32,
    checked: Stamp,
    past: u32,
}

impl Localizer {
    /// Builds the field's tables; knows nothing yet.
    pub fn new(field: &Field, config: LocalizeConfig) -> Self {
        let distances = DistanceField::new(field, &config.distance);
        let search = Search::new(field, &distances, config.search.clone());
        let (half_x, half_y) = field.carpet_half_extent();
        let turn = std::f32::consts::PI * std::f32::consts::PI / 3.0;
        Localizer {
            matcher: Matcher::new(config.matching.clone()),
            distances,
            search,
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
            half_evidence: 0.0,
            strikes: 0,
            usual_share: 0.0,
            checked: Stamp(i64::MIN),
            past: 0,
            config,
        }
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
        self.distances.bytes() + self.search.bytes()
    }

    /// Starts from a pose that is known (placed by hand, a team-mate's word), half included.
    pub fn set_pose(&mut self, stamp: Stamp, pose: Pose, covariance: &Matrix3<f32>) {
        self.adopt(stamp, pose, covariance);
        self.half_evidence = self.config.compass.evidence_max;
        self.led = true;
    }

    /// Moves the expected pose. Samples must come in the order of their stamps, before the frame of the same stamp.
    pub fn odometry(&mut self, sample: &Odometry) {
        let motion = [sample.dx, sample.dy, sample.dtheta];
        if motion.iter().any(|value| !value.is_finite()) {
            self.led = false;
            return;
        }
        let Some((previous, _)) = self.odometry else {
            self.odometry = Some((sample.stamp, [0.0; 3]));
            // The first sample's interval is unknown: it leads only from a pose that is younger than the gap.
            let seconds = seconds_between(self.reached, sample.stamp);
            self.led = self.belief.is_some() && (0.0..=self.config.mode.gap_max).contains(&seconds);
            if self.led {
                self.move_belief(sample.stamp, motion, seconds as f32);
            }
            return;
        };
        let interval = seconds_between(previous, sample.stamp);
        if interval <= 0.0 {
            self.note_past();
            return;
        }
        self.past = 0;
        self.odometry = Some((sample.stamp, motion.map(|value| value / interval as f32)));
        if interval > self.config.mode.gap_max {
            self.led = false;
            return;
        }
        // Part of the interval may have been bridged already, for a frame between two samples.
        let left = seconds_between(self.reached, sample.stamp).min(interval);
        if left > 0.0 {
            let part = (left / interval) as f32;
            self.move_belief(sample.stamp, motion.map(|value| value * part), left as f32);
        }
    }

    /// Notes a compass reading.
    pub fn compass(&mut self, sample: &Compass) {
        if !sample.heading.is_finite() {
            return;
        }
        self.compass = Some(*sample);
        if let Some(belief) = &self.belief {
            let seconds = seconds_between(self.reached, sample.stamp).abs();
            if seconds <= self.config.compass.age_max {
                let deviation = wrap_angle(belief.pose().theta - sample.heading);
                let config = &self.config.compass;
                self.half_evidence = (self.half_evidence + half_evidence(deviation, config))
                    .clamp(-config.evidence_max, config.evidence_max);
            }
        }
    }

    /// Takes a frame's line points to a pose. Points that are not finite are left out.
    pub fn see(&mut self, stamp: Stamp, points: &[LinePoint]) -> Estimate {
        let points: Vec<LinePoint> = points.iter().filter(|point| sane(point)).copied().collect();
        if self.belief.is_some() && seconds_between(self.reached, stamp) < 0.0 {
            self.note_past();
            if self.past > 0 {
                return self.estimate(stamp, Some(Reason::FromThePast), None, &[]);
            }
        }
        if self.leads_to(stamp) {
            self.bridge(stamp);
        } else {
            self.forget();
        }
        self.led = true;
        let estimate = if self.belief.is_some() {
            self.track(stamp, &points)
        } else {
            self.relocate(stamp, &points)
        };
        Estimate {
            line_points: points.len(),
            ..estimate
        }
    }

    /// Has odometry been reported without a gap from the belief to this frame?
    fn leads_to(&self, stamp: Stamp) -> bool {
        let gap = self.config.mode.gap_max;
        self.led
            && self.belief.is_some()
            && self.odometry.is_some_and(|(last, _)| {
                let since = seconds_between(last, stamp);
                since <= gap && seconds_between(self.reached, stamp) <= gap
            })
    }

    /// Carries the belief on from the last odometry sample to the frame, at the rate last reported.
    fn bridge(&mut self, stamp: Stamp) {
        let seconds = seconds_between(self.reached, stamp);
        if seconds > 0.0 {
            let rate = self.odometry.map_or([0.0; 3], |(_, rate)| rate);
            let part = seconds as f32;
            self.move_belief(stamp, rate.map(|value| value * part), part);
        }
    }

    fn move_belief(&mut self, stamp: Stamp, motion: [f32; 3], seconds: f32) {
        self.reached = stamp;
        if let Some(belief) = &mut self.belief {
            belief.predict(motion, seconds, &self.config.filter);
        }
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
        self.half_evidence = 0.0;
        self.strikes = 0;
    }

    fn track(&mut self, stamp: Stamp, points: &[LinePoint]) -> Estimate {
        let Some(mut belief) = self.belief.take() else {
            return self.relocate(stamp, points);
        };
        if points.len() < self.config.mode.points_min {
            return self.coast(stamp, belief);
        }
        let contradiction = self.half_evidence <= -self.config.compass.known;
        if contradiction && self.search.symmetric() {
            belief = belief.half_turned();
            self.half_evidence = -self.half_evidence;
        }
        let spread = belief.position_std() + 2.0 * belief.heading_std();
        let matched = self
            .matcher
            .refine(&self.distances, points, belief.pose(), spread);
        let mode = self.config.mode.clone();
        let share = matched.inlier_share;
        let disagreement =
            belief.disagreement(matched.pose, &matched.covariance, &self.config.filter);
        let poor = share < mode.inlier_share_min
            || share < mode.usual_share_part * self.usual_share
            || disagreement > mode.disagreement_max;
        let due =
            mode.check_period > 0.0 && seconds_between(self.checked, stamp) >= mode.check_period;
        let mut rivals = Vec::new();
        if poor || due || self.strikes > 0 {
            self.checked = stamp;
            rivals = self.rivals(stamp, points, &matched, belief.pose());
            if let Some(rival) = self.better(&rivals, &matched, points.len()) {
                return self.suspect(stamp, belief, &rival, rivals);
            }
        }
        self.strikes = 0;
        if disagreement > mode.disagreement_max {
            belief.widen(disagreement / mode.disagreement_max);
        }
        belief.correct(matched.pose, &matched.covariance, &self.config.filter);
        // Forgets over about a second of frames.
        self.usual_share += 0.05 * (share - self.usual_share);
        self.belief = Some(belief);
        let reason = if contradiction {
            Some(Reason::CompassContradicts)
        } else {
            poor.then_some(Reason::PoorMatch)
        };
        self.estimate(stamp, reason, Some(&matched), &rivals)
    }

    /// No sight: odometry alone, until it is too uncertain.
    fn coast(&mut self, stamp: Stamp, belief: Belief) -> Estimate {
        let mode = &self.config.mode;
        if belief.position_std() > mode.lost_std
            || belief.heading_std() > mode.lost_std_deg.to_radians()
        {
            self.forget();
            return self.lost(stamp, Reason::Blind, Vec::new());
        }
        self.belief = Some(belief);
        self.estimate(stamp, Some(Reason::FewPoints), None, &[])
    }

    /// The best poses of the whole field that are not the tracked one.
    fn rivals(
        &mut self,
        stamp: Stamp,
        points: &[LinePoint],
        matched: &Match,
        expected: Pose,
    ) -> Vec<Hypothesis> {
        let prior = self.heading_prior(stamp);
        let mut found = self
            .search
            .find(&self.distances, &mut self.matcher, points, prior);
        let config = &self.config.search;
        found.retain(|one| {
            // Where no compass tells the halves apart, the half turn of the tracked pose is no rival.
            let twin = crate::search::half_turn(one.pose);
            let own = |pose: Pose| {
                pose.origin().distance_to(matched.pose.origin()) < config.distinct
                    && wrap_angle(pose.theta - matched.pose.theta).abs()
                        < config.distinct_deg.to_radians()
            };
            let other_half = prior.is_none()
                && wrap_angle(one.pose.theta - expected.theta).abs() > std::f32::consts::FRAC_PI_2;
            !(own(one.pose)
                || self.search.symmetric() && prior.is_none() && own(twin)
                || other_half)
        });
        found
    }

    /// The rival that explains clearly more than the tracked pose does.
    fn better(&self, rivals: &[Hypothesis], matched: &Match, count: usize) -> Option<Hypothesis> {
        let mode = &self.config.mode;
        rivals
            .iter()
            .max_by(|a, b| a.score.total_cmp(&b.score))
            .filter(|rival| {
                rival.score > matched.score + mode.rival_share
                    && rival.inlier_share * count as f32 >= mode.inliers_min
                    && rival.inlier_share >= mode.found_share_min
            })
            .cloned()
    }

    /// The tracked pose is worse than another: five such frames and it is given up.
    fn suspect(
        &mut self,
        stamp: Stamp,
        belief: Belief,
        rival: &Hypothesis,
        rivals: Vec<Hypothesis>,
    ) -> Estimate {
        self.strikes += 1;
        if self.strikes < self.config.mode.strikes_max {
            self.belief = Some(belief);
            let estimate = self.estimate(stamp, Some(Reason::Rival), None, &rivals);
            let apart = apart(rival.pose, estimate.pose.unwrap_or(rival.pose));
            return Estimate {
                // As likely there as here, until one of them has won.
                covariance: estimate.covariance + apart * apart.transpose() * 0.5,
                ..estimate
            };
        }
        self.forget();
        self.lost(stamp, Reason::Rival, rivals)
    }

    fn heading_prior(&self, stamp: Stamp) -> Option<HeadingPrior> {
        let compass = self.compass?;
        let age = seconds_between(compass.stamp, stamp).abs();
        (age <= self.config.compass.age_max).then(|| HeadingPrior {
            heading: compass.heading,
            std: self.config.compass.std_deg.to_radians(),
        })
    }

    /// Looks for the pose on the whole field.
    fn relocate(&mut self, stamp: Stamp, points: &[LinePoint]) -> Estimate {
        let mode = &self.config.mode;
        if points.len() < mode.points_min {
            return self.lost(stamp, Reason::FewPoints, Vec::new());
        }
        let prior = self.heading_prior(stamp);
        let found = self
            .search
            .find(&self.distances, &mut self.matcher, points, prior);
        let count = points.len() as f32;
        let Some(best) = found.first().filter(|best| {
            best.inlier_share >= mode.found_share_min
                && best.inlier_share * count >= mode.inliers_min
        }) else {
            return self.lost(stamp, Reason::NothingFits, found);
        };
        let best = best.clone();
        // On a symmetric field without a compass every pose shares its probability with its half turn.
        let folded = prior.is_none() && self.search.symmetric();
        let probability = best.probability * if folded { 2.0 } else { 1.0 };
        let covariance = mixture(&found);
        let mut estimate = Estimate {
            stamp,
            pose: Some(best.pose),
            covariance,
            mode: Mode::Global,
            reason: (folded || probability < mode.decided).then_some(Reason::Ambiguous),
            residual: best.residual,
            inlier_share: best.inlier_share,
            line_points: points.len(),
            lean: best.lean,
            half_known: !folded,
            odometry_scales: [1.0, 1.0],
            runners_up: found.into_iter().skip(1).collect(),
        };
        if probability >= mode.decided {
            self.adopt(stamp, best.pose, &best.covariance);
            self.half_evidence = if folded {
                0.0
            } else {
                self.config.compass.known
            };
            self.usual_share = best.inlier_share;
        } else {
            estimate.half_known = false;
        }
        estimate
    }

    fn adopt(&mut self, stamp: Stamp, pose: Pose, covariance: &Matrix3<f32>) {
        self.belief = Some(Belief::new(pose, covariance, None, &self.config.filter));
        self.reached = stamp;
        self.checked = stamp;
        self.strikes = 0;
    }

    fn half_known(&self) -> bool {
        !self.search.symmetric() || self.half_evidence >= self.config.compass.known
    }

    fn estimate(
        &self,
        stamp: Stamp,
        reason: Option<Reason>,
        matched: Option<&Match>,
        rivals: &[Hypothesis],
    ) -> Estimate {
        let Some(belief) = &self.belief else {
            return self.lost(stamp, reason.unwrap_or(Reason::Blind), Vec::new());
        };
        let half_known = self.half_known();
        Estimate {
            stamp,
            pose: Some(belief.pose()),
            covariance: belief.covariance(),
            mode: if half_known {
                Mode::Tracking
            } else {
                Mode::Global
            },
            reason: reason.or((!half_known).then_some(Reason::Ambiguous)),
            residual: matched.map_or(0.0, |matched| matched.residual),
            inlier_share: matched.map_or(0.0, |matched| matched.inlier_share),
            line_points: 0,
            lean: matched.map_or([0.0; 2], |matched| matched.lean),
            half_known,
            odometry_scales: belief.scales(),
            runners_up: rivals.to_vec(),
        }
    }

    fn lost(&self, stamp: Stamp, reason: Reason, runners_up: Vec<Hypothesis>) -> Estimate {
        Estimate {
            stamp,
            pose: None,
            covariance: self.anywhere,
            mode: Mode::Lost,
            reason: Some(reason),
            residual: 0.0,
            inlier_share: runners_up.first().map_or(0.0, |best| best.inlier_share),
            line_points: 0,
            lean: [0.0; 2],
            half_known: false,
            odometry_scales: [1.0, 1.0],
            runners_up,
        }
    }
}

/// Log odds of one compass reading for the half in which the heading deviates by `deviation` from it.
fn half_evidence(deviation: f32, config: &crate::config::CompassConfig) -> f32 {
    let std = config.std_deg.to_radians();
    let other = std::f32::consts::PI - deviation.abs();
    (0.5 * (other * other - deviation * deviation) / (std * std))
        .clamp(-config.reading_max, config.reading_max)
}

/// Covariance about the best hypothesis with all others at their probabilities.
fn mixture(found: &[Hypothesis]) -> Matrix3<f32> {
    let Some(best) = found.first() else {
        return Matrix3::zeros();
    };
    found.iter().fold(Matrix3::zeros(), |sum, one| {
        let apart = apart(one.pose, best.pose);
        sum + (one.covariance + apart * apart.transpose()) * one.probability
    })
}

fn apart(a: Pose, b: Pose) -> Vector3<f32> {
    Vector3::new(a.x - b.x, a.y - b.y, wrap_angle(a.theta - b.theta))
}

fn seconds_between(earlier: Stamp, later: Stamp) -> f64 {
    later - earlier
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
