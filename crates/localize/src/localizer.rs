//! Where is the robot now, and does it know? Tracking while the sights agree, suspicion when they do not, a search of
//! the whole field when there is no pose, and several hypotheses while nothing has decided between them.
//!
//! Track → suspect → lost → relocalise follows nubot2013 4 (five cycles), with more evidence than its two thresholds:
//! share of inliers, deviation from the prediction, the best pose of the whole field, the compass.

use nalgebra::{Matrix3, Vector3};

use crate::candidates::{Candidates, Evidence, apart};
use crate::config::{CompassConfig, LocalizeConfig, SuspectRule, Tracker};
use crate::distance::DistanceField;
use crate::estimate::{Estimate, Mode, Reason};
use crate::field::Field;
use crate::filter::Belief;
use crate::frame::{Pose, wrap_angle};
use crate::heading::heading_by_histogram;
use crate::matching::{Match, Matcher};
use crate::relocalise::scan_map::ScanMap;
use crate::relocalise::{Relocaliser, Sight};
use crate::sample::{Compass, LinePoint, Odometry};
use crate::search::{HeadingPrior, Hypothesis, Search};
use crate::stamp::Stamp;

/// Follows one robot over one field.
#[derive(Debug, Clone)]
pub struct Localizer {
    config: LocalizeConfig,
    distances: DistanceField,
    search: Search,
    relocaliser: Relocaliser,
    /// For the tracker that needs it.
    scan_map: Option<Box<ScanMap>>,
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
    /// Log odds that the belief's half is right rather than the other one.
    half_evidence: f32,
    /// A pose that explains the points better than the belief, and in how many frames it did.
    rival: Option<(Belief, u32)>,
    /// Hypotheses that nothing has decided between yet; none while there is a belief.
    candidates: Candidates,
    /// Suspect frames in a row, by the rule of thresholds.
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
        let relocaliser = Relocaliser::new(field, &distances, &config.relocalise);
        let scan_map = (config.tracker == Tracker::ScanMap).then(|| match &relocaliser {
            Relocaliser::ScanMap(map, _) => map.clone(),
            _ => {
                let config = config.relocalise.scan_map.clone();
                Box::new(ScanMap::new(field, &distances, config))
            }
        });
        let (half_x, half_y) = field.carpet_half_extent();
        let turn = std::f32::consts::PI * std::f32::consts::PI / 3.0;
        Localizer {
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
            half_evidence: 0.0,
            rival: None,
            candidates: Candidates::default(),
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
        self.half_evidence = self.config.compass.evidence_max;
        self.reached = stamp;
        self.checked = stamp;
        self.led = true;
    }

