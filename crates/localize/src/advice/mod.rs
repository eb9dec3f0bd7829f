//! Which motion would show whether the pose is this one or that one? Advice for an ambiguous pose.
//!
//! Two hypotheses differ by one rigid motion of the field, whatever the robot does. A marking point that this motion takes
//! to another marking tells nothing. The advice is the shortest motion that brings enough of the other points into view
//! (docs/methods.md 6.10).

mod config;
mod disagreement;
mod motions;
mod view;
mod weights;

use crate::field::Field;
use crate::frames::Pose;
use crate::matching::distance_field::DistanceField;
use crate::sample::LinePoint;

pub use config::AdviceConfig;
use disagreement::{MarkingSample, Residual, sample_markings};
use motions::{Motion, candidate_motions};
use view::View;
pub use weights::PointWeights;

/// What would tell the hypotheses apart.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Advice {
    /// A motion of the robot.
    Move(MotionAdvice),
    /// No motion tells a pose from its half turn: a compass, coloured goals or a team-mate does.
    ObserveHalf,
}

/// A motion in the robot frame, and what it is expected to tell.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct MotionAdvice {
    /// Displacement (forward, left), metres, and rotation counter-clockwise, radians.
    pub motion: [f32; 3],
    /// Log odds between the two hypotheses that one image after the motion is expected to yield by markings not in view so
    /// far. Mean over either being true.
    pub expected_log_odds: f32,
}

impl Advice {
    /// As a phrase for people.
    pub fn text(&self) -> String {
        let Advice::Move(MotionAdvice {
            motion: [x, y, turn],
            ..
        }) = *self
        else {
            return "half turn: needs compass, goal colour or team-mate".to_owned();
        };
        let distance = crate::math::hypot(x, y);
        if distance < 1e-3 {
            return format!("turn by {:.0}°", turn.to_degrees());
        }
        let direction = crate::math::atan2(y, x).to_degrees().round();
        let along = match direction as i32 {
            0 => "along x".to_owned(),
            180 | -180 => "along −x".to_owned(),
            90 => "along y".to_owned(),
            -90 => "along −y".to_owned(),
            degrees => format!("at {degrees}°"),
        };
        format!("drive {distance:.2} m {along}")
    }
}

/// Which pieces of the field's markings a hypothesis has had in view: what they tell is known already.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct CheckedMarkings(Vec<bool>);

/// A hypothesis with what it has had in view.
#[derive(Debug, Clone, Copy)]
pub struct Considered<'a> {
    /// Its pose.
    pub pose: Pose,
    /// The markings in view so far, under this hypothesis.
    pub checked: &'a CheckedMarkings,
}

/// Finds motions that tell hypotheses apart, for one field.
#[derive(Debug, Clone)]
pub struct Advisor {
    config: AdviceConfig,
    samples: Vec<MarkingSample>,
    motions: Vec<Motion>,
    /// Half the carpet's extent, metres.
    half_extent: [f32; 2],
}

impl Advisor {
    /// Samples the field's markings.
    pub fn new(field: &Field, config: AdviceConfig) -> Self {
        let (half_x, half_y) = field.carpet_half_extent();
        Advisor {
            samples: sample_markings(&field.markings),
            motions: candidate_motions(&config),
            half_extent: [half_x, half_y],
            config,
        }
    }

    /// Adds the markings that the present image (points in the robot frame) has in view at a hypothesis's pose.
    pub fn mark_checked(&self, checked: &mut CheckedMarkings, pose: Pose, points: &[LinePoint]) {
        checked.0.resize(self.samples.len(), false);
        let range = view::observed_range(points, &self.config);
        for (sample, checked) in self.samples.iter().zip(&mut checked.0) {
            *checked |= sample.at.distance_to(pose.origin()) <= range;
        }
    }

    /// The quickest motion that tells `best` from `rival` by markings that they have not had in view, given the points of
    /// the present image (robot frame).
    ///
    /// None if no motion within reach does, or if the image has no points. `direction`: of the displacement advised last,
    /// radians in the robot frame. Others must be quicker by half, so that the robot does not turn back at each image.
    pub fn advise(
        &self,
        distances: &DistanceField,
        points: &[LinePoint],
        hypotheses: [Considered; 2],
        weights: &PointWeights,
        direction: Option<f32>,
    ) -> Option<MotionAdvice> {
        let [best, rival] = hypotheses.map(|hypothesis| hypothesis.pose);
        let view = View::from_image(points, &self.samples, [best, rival], &self.config)?;
        let residual = Residual::new(points, weights);
        // Either may be true, and a marking that is missing is no evidence: what one image tells on average.
        let sides = [(hypotheses[0], rival), (hypotheses[1], best)].map(|(side, other)| {
            let truth = side.pose;
            (
                truth,
                disagreement::disagreeing_samples(
                    &self.samples,
                    &side.checked.0,
                    distances,
                    // Where the other hypothesis expects what the robot sees at this place of the field.
                    other * truth.inverse(),
                    &residual,
                ),
            )
        });
        let log_odds_after = |motion: &Motion| {
            let expected = |(truth, samples): &(Pose, Vec<disagreement::DisagreeingSample>)| {
                view.expected_cost(samples, *truth * motion.transform)
            };
            weights.likelihood_exponent * 0.5 * sides.iter().map(expected).sum::<f32>()
        };
        let mut motions: Vec<(f32, &Motion)> = self
            .motions
            .iter()
            .map(|motion| (motion.seconds * motion.reluctance(direction), motion))
            .collect();
        motions.sort_by(|a, b| a.0.total_cmp(&b.0));
        let mut found: Option<(f32, &Motion, f32)> = None;
        for (effort, motion) in motions {
            if found
                .is_some_and(|(least, _, gain)| gain >= weights.deciding_log_odds && effort > least)
            {
                break;
            }
            if ![best, rival]
                .iter()
                .all(|&pose| self.is_on_carpet(pose * motion.transform))
            {
                continue;
            }
            let gain = log_odds_after(motion);
            if gain >= self.config.log_odds_min && found.is_none_or(|(.., most)| gain > most) {
                found = Some((effort, motion, gain));
            }
        }
        found.map(|(_, motion, gain)| MotionAdvice {
            motion: [motion.transform.x, motion.transform.y, motion.turn()],
            expected_log_odds: gain,
        })
    }

    /// Does the robot stay on the carpet?
    fn is_on_carpet(&self, pose: Pose) -> bool {
        let [half_x, half_y] = self
            .half_extent
            .map(|half| half - self.config.edge_distance);
        pose.x.abs() <= half_x && pose.y.abs() <= half_y
    }
}

#[cfg(test)]
mod tests;
