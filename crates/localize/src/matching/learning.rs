//! Learning from the residuals of a tracked image: the spread of the points, and how their errors repeat
//! (docs/methods.md 5.8, 5.9).

use super::distance_field::DistanceField;
use super::point_spread::Residual;
use super::repeated_errors::Remainder;
use super::{Match, Matcher, PARAMETERS, Vector5};
use crate::frames::Pose;
use crate::{math, tilt};

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
        let (sin, cos) = math::sin_cos(theta);
        let height = self.config.viewpoint_height;
        let inverse_height = 1.0 / height;
        self.residuals.clear();
        self.remainders.clear();
        for point in &self.points {
            let [px, py] = tilt::ground_from_map([point.x, point.y], matched.tilt, height);
            let (rx, ry) = (cos * px - sin * py, sin * px + cos * py);
            let near = distances.nearest(x + rx, y + ry);
            let [nx, ny] = near.normal;
            let radial = nx * rx + ny * ry;
            let variance =
                point.tangential_variance + point.radial_excess_variance * radial * radial;
            let along = radial * inverse_height;
            let explained = nx * free[0]
                + ny * free[1]
                + (ny * rx - nx * ry) * free[2]
                + along * (px * free[3] + py * free[4]);
            let remaining = near.signed_distance + explained;
            self.residuals.push(Residual {
                distance: remaining,
                variance,
                range: (rx * rx + ry * ry).sqrt(),
            });
            self.remainders.push(Remainder {
                at: [
                    x + rx - near.signed_distance * nx,
                    y + ry - near.signed_distance * ny,
                ],
                sigmas: remaining / variance.sqrt(),
                normal: near.normal,
            });
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