    /// Moves the expected pose. Samples come in the order of their stamps, before the frame of the same stamp.
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
                self.move_on(sample.stamp, motion, seconds as f32);
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
            self.move_on(sample.stamp, motion.map(|value| value * part), left as f32);
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
            let deviation = wrap_angle(belief.pose().theta - sample.heading);
            self.half_evidence = (self.half_evidence + half_evidence(deviation, config))
                .clamp(-config.evidence_max, config.evidence_max);
        }
    }

    /// Takes a frame's line points to a pose. Points that are not finite are left out.
    pub fn see(&mut self, stamp: Stamp, points: &[LinePoint]) -> Estimate {
        let points: Vec<LinePoint> = points.iter().filter(|point| sane(point)).copied().collect();
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
        Estimate {
            line_points: points.len(),
            ..estimate
        }
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
            self.move_on(stamp, rate.map(|value| value * seconds), seconds);
        }
    }

    fn move_on(&mut self, stamp: Stamp, motion: [f32; 3], seconds: f32) {
        self.reached = stamp;
        let config = &self.config.filter;
        let belief = self.belief.iter_mut();
        let rival = self.rival.iter_mut().map(|(belief, _)| belief);
        for one in belief.chain(rival).chain(self.candidates.beliefs()) {
            one.predict(motion, seconds, config);
        }
        self.relocaliser.moved(motion);
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
        self.half_evidence = 0.0;
        self.rival = None;
        self.strikes = 0;
    }

    fn track(&mut self, stamp: Stamp, points: &[LinePoint]) -> Estimate {
        let Some(mut belief) = self.belief.take() else {
            return self.relocate(stamp, points);
        };
        if points.len() < self.config.mode.points_min {
            return self.coast(stamp, belief);
        }
        let contradicted =
            self.search.symmetric() && self.half_evidence <= -self.config.compass.known;
        if contradicted {
            belief = belief.half_turned();
            self.half_evidence = -self.half_evidence;
        }
        if self.config.tracker == Tracker::ScanMap {
            return self.track_by_scan_map(stamp, belief, points);
        }
        let (matched, strained) = self.fuse(&mut belief, points);
        if self.config.mode.rule == SuspectRule::Thresholds {
            belief.absorb(matched.pose, &matched.covariance, &self.config.filter);
            return self.judge(stamp, belief, &matched);
        }
        let mode = &self.config.mode;
        let share = matched.inlier_share;
        let poor = strained || self.poor(share);
        let due = mode.check_period > 0.0 && self.checked.seconds_until(stamp) >= mode.check_period;
        let mut rivals = Vec::new();
        if poor || due || self.rival.is_some() {
            self.checked = stamp;
            rivals = self.rivals(stamp, points, &matched);
            if let Some(rival) = self.better(&rivals, &matched, points.len()) {
                return self.suspect(stamp, belief, &rival, rivals);
            }
        }
        self.rival = None;
        belief.absorb(matched.pose, &matched.covariance, &self.config.filter);
        // Forgets over about a second of frames.
        self.usual_share += 0.05 * (share - self.usual_share);
        self.belief = Some(belief);
        let reason = if contradicted {
            Some(Reason::CompassContradicts)
        } else {
            poor.then_some(Reason::PoorMatch)
        };
        self.estimate(stamp, reason, Some(&matched), rivals)
    }

    /// minho2016 IV and V.B: heading by histograms about the expected one, then the best cell of the local search.
    fn track_by_scan_map(
        &mut self,
        stamp: Stamp,
        mut belief: Belief,
        points: &[LinePoint],
    ) -> Estimate {
        let expected = belief.pose();
        let heading = heading_by_histogram(points, expected.theta, &self.config.relocalise.heading);
        let centre = Pose::new(expected.x, expected.y, heading.unwrap_or(expected.theta));
        let found = self
            .scan_map
            .as_ref()
            .and_then(|map| map.find_near(points, centre));
        if let Some((_, pose)) = found {
            // A cell, and about half a step of the histograms.
            let cell = self.config.relocalise.scan_map.cell;
            let turn = self.config.relocalise.heading.step_deg.to_radians();
            let variances = Vector3::new(cell * cell, cell * cell, turn * turn);
            let sight = Matrix3::from_diagonal(&variances);
            belief.correct(pose, &sight, &self.config.filter);
        }
        let matched = self.matcher.assess(&self.distances, points, belief.pose());
        self.judge(stamp, belief, &matched)
    }

    /// nubot2013 4: a possible error is a mean deviation above a threshold and a heading off the compass by another;
    /// five such cycles in a row, and localisation starts anew.
    fn judge(&mut self, stamp: Stamp, belief: Belief, matched: &Match) -> Estimate {
        let mode = &self.config.mode;
        let deviates = matched.deviation > mode.deviation_max;
        let turned = self.heading_prior(stamp).is_none_or(|prior| {
            wrap_angle(belief.pose().theta - prior.heading).abs()
                > mode.compass_max_deg.to_radians()
        });
        self.strikes = if deviates && turned {
            self.strikes + 1
        } else {
            0
        };
        if self.strikes >= mode.strikes_max {
            self.forget();
            return self.lost(stamp, Reason::PoorMatch, Vec::new());
        }
        self.belief = Some(belief);
        let reason = (self.strikes > 0).then_some(Reason::PoorMatch);
        self.estimate(stamp, reason, Some(matched), Vec::new())
    }

    /// Matches under the belief's expectation. Where the points pull too hard against it, or lie on the markings only
    /// when it is let go, something unreported moved the robot: the expectation is widened. Says whether that was so.
    fn fuse(&mut self, belief: &mut Belief, points: &[LinePoint]) -> (Match, bool) {
        let spread = belief.position_std() + 3.0 * belief.heading_std();
        let expected = belief.expected();
        let matched = self.matcher.fuse(&self.distances, points, expected, spread);
        let mode = &self.config.mode;
        let surprise = belief.surprise(&matched);
        if surprise <= mode.surprise_max && !self.poor(matched.inlier_share) {
            return (matched, false);
        }
        let free = self
            .matcher
            .refine(&self.distances, points, belief.pose(), mode.push_max);
        let count = points.len() as f32;
        let margin = (mode.rival_share * count).max(mode.rival_points);
        let apart = apart(free.pose, belief.pose());
        if (free.score - matched.score) * count > margin
            && apart[0].hypot(apart[1]) < 2.0 * mode.push_max
        {
            belief.widen(apart.dot(&(expected.information * apart)));
            return (free, true);
        }
        if surprise <= mode.surprise_max {
            return (matched, false);
        }
        belief.widen(surprise);
        let expected = belief.expected();
        let again = self.matcher.fuse(&self.distances, points, expected, spread);
        (again, true)
    }

    /// Do fewer points lie on the markings than should, or than usually do?
    fn poor(&self, inlier_share: f32) -> bool {
        let mode = &self.config.mode;
        inlier_share < mode.inlier_share_min
            || inlier_share < mode.usual_share_part * self.usual_share
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
        self.estimate(stamp, Some(Reason::FewPoints), None, Vec::new())
    }

    /// The best poses of the whole field that are not the tracked one.
    fn rivals(&mut self, stamp: Stamp, points: &[LinePoint], matched: &Match) -> Vec<Hypothesis> {
        let prior = self.heading_prior(stamp);
        let mut found = self
            .search
            .find(&self.distances, &mut self.matcher, points, prior);
        // Without a compass the half turn of a pose explains as much: it is no rival, nor a reason to turn.
        let folded = prior.is_none() && self.search.symmetric();
        found.retain(|one| {
            let turned = wrap_angle(one.pose.theta - matched.pose.theta).abs();
            !(self.search.same(one.pose, matched.pose)
                || folded && turned > std::f32::consts::FRAC_PI_2)
        });
        found
    }

    /// The rival that explains clearly more points than the tracked pose does.
    fn better(&self, rivals: &[Hypothesis], matched: &Match, count: usize) -> Option<Hypothesis> {
        let mode = &self.config.mode;
        let count = count as f32;
        let margin = (mode.rival_share * count).max(mode.rival_points);
        rivals
            .iter()
            .max_by(|a, b| a.score.total_cmp(&b.score))
            .filter(|rival| {
                (rival.score - matched.score) * count > margin
                    && rival.inlier_share * count >= mode.inliers_min
                    && rival.inlier_share >= mode.found_share_min
            })
            .cloned()
    }

    /// Another pose is better: when it was the same one in five frames, odometry between them included, the tracked
    /// one is given up.
    fn suspect(
        &mut self,
        stamp: Stamp,
        belief: Belief,
        rival: &Hypothesis,
        rivals: Vec<Hypothesis>,
    ) -> Estimate {
        let config = &self.config.filter;
        let fresh = Belief::new(rival.pose, &rival.covariance, Some(&belief), config);
        let strikes = match self.rival.take() {
            Some((known, strikes)) if self.search.same(known.pose(), rival.pose) => strikes + 1,
            _ => 1,
        };
        if strikes >= self.config.mode.strikes_max {
            self.forget();
            return self.lost(stamp, Reason::Rival, rivals);
        }
        self.rival = Some((fresh, strikes));
        self.belief = Some(belief);
        let estimate = self.estimate(stamp, Some(Reason::Rival), None, rivals);
        let apart = estimate
            .pose
            .map_or_else(Vector3::zeros, |pose| apart(rival.pose, pose));
        Estimate {
            // As likely there as here, until one of them has won.
            covariance: estimate.covariance + apart * apart.transpose() * 0.5,
            ..estimate
        }
    }

    /// The heading by a compass reading that is young enough for this frame.
    fn heading_prior(&self, stamp: Stamp) -> Option<HeadingPrior> {
        let compass = self.compass?;
        let age = compass.stamp.seconds_until(stamp).abs();
        (age <= self.config.compass.age_max).then(|| HeadingPrior {
            heading: compass.heading,
            std: self.config.compass.std_deg.to_radians(),
        })
    }

    /// Looks for the pose on the whole field, together with the hypotheses that earlier frames left.
    fn relocate(&mut self, stamp: Stamp, points: &[LinePoint]) -> Estimate {
        let mode = &self.config.mode;
        if points.len() < mode.points_min {
            return self.lost(stamp, Reason::FewPoints, Vec::new());
        }
        let prior = self.heading_prior(stamp);
        let sight = Sight {
            distances: &self.distances,
            points,
            prior,
            alone: self.odometry.is_none(),
        };
        let found = self
            .relocaliser
            .find(&mut self.search, &mut self.matcher, &sight);
        if found.is_empty() && self.relocaliser.active() {
            return self.lost(stamp, Reason::Searching, found);
        }
        let folded = prior.is_none() && self.search.symmetric();
        let count = points.len() as f32;
        let fits = found.first().is_some_and(|best| {
            best.inlier_share >= mode.found_share_min
                && best.inlier_share * count >= mode.inliers_min
        });
        if !fits {
            self.candidates.clear();
            self.relocaliser.restart();
            return self.lost(stamp, Reason::NothingFits, found);
        }
        let used = self.config.search.points_max as f32;
        let evidence = Evidence {
            distances: &self.distances,
            points,
            prior,
            folded,
            share: self.config.search.evidence_share * (used / count).min(1.0),
        };
        self.candidates.weigh(
            &mut self.matcher,
            &self.search,
            &evidence,
            &found,
            &self.config.filter,
        );
        let Some((belief, best)) = self.candidates.best() else {
            return self.lost(stamp, Reason::NothingFits, found);
        };
        let decided = best.probability >= mode.decided;
        let estimate = Estimate {
            stamp,
            pose: Some(belief.pose()),
            covariance: self.candidates.covariance(),
            mode: Mode::Global,
            reason: (folded || !decided).then_some(Reason::Ambiguous),
            residual: best.residual,
            inlier_share: best.inlier_share,
            line_points: points.len(),
            lean: best.lean,
            half_known: decided && !folded,
            odometry_scales: belief.scales(),
            runners_up: self.candidates.runners_up(folded),
        };
        if decided {
            self.belief = Some(belief.clone());
            self.candidates.clear();
            self.relocaliser.restart();
            self.half_evidence = if folded {
                0.0
            } else {
                self.config.compass.known
            };
            self.usual_share = estimate.inlier_share;
            self.checked = stamp;
            self.rival = None;
        }
        estimate
    }

    fn half_known(&self) -> bool {
        !self.search.symmetric() || self.half_evidence >= self.config.compass.known
    }

    /// The half turn of the belief, which explains the points as well.
    fn other_half(&self, belief: &Belief, matched: Option<&Match>) -> Hypothesis {
        let other = belief.half_turned();
        // The compass's log odds; none heard is as likely as not.
        let probability = 1.0 / (1.0 + self.half_evidence.exp());
        Hypothesis {
            pose: other.pose(),
            covariance: other.covariance(),
            score: matched.map_or(0.0, |matched| matched.score),
            inlier_share: matched.map_or(0.0, |matched| matched.inlier_share),
            residual: matched.map_or(0.0, |matched| matched.residual),
            lean: matched.map_or([0.0; 2], |matched| matched.lean),
            probability,
        }
    }

    /// What the belief says, with what the frame's points made of it.
    fn estimate(
        &self,
        stamp: Stamp,
        reason: Option<Reason>,
        matched: Option<&Match>,
        rivals: Vec<Hypothesis>,
    ) -> Estimate {
        let Some(belief) = &self.belief else {
            return self.lost(stamp, reason.unwrap_or(Reason::Blind), rivals);
        };
        let half_known = self.half_known();
        let mut runners_up = rivals;
        if !half_known {
            runners_up.insert(0, self.other_half(belief, matched));
        }
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
            runners_up,
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
fn half_evidence(deviation: f32, config: &CompassConfig) -> f32 {
    let std = config.std_deg.to_radians();
    let other = std::f32::consts::PI - deviation.abs();
    (0.5 * (other * other - deviation * deviation) / (std * std))
        .clamp(-config.reading_max, config.reading_max)
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
