//! How well does a set-up explain its keyframes? Shares of points, wheel steps and compass readings, and the cost.

use crate::config::LocalizeConfig;
use crate::frames::{Pose, RobotFrame, Tf, wrap_angle};
use crate::map_correction::{DriveFit, MapBasis};
use crate::twist::METRES_PER_RADIAN;
use crate::wheel_steps::{DerivedStep, MatrixDerivatives, MeasuredStep, WheelsFit};

use super::chain::{KeyframeHypotheses, SelectedHypothesis, select_chain};
use super::keyframe::Keyframe;
use super::led_by_wheels::select_led_chain;
use super::tables::FieldTables;

/// Shorter steps are noise, metres.
const STEP_MIN: f32 = 0.1;

/// How well one keyframe is explained.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct KeyframeFit {
    /// Selected pose. None without hypotheses.
    pub pose: Option<Pose>,
    /// Negative log likelihood of points, wheels and compass.
    pub cost: f32,
    /// Number of line points.
    pub points: usize,
    /// Share of the points on markings.
    pub on_markings: f32,
    /// Root mean square distance of these points, metres.
    pub residual: f32,
    /// Motion since the previous keyframe by the wheels. None without wheels or without both poses.
    pub wheel_step: Option<Tf<RobotFrame, RobotFrame>>,
    /// Its derivatives by the matrix of the wheels.
    pub by_matrix: Option<MatrixDerivatives>,
    /// Do the wheels agree with the motion since the previous keyframe?
    pub wheels_agree: Option<bool>,
    /// Does the compass agree with the heading?
    pub compass_agrees: Option<bool>,
}

/// How well a set-up explains its keyframes.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Explanation {
    /// One per keyframe.
    pub keyframes: Vec<KeyframeFit>,
}

impl FieldTables {
    /// The errors of a map with which its keyframes lie on the markings, from the poses of an explanation without them.
    pub fn fit_map(
        &self,
        basis: &MapBasis,
        config: &LocalizeConfig,
        keyframes: &[Keyframe],
        explanation: &Explanation,
    ) -> Option<DriveFit> {
        let pairs = keyframes.iter().zip(&explanation.keyframes);
        let images = pairs.filter_map(|(keyframe, fit)| Some((fit.pose?, &keyframe.points[..])));
        let images: Vec<_> = images.collect();
        DriveFit::find(
            basis,
            &config.map_correction,
            &images,
            &self.distances,
            &config.matching,
        )
    }
}

/// Searches every keyframe and selects the cheapest chain.
pub fn explain(tables: &mut FieldTables, keyframes: &[Keyframe]) -> Explanation {
    let mut hypotheses: Vec<KeyframeHypotheses> = keyframes
        .iter()
        .map(|keyframe| tables.hypotheses(keyframe))
        .collect();
    let links = select_led_chain(tables, keyframes, &mut hypotheses);
    explain_by(keyframes, &hypotheses, &links)
}

/// As [`explain`], but refines known poses in place of a search: for changes of some centimetres.
pub fn refine(
    tables: &mut FieldTables,
    keyframes: &[Keyframe],
    start: &Explanation,
) -> Explanation {
    let pairs = keyframes.iter().zip(&start.keyframes);
    let refined = pairs.map(|(keyframe, fit)| KeyframeHypotheses {
        hypotheses: fit
            .pose
            .map(|pose| tables.hypothesis_near(keyframe, pose))
            .into_iter()
            .collect(),
    });
    let refined: Vec<KeyframeHypotheses> = refined.collect();
    explain_by(keyframes, &refined, &select_chain(keyframes, &refined))
}

/// Cost of a chain through the hypotheses.
fn explain_by(
    keyframes: &[Keyframe],
    hypotheses: &[KeyframeHypotheses],
    links: &[SelectedHypothesis],
) -> Explanation {
    let fits = keyframes.iter().zip(hypotheses).zip(links);
    let keyframes = fits.map(|((keyframe, own), link)| {
        let selected = link.hypothesis.map(|index| &own.hypotheses[index]);
        let half = |squared: Option<f32>| 0.5 * squared.unwrap_or(0.0);
        let motion = link.wheels.and(keyframe.motion);
        KeyframeFit {
            pose: selected.map(|(_, hypothesis)| hypothesis.pose),
            cost: selected.map_or(0.0, |(cost, _)| *cost) + half(link.wheels) + half(link.compass),
            points: keyframe.points.len(),
            on_markings: selected.map_or(0.0, |(_, hypothesis)| hypothesis.inlier_share),
            residual: selected.map_or(0.0, |(_, hypothesis)| hypothesis.inlier_rms),
            wheel_step: motion.map(|motion| motion.step),
            by_matrix: motion.map(|motion| motion.by_matrix),
            wheels_agree: link.wheels_agree(),
            compass_agrees: link.compass_agrees(),
        }
    });
    Explanation {
        keyframes: keyframes.collect(),
    }
}

