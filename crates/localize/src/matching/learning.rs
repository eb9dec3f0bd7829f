//! Learning from the residuals of a tracked image: the spread of the points, and how their errors repeat
//! (docs/methods.md 5.8, 5.9).

use super::distance_field::DistanceField;
use super::normal_equations::{LANES, LaneRows};
use super::point_spread::Residual;
use super::repeated_errors::Remainder;
use super::{Match, Matcher, PARAMETERS, Vector5};
use crate::frames::Pose;

impl Matcher {
    /// Learns the spread of the points and how their errors repeat from the residuals of the last match, `matched`, an
    /// image `seconds` after the previous one (docs/methods.md 5.8, 5.9).
    pub fn learn_spread(&mut self, distances: &DistanceField, matched: &Match, seconds: f32) {
        let Pose { x, y, theta, .. } = matched.pose;
        let state = Vector5::from([x, y, theta, matched.tilt[0], matched.tilt[1]]);
        let pass = self.last_pass.filter(|pass| pass.state == state);
        let (normal, gradient) = pass.map_or_else(
            || {
                let sums = self.accumulate(distances, &state, 1.0);
                (sums.normal, sums.gradient)
            },
            |pass| (pass.normal, pass.gradient),
        );
        // What a pose from these points alone would explain is no error of theirs.
        let unknown = self.uninformative_prior();
        let cholesky = (normal + unknown).cholesky();
        let (free, determined) = cholesky.map_or((Vector5::zeros(), 0.0), |cholesky| {
            let undetermined = (cholesky.inverse() * unknown).trace();
            (-cholesky.solve(&gradient), PARAMETERS as f32 - undetermined)
        });
        let pass = self.pass(&state, 1.0);
        self.residuals.clear();
        self.remainders.clear();
        for group in &self.lanes {
            let LaneRows {
                rows,
                distance,
                variance,
                offset: [rx, ry],
            } = LaneRows::of(group, &pass, distances);
            let [mut remaining, mut sigmas, mut range] = [[0.0; LANES]; 3];
            let mut at = [[0.0; LANES]; 2];
            for k in 0..LANES {
                let explained: f32 = (0..PARAMETERS).map(|i| rows[i][k] * free[i]).sum();
                remaining[k] = distance[k] + explained;
                sigmas[k] = remaining[k] / variance[k].sqrt();
                range[k] = (rx[k] * rx[k] + ry[k] * ry[k]).sqrt();
                at[0][k] = x + rx[k] - distance[k] * rows[0][k];
                at[1][k] = y + ry[k] - distance[k] * rows[1][k];
            }
            for k in (0..LANES).filter(|&k| group.weight[k] > 0.0) {
                self.residuals.push(Residual {
                    distance: remaining[k],
                    variance: variance[k],
                    range: range[k],
                });
                self.remainders.push(Remainder {
                    at: at.map(|axis| axis[k]),
                    sigmas: sigmas[k],
                    normal: [rows[0][k], rows[1][k]],
                });
            }
        }
        self.repeated
            .update(self.remainders.iter().copied(), matched.pose);
        self.spread.update(
            self.residuals.iter().copied(),
            determined,
            matched.observed_scale,
            seconds,
        );
    }
}

#[cfg(test)]
mod tests {
    use nalgebra::Matrix3;

    use super::super::{MatchConfig, MatchStart, Matrix5, PosePrior};
    use super::*;
    use crate::field::tests::league_18x12;
    use crate::frames::At;
    use crate::matching::distance_field::DistanceFieldConfig;
    use crate::sample::LinePoint;

    /// Points on the markings within 4 m of a robot in the middle of the field, which it sees without error.
    fn points_on_markings(distances: &DistanceField) -> Vec<LinePoint> {
        (0..4000)
            .map(|step| {
                let x = (step as f32 * 0.618_034).fract() * 8.0 - 4.0;
                let y = (step as f32 * 0.754_877_7).fract() * 8.0 - 4.0;
                let near = distances.nearest(x, y);
                let [nx, ny] = near.normal;
                let d = near.signed_distance;
                ([x - d * nx, y - d * ny], d.abs())
            })
            .filter(|(_, distance)| *distance < 0.2)
            .map(|([x, y], _)| LinePoint {
                at: At::new(x, y),
                std_radial: 0.02,
                std_tangential: 0.02,
            })
            .take(150)
            .collect()
    }

    #[test]
    fn points_do_not_scatter_because_a_wrong_prediction_holds_the_pose() {
        let distances =
            DistanceField::new(&league_18x12("centres"), &DistanceFieldConfig::default());
        let points = points_on_markings(&distances);
        let spread_after = |error: f32| {
            let mut matcher = Matcher::new(MatchConfig::default());
            let mut information = Matrix5::from_diagonal_element(1e6);
            let sure = Matrix3::from_diagonal_element(1e6);
            information.fixed_view_mut::<3, 3>(0, 0).copy_from(&sure);
            let prior = PosePrior {
                pose: Pose::new(error, 0.6 * error, 0.0),
                information,
            };
            for _ in 0..60 {
                let start = MatchStart::new(0.1);
                let matched = matcher.refine_with_prior(&distances, &points, prior, start);
                matcher.learn_spread(&distances, &matched, 0.03);
            }
            matcher.spread.factor().at(2.5)
        };
        let [right, wrong] = [0.0, 0.04].map(spread_after);
        assert!(wrong < 2.0 * right.max(0.05), "{wrong} instead of {right}");
    }
}
