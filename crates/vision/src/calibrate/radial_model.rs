//! A mirror of which nothing is known: ground range as a monotone function of image radius, centre offset and tilt.
//!
//! `ln r(ρ) = ln f(ρ) + s(ρ)`: f is a member of a family with three parameters that covers the mirrors of the league, s
//! a cubic spline that the lines determine. Bearings are those of the image. Centre offset and tilt are estimated too,
//! since a mirror's axis is seldom the centre of its rim.

use crate::calibrate::joint_fit::{MapModel, PriorTerm, by_mirror_tilt, tilt_ground_point};
use crate::calibrate::radial_family::RadialFunction;
use crate::optics::ground_map::GroundMap;
use localize::math;
use localize::robot::CameraConfig;

/// Knots of the spline between axis and rim.
const INTERVALS: usize = 14;
const SPLINE_COUNT: usize = INTERVALS + 3;

/// Centre offset (2), tilt (2), spline.
const SPLINE_START: usize = 4;
const PARAMETER_COUNT: usize = SPLINE_START + SPLINE_COUNT;

/// Standard deviation of the axis from the rim's centre, of the rim's radius.
const CENTRE_STD: f64 = 0.03;

/// Standard deviation of the mean tilt against the floor, degrees.
const TILT_STD_DEG: f64 = 3.0;

/// Standard deviation of s and of its second differences.
const VALUE_STD: f64 = 0.5;
const BEND_STD: f64 = 0.06;

/// Largest distance of the axis from the rim's centre, of the rim's radius.
const CENTRE_OFFSET_MAX: f64 = 0.12;

/// Largest mean tilt of the camera against the floor.
const TILT_MAX_DEG: f64 = 10.0;

/// Least d ln r / d ln ρ: 1 near the axis of a smooth mirror and more outside; the rest is noise of the spline.
const LOG_SLOPE_MIN: f64 = 0.6;

/// Least range (metres) at shares of the rim's radius: the robot's own body hides the ground below it, and every
/// mirror of the league shows the ground to 2 m well inside its rim.
const RANGES_MIN: [(f64, f64); 2] = [(0.25, 0.2), (0.8, 2.0)];

/// Ranges beyond this do not tell two models apart, metres.
const SIMILAR_RANGE_MAX: f64 = 5.0;

/// Softness of the bounds.
const BOUND_STD: f64 = 0.01;

/// The map of an unknown mirror.
#[derive(Debug, Clone)]
pub(super) struct RadialModel {
    function: RadialFunction,
    parameters: Vec<f64>,
    sizes: KnownSizes,
}

/// What is known of the picture of any mirror.
#[derive(Debug, Clone, Copy)]
pub(super) struct KnownSizes {
    /// Radius of the rim, pixels.
    pub(super) rim_px: f64,
    /// Height of the viewpoint above the ground, metres.
    pub(super) viewpoint_height: f64,
    /// Least width of a line on the ground, metres.
    pub(super) line_width_min: f64,
}

/// A line point in an image.
#[derive(Debug, Clone, Copy)]
pub(super) struct PixelPoint {
    /// Relative to the rim's centre, along the robot's axes, pixels.
    pub(super) at_px: [f64; 2],
    /// Width of the line if it was crossed along the radius, and if across it, pixels.
    pub(super) widths_px: [f64; 2],
}

/// Range and its derivatives at a pixel.
struct RadialPoint {
    /// Unit vector from the axis.
    direction: [f64; 2],
    /// Image radius, pixels.
    radius_px: f64,
    range: f64,
    /// Metres per pixel along the radius.
    slope: f64,
    first: usize,
    splines: [f64; 4],
}

/// First coefficient, values and slopes (per interval) of the splines at a share of the rim's radius.
fn basis(part: f64) -> (usize, [f64; 4], [f64; 4]) {
    let place = (part * INTERVALS as f64).min(INTERVALS as f64 - 1e-9);
    let (first, t) = (place as usize, place.fract());
    let splines = [
        (1.0 - t).powi(3) / 6.0,
        (3.0 * t.powi(3) - 6.0 * t * t + 4.0) / 6.0,
        (-3.0 * t.powi(3) + 3.0 * t * t + 3.0 * t + 1.0) / 6.0,
        t.powi(3) / 6.0,
    ];
    let slopes = [
        -0.5 * (1.0 - t).powi(2),
        1.5 * t * t - 2.0 * t,
        -1.5 * t * t + t + 0.5,
        0.5 * t * t,
    ];
    (first, splines, slopes)
}

impl RadialModel {
    /// The parameters of the mean tilt.
    pub(super) const TILT: [usize; 2] = [2, 3];