impl Explanation {
    /// Negative log likelihood of all keyframes.
    pub fn cost(&self) -> f32 {
        self.keyframes.iter().map(|fit| fit.cost).sum()
    }

    /// Share of all points on markings.
    pub fn on_markings(&self) -> f32 {
        self.mean_over_points(|fit| fit.on_markings)
    }

    /// Root mean square distance of the points on markings, metres.
    pub fn residual(&self) -> f32 {
        self.mean_over_points(|fit| fit.residual * fit.residual)
            .sqrt()
    }

    fn mean_over_points(&self, value: impl Fn(&KeyframeFit) -> f32) -> f32 {
        let (mut sum, mut points) = (0.0, 0.0);
        for fit in &self.keyframes {
            sum += fit.points as f32 * value(fit);
            points += fit.points as f32;
        }
        sum / f32::max(points, 1.0)
    }

    /// The steps between successive keyframes, by wheels and by poses.
    pub fn steps(&self) -> Vec<MeasuredStep> {
        let pairs = self.keyframes.iter().zip(self.keyframes.iter().skip(1));
        let steps = pairs.filter_map(|(before, after)| measured_step(before, after));
        steps.collect()
    }

    /// Turn and origin of the poses by these steps, beside wheels of any radii. None for too few steps that agree.
    pub fn wheels_fit(&self) -> Option<WheelsFit> {
        let pairs = self.keyframes.iter().zip(self.keyframes.iter().skip(1));
        let steps = pairs.filter_map(|(before, after)| {
            Some(DerivedStep {
                step: measured_step(before, after)?,
                by_matrix: after.by_matrix?,
            })
        });
        WheelsFit::fit(&steps.collect::<Vec<_>>())
    }

    /// How far the wheels agree with the poses: the share of the steps that do not contradict, but at most the mean
    /// agreement of direction, length and turn (1 equal, 0 unrelated). None without wheels.
    pub fn wheels_agree(&self) -> Option<f32> {
        let share = share(self.keyframes.iter().filter_map(|fit| fit.wheels_agree))?;
        let (mut sum, mut count) = (0.0_f32, 0.0_f32);
        for MeasuredStep { wheels, poses } in self.steps() {
            let size = |x: f32, y: f32, turn: f32| {
                x * x + y * y + (METRES_PER_RADIAN * wrap_angle(turn)).powi(2)
            };
            let by_wheels = size(wheels.x, wheels.y, wheels.theta);
            let by_poses = size(poses.x, poses.y, poses.theta);
            if by_wheels.max(by_poses) > STEP_MIN * STEP_MIN {
                let error = size(
                    wheels.x - poses.x,
                    wheels.y - poses.y,
                    wheels.theta - poses.theta,
                );
                sum += 1.0 - error / (by_wheels + by_poses);
                count += 1.0;
            }
        }
        let agreement = if count > 0.0 { sum / count } else { 1.0 };
        Some(share.min(agreement.max(0.0)))
    }

    /// Share of the compass readings that agree. None without a compass.
    pub fn compass_agrees(&self) -> Option<f32> {
        share(self.keyframes.iter().filter_map(|fit| fit.compass_agrees))
    }

    /// Share of the measurements that are explained: of the points, of the wheel steps, of the compass readings,
    /// multiplied.
    pub fn fit(&self) -> f32 {
        self.on_markings()
            * self.wheels_agree().unwrap_or(1.0)
            * self.compass_agrees().unwrap_or(1.0)
    }
}

fn measured_step(before: &KeyframeFit, after: &KeyframeFit) -> Option<MeasuredStep> {
    Some(MeasuredStep {
        wheels: after.wheel_step?,
        poses: before.pose?.inverse() * after.pose?,
    })
}

fn share(values: impl Iterator<Item = bool>) -> Option<f32> {
    let (mut agreeing, mut count) = (0, 0);
    for value in values {
        agreeing += usize::from(value);
        count += 1;
    }
    (count > 0).then(|| agreeing as f32 / count as f32)
}
