//! Small networks for each kind of object, trained by `py/training/train_objects.py` (docs/methods.md 4.9).
//!
//! A coarse network ranks the many places that the candidate search leaves. A small convolution network screens the best of
//! them by their pixels, and a larger one judges those that may be an object. Plain loops of fixed size let the compiler use
//! vector instructions, and sums run in one order, so results are the same on every run.

use std::sync::LazyLock;

use localize::math;

use crate::objects::coarse_network::CoarseNetwork;
use crate::objects::network_layers::Weights;
use crate::objects::patch::{CHANNELS, SAMPLES};
use crate::objects::patch_network::PatchNetwork;

/// Weights as little-endian float32: for the ball and for obstacles each coarse network, screen and judge.
static WEIGHTS: &[u8] = include_bytes!("objects.weights");

/// The trained networks.
pub(crate) struct ObjectNetworks {
    pub(crate) ball_coarse: CoarseNetwork,
    pub(crate) ball: CascadeNetwork<1>,
    pub(crate) obstacle_coarse: CoarseNetwork,
    pub(crate) obstacle: CascadeNetwork<3>,
}

/// The networks, decoded at first use.
pub(crate) static NETWORKS: LazyLock<ObjectNetworks> = LazyLock::new(|| {
    let mut weights = Weights::new(WEIGHTS);
    let networks = ObjectNetworks {
        ball_coarse: CoarseNetwork::read(&mut weights),
        ball: CascadeNetwork::read(&mut weights),
        obstacle_coarse: CoarseNetwork::read(&mut weights),
        obstacle: CascadeNetwork::read(&mut weights),
    };
    assert!(weights.is_empty(), "objects.weights has a wrong size");
    networks
});

/// A network that screens patches, and a larger one that also judges those that it leaves.
///
/// They were trained apart, with other variations of the patches, and err on other ones.
pub(crate) struct CascadeNetwork<const OUT: usize> {
    screen: PatchNetwork<OUT, 8, 16, 24>,
    judge: PatchNetwork<OUT, 16, 32, 32>,
}

/// Patches whose log odds of an object are less by the screen are not judged.
const SCREEN_LOG_ODDS_MIN: f32 = -1.0;
/// Weight of the screen's outputs in the mean of both networks.
const SCREEN_WEIGHT: f32 = 0.3;

impl<const OUT: usize> CascadeNetwork<OUT> {
    fn read(weights: &mut Weights) -> Self {
        CascadeNetwork {
            screen: PatchNetwork::read(weights),
            judge: PatchNetwork::read(weights),
        }
    }

    /// Outputs before the logistic function: means of both networks, or of the screen if it is sure that there is no object.
    pub(crate) fn evaluate(&self, patch: &[f32; CHANNELS * SAMPLES]) -> [f32; OUT] {
        let mut outputs = self.screen.evaluate(patch);
        if object_log_odds(outputs) >= SCREEN_LOG_ODDS_MIN {
            for (output, judged) in outputs.iter_mut().zip(self.judge.evaluate(patch)) {
                *output = judged + SCREEN_WEIGHT * (*output - judged);
            }
        }
        outputs
    }
}

/// Log odds of an object by outputs: its own, or those of nothing and of several kinds.
fn object_log_odds<const OUT: usize>(outputs: [f32; OUT]) -> f32 {
    let likeliest = outputs[1..].iter().copied().reduce(f32::max);
    likeliest.map_or(outputs[0], |kind| kind - outputs[0])
}

/// Probability of log odds.
pub(crate) fn logistic(log_odds: f32) -> f32 {
    1.0 / (1.0 + math::exp(-log_odds))
}

/// Probabilities of exclusive classes.
pub(crate) fn softmax<const N: usize>(outputs: [f32; N]) -> [f32; N] {
    let largest = outputs.into_iter().fold(f32::NEG_INFINITY, f32::max);
    let shares = outputs.map(|output| math::exp(output - largest));
    let sum: f32 = shares.iter().sum();
    shares.map(|share| share / sum)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::objects::patch::{COARSE_SAMPLES, PatchColours, PatchKind, normalize_patch};

    fn probability(colour: impl Fn(f32, f32) -> [u8; 3]) -> f32 {
        let colours = PatchColours::of(|row, column| {
            let [row, column] = [row, column].map(|at| 0.4 * (at as f32 - 5.5));
            colour(row, column)
        });
        let [log_odds] = NETWORKS
            .ball
            .evaluate(&normalize_patch(PatchKind::Ball, &colours));
        logistic(log_odds)
    }

    #[test]
    fn discs_of_any_colour_are_balls_and_a_line_or_plain_carpet_is_none() {
        let carpet = [40, 110, 70];
        for ball in [
            [230, 130, 40],
            [235, 235, 220],
            [60, 70, 200],
            [200, 40, 60],
        ] {
            let disc = probability(|row, column| {
                if row * row + column * column < 1.0 {
                    // The upper side is lit.
                    ball.map(|level: u8| (f32::from(level) * (0.85 + 0.15 * row)) as u8)
                } else {
                    carpet
                }
            });
            assert!(disc > 0.5, "{ball:?}: {disc}");
        }
        let line = probability(|row, _| {
            if row.abs() < 0.5 {
                [230, 232, 228]
            } else {
                carpet
            }
        });
        assert!(line < 0.2, "line: {line}");
        let plain = probability(|_, _| carpet);
        assert!(plain < 0.2, "carpet: {plain}");
    }

    /// Input that `reference_outputs` of py/training/networks.py takes.
    fn reference_input<const N: usize>() -> [f32; N] {
        std::array::from_fn(|index| ((index * 37 % 101) as f64 / 50.0 - 1.0) as f32)
    }

    #[test]
    fn inference_gives_what_training_computed() {
        let coarse = reference_input::<{ CHANNELS * COARSE_SAMPLES }>().map(|value| [value]);
        let patch = reference_input();
        let (ball, obstacle) = (&NETWORKS.ball, &NETWORKS.obstacle);
        let mut outputs = NETWORKS.ball_coarse.log_odds(&coarse).to_vec();
        outputs.extend(ball.screen.evaluate(&patch));
        outputs.extend(ball.judge.evaluate(&patch));
        outputs.extend(NETWORKS.obstacle_coarse.log_odds(&coarse));
        outputs.extend(obstacle.screen.evaluate(&patch));
        outputs.extend(obstacle.judge.evaluate(&patch));
        let expected = include_str!("objects.reference").lines();
        let expected: Vec<f32> = expected.map(|line| line.parse().unwrap()).collect();
        assert_eq!(outputs.len(), expected.len());
        for (output, expected) in outputs.iter().zip(&expected) {
            assert!((output - expected).abs() < 1e-3, "{outputs:?} {expected}");
        }
    }

    #[test]
    fn probabilities_of_exclusive_classes_sum_to_one() {
        let shares = softmax([1.0, -2.0, 30.0]);
        assert!((shares.iter().sum::<f32>() - 1.0).abs() < 1e-6 && shares[2] > 0.99);
    }
}