    pub(super) fn new(function: RadialFunction, sizes: KnownSizes) -> Self {
        RadialModel {
            function,
            parameters: vec![0.0; PARAMETER_COUNT],
            sizes,
        }
    }

    /// The same mirror with all ranges multiplied by a factor.
    pub(super) fn scaled(&self, factor: f64) -> Self {
        let function = RadialFunction {
            near: factor * self.function.near,
            ..self.function
        };
        RadialModel {
            function,
            ..self.clone()
        }
    }

    /// `at_px`: relative to the rim's centre, along the robot's axes.
    fn radial_point(&self, at_px: [f64; 2]) -> RadialPoint {
        let [x, y] = [0, 1].map(|i| at_px[i] - self.parameters[i]);
        let radius_px = math::hypot(x, y).max(1e-3);
        let part = radius_px / self.sizes.rim_px;
        let (first, splines, slopes) = basis(part);
        let here = &self.parameters[SPLINE_START + first..SPLINE_START + first + 4];
        let sum = |basis: &[f64; 4]| here.iter().zip(basis).map(|(c, b)| c * b).sum::<f64>();
        let [log_range, log_slope] = self.function.log_range(part);
        let range = math::exp(log_range + sum(&splines));
        RadialPoint {
            direction: [x / radius_px, y / radius_px],
            radius_px,
            range,
            slope: range * (log_slope + sum(&slopes) * INTERVALS as f64) / self.sizes.rim_px,
            first,
            splines,
        }
    }

    /// Ranges at shares of the rim's radius, for messages.
    pub(super) fn describe(&self) -> String {
        let ranges = [0.2, 0.4, 0.6, 0.8].map(|share| {
            let [u, v] = [self.parameters[0], self.parameters[1]];
            let at = self.radial_point([share * self.sizes.rim_px + u, v]);
            format!("{:.2}", at.range)
        });
        format!(
            "{} m at 20, 40, 60, 80 % of the rim's radius",
            ranges.join(", ")
        )
    }

    /// True if a line point is not narrower on the ground than a line, whatever its direction.
    ///
    /// A map that shrinks the ground puts all points next to a marking. Blur, bloom and oblique crossings widen a line, but
    /// nothing makes it narrower than its paint.
    pub(super) fn is_wide_enough(&self, point: &PixelPoint) -> bool {
        /// Sampling narrows a line by up to a third of a pixel.
        const NARROWED_PX: f64 = 1.0 / 3.0;
        let at = self.radial_point(point.at_px);
        let footprint = [at.slope, at.range / at.radius_px];
        (0..2)
            .any(|i| (point.widths_px[i] + NARROWED_PX) * footprint[i] >= self.sizes.line_width_min)
    }

    /// Ground of a pixel, and metres per pixel along and across the radius; None beyond the horizon.
    pub(super) fn ground_and_footprint(
        &self,
        at_px: [f64; 2],
        image_tilt: [f64; 2],
    ) -> Option<([f64; 2], [f64; 2])> {
        let at = self.radial_point(at_px);
        let ground = self.tilted(&at, image_tilt);
        let finite = ground.iter().all(|value| value.is_finite()) && at.slope.is_finite();
        finite.then(|| (ground, [at.slope.abs(), at.range / at.radius_px]))
    }

    fn tilted(&self, at: &RadialPoint, image_tilt: [f64; 2]) -> [f64; 2] {
        self.tilted_point(at.direction.map(|axis| axis * at.range), image_tilt)
    }

    fn tilted_point(&self, upright: [f64; 2], image_tilt: [f64; 2]) -> [f64; 2] {
        let mirror_tilt = [0, 1].map(|i| self.parameters[2 + i]);
        tilt_ground_point(
            upright,
            mirror_tilt,
            image_tilt,
            self.sizes.viewpoint_height,
        )
    }

    /// Bounds of geometry that the present parameters violate, as squares.
    ///
    /// Without them clutter at the rim pulls the map flat, so that all of it falls on one marking.
    fn active_bounds(&self) -> Vec<PriorTerm> {
        let mut terms = Vec::new();
        for knot in 0..4 * INTERVALS {
            let part = (knot as f64 + 0.5) / (4 * INTERVALS) as f64;
            let [log_range, log_slope] = self.function.log_range(part);
            if !log_range.is_finite() {
                break;
            }
            let (first, splines, slopes) = basis(part);
            let mut bound = |values: [f64; 4], scale: f64, target: f64, std: f64| {
                let row: Vec<(usize, f64)> = (0..4)
                    .map(|k| (SPLINE_START + first + k, scale * values[k]))
                    .collect();
                let value: f64 = row.iter().map(|&(i, di)| di * self.parameters[i]).sum();
                if value < target {
                    terms.push(PriorTerm {
                        weight: 1.0 / (std * std),
                        target,
                        row,
                    });
                }
            };
            let scale = part * INTERVALS as f64;
            bound(slopes, scale, 1.0 - part * log_slope, BOUND_STD);
            for (place, least) in RANGES_MIN {
                if (part - place).abs() < 0.5 / (4 * INTERVALS) as f64 {
                    bound(splines, 1.0, math::ln(least) - log_range, BOUND_STD);
                }
            }
        }
        terms
    }

