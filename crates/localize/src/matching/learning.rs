//! Learning from the residuals of a tracked image: the spread of the points, and how their errors repeat
//! (docs/methods.md 5.8, 5.9).

use super::distance_field::DistanceField;
use super::point_spread::Residual;
use super::repeated_errors::Remainder;
use super::{Match, Matcher, Vector5};
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
        let free = (normal + self.uninformative_prior())
            .cholesky()
            .map_or_else(Vector5::zeros, |cholesky| -cholesky.solve(&gradient));
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
            self.residuals.push(Residual {
                distance: near.signed_distance,
                variance,
                range: (rx * rx + ry * ry).sqrt(),
            });
            let along = radial * inverse_height;
            let explained = nx * free[0]
                + ny * free[1]
                + (ny * rx - nx * ry) * free[2]
                + along * (px * free[3] + py * free[4]);
            self.remainders.push(Remainder {
                at: [
                    x + rx - near.signed_distance * nx,
                    y + ry - near.signed_distance * ny,
                ],
                sigmas: (near.signed_distance + explained) / variance.sqrt(),
                normal: near.normal,
            });
        }
        self.repeated
            .update(self.remainders.iter().copied(), matched.pose);
        self.spread.update(
            self.residuals.iter().copied(),
            matched.determined_parameters,
            matched.observed_scale,
            seconds,
        );
    }
}