    /// True if a mirror of the league may have this map between two image radii (pixels).
    ///
    /// Without these bounds a flat or tiny map explains everything: all points lie on one marking.
    pub(super) fn is_plausible(&self, from_px: f64, to_px: f64) -> bool {
        let [u, v, a, b] = [0, 1, 2, 3].map(|i| self.parameters[i]);
        let at = |radius: f64| self.radial_point([radius + u, v]);
        let steps = (to_px - from_px).max(0.0) as usize;
        let grows = (0..steps).all(|step| {
            let radius = from_px + step as f64;
            let here = at(radius);
            here.slope * radius >= LOG_SLOPE_MIN * here.range
        });
        let reaches = RANGES_MIN
            .iter()
            .all(|&(share, least)| at(share * self.sizes.rim_px).range >= 0.8 * least);
        math::hypot(u, v) <= CENTRE_OFFSET_MAX * self.sizes.rim_px
            && math::hypot(a, b).to_degrees() <= TILT_MAX_DEG
            && grows
            && reaches
    }

    /// True if two models differ by less than a tenth in range, where lines are seen: between two image radii, pixels.
    pub(super) fn is_similar(&self, other: &RadialModel, [inner, outer]: [f64; 2]) -> bool {
        [0.0, 0.25, 0.5, 0.75, 1.0].iter().all(|share| {
            let radius_px = inner + share * (outer - inner);
            let range = |model: &RadialModel| {
                let [u, v] = [model.parameters[0], model.parameters[1]];
                let point = model.radial_point([radius_px + u, v]);
                point.range.min(SIMILAR_RANGE_MAX)
            };
            math::ln(range(self) / range(other)).abs() < 0.1
        })
    }

    /// The axis in the image, from the rim's centre in `camera`.
    pub(super) fn centre_px(&self, camera: &CameraConfig) -> [f32; 2] {
        let [[xu, yu], [xv, yv]] = camera.image_from_robot();
        let [x, y] = [self.parameters[0] as f32, self.parameters[1] as f32];
        [
            camera.centre_px[0] + xu * x + yu * y,
            camera.centre_px[1] + xv * x + yv * y,
        ]
    }

    /// The map of all pixels inside the rim with ground nearer than `range_max` metres.
    pub(super) fn ground_map(&self, camera: &CameraConfig, range_max: f64) -> GroundMap {
        let (width_px, height_px) = (camera.width_px, camera.height_px);
        let mut map = GroundMap {
            width_px,
            height_px,
            x: vec![f32::NAN; width_px * height_px],
            y: vec![f32::NAN; width_px * height_px],
        };
        for (row, column) in (0..height_px).flat_map(|v| (0..width_px).map(move |u| (v, u))) {
            let (u, v) = (column as f32, row as f32);
            if !camera.is_inside_mirror(u, v) {
                continue;
            }
            let at_px = camera.robot_direction_px(u, v).map(f64::from);
            let Some((ground, _)) = self.ground_and_footprint(at_px, [0.0; 2]) else {
                continue;
            };
            if math::hypot(ground[0], ground[1]) <= range_max {
                let index = row * width_px + column;
                map.x[index] = ground[0] as f32;
                map.y[index] = ground[1] as f32;
            }
        }
        map
    }
}

impl MapModel for RadialModel {
    type Point = PixelPoint;

    fn parameter_count(&self) -> usize {
        PARAMETER_COUNT
    }

    fn ground(&self, point: &PixelPoint, image_tilt: [f64; 2]) -> [f64; 2] {
        self.tilted(&self.radial_point(point.at_px), image_tilt)
    }

    fn variance(&self, point: &PixelPoint) -> f64 {
        const POSITION_STD_PX: f64 = 0.7;
        let at = self.radial_point(point.at_px);
        let (radial, tangential) = (
            POSITION_STD_PX * at.slope,
            POSITION_STD_PX * at.range / at.radius_px,
        );
        0.5 * (radial * radial + tangential * tangential)
    }

    fn is_plausible_point(&self, point: &PixelPoint) -> bool {
        self.is_wide_enough(point)
    }

    fn linearize(
        &self,
        point: &PixelPoint,
        image_tilt: [f64; 2],
        row: &mut Vec<(usize, [f64; 2])>,
    ) -> ([f64; 2], [[f64; 2]; 2]) {
        const STEP: f64 = 1e-5;
        let at = self.radial_point(point.at_px);
        let here = self.tilted(&at, image_tilt);
        let upright = at.direction.map(|axis| axis * at.range);
        let difference = |moved: [f64; 2]| [0, 1].map(|i| (moved[i] - here[i]) / STEP);
        let [x, y] = upright;
        let by_ground = [[x + STEP, y], [x, y + STEP]]
            .map(|moved| difference(self.tilted_point(moved, image_tilt)));
        let [a, b] = image_tilt;
        let by_tilt = [[a + STEP, b], [a, b + STEP]]
            .map(|moved| difference(self.tilted_point(upright, moved)));
        let chain = |moved: [f64; 2]| {
            [0, 1].map(|i| by_ground[0][i] * moved[0] + by_ground[1][i] * moved[1])
        };
        let [ex, ey] = at.direction;
        let across = at.range / at.radius_px;
        // The axis moves: radius and bearing of the pixel change in the opposite sense.
        row.push((
            0,
            chain([
                -(at.slope * ex * ex + across * ey * ey),
                -(at.slope - across) * ex * ey,
            ]),
        ));
        row.push((
            1,
            chain([
                -(at.slope - across) * ex * ey,
                -(at.slope * ey * ey + across * ex * ex),
            ]),
        ));
        let [by_a, by_b] = by_mirror_tilt(by_tilt, self.sizes.viewpoint_height);
        row.push((2, by_a));
        row.push((3, by_b));
        let outward = chain(upright);
        for (k, spline) in at.splines.iter().enumerate() {
            row.push((
                SPLINE_START + at.first + k,
                outward.map(|axis| axis * spline),
            ));
        }
        (here, by_tilt)
    }

    fn prior_terms(&self) -> Vec<PriorTerm> {
        let single = |index: usize, std: f64| PriorTerm {
            weight: 1.0 / (std * std),
            target: 0.0,
            row: vec![(index, 1.0)],
        };
        let centre_std = CENTRE_STD * self.sizes.rim_px;
        let tilt_std = TILT_STD_DEG.to_radians();
        let mut terms = vec![
            single(0, centre_std),
            single(1, centre_std),
            single(2, tilt_std),
            single(3, tilt_std),
        ];
        for k in 0..SPLINE_COUNT {
            let number = SPLINE_START + k;
            terms.push(single(number, VALUE_STD));
            if k >= 2 {
                terms.push(PriorTerm {
                    weight: 1.0 / (BEND_STD * BEND_STD),
                    target: 0.0,
                    row: vec![(number - 2, 1.0), (number - 1, -2.0), (number, 1.0)],
                });
            }
        }
        terms.extend(self.active_bounds());
        terms
    }

    fn parameters(&self) -> &[f64] {
        &self.parameters
    }

    fn parameters_mut(&mut self) -> &mut [f64] {
        &mut self.parameters
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const LINE_WIDTH: f64 = 0.1;

    fn model(near: f64) -> RadialModel {
        let function = RadialFunction {
            near,
            horizon: 1.3,
            power: 3.0,
        };
        let sizes = KnownSizes {
            rim_px: 240.0,
            viewpoint_height: 0.75,
            line_width_min: 0.4 * LINE_WIDTH,
        };
        RadialModel::new(function, sizes)
    }

    /// A line across the radius, blurred to `widened` times its width.
    fn point(model: &RadialModel, radius_px: f64, widened: f64) -> PixelPoint {
        let slope = model.radial_point([radius_px, 0.0]).slope;
        let width_px = widened * LINE_WIDTH / slope;
        PixelPoint {
            at_px: [radius_px, 0.0],
            widths_px: [width_px, width_px],
        }
    }

    #[test]
    fn lines_are_too_narrow_for_a_map_that_shrinks_the_ground_and_for_no_other() {
        let [right, shrunken, enlarged] = [3.0, 0.8, 6.0].map(model);
        for radius_px in [60.0, 100.0, 140.0, 180.0] {
            let sharp = point(&right, radius_px, 1.0);
            assert!(right.is_wide_enough(&sharp), "{radius_px} px");
            assert!(!shrunken.is_wide_enough(&sharp), "{radius_px} px");
            assert!(enlarged.is_wide_enough(&sharp), "{radius_px} px");
            // Near the robot overexposed lines bloom to three times their width.
            assert!(right.is_wide_enough(&point(&right, radius_px, 3.0)));
        }
    }
}
