//! Smooth correction of a ground map: range, bearing and tilt, with few parameters.

use localize::math;

use crate::calibrate::joint_fit::{MapModel, PriorTerm, by_mirror_tilt, tilt_ground_point};
use crate::optics::ground_map::GroundMap;

/// Knots are uniform in asinh(range / 1 m): linear near the robot, logarithmic far away.
const KNOT_STEP: f64 = 0.4;

/// Number of cubic B-splines over 0 to 12 m.
const SPLINE_COUNT: usize = 11;

/// Harmonics of the bearing: 1, cos φ, sin φ, cos 2φ, sin 2φ for the range; the last four for the bearing.
const RANGE_HARMONICS: usize = 5;
const BEARING_HARMONICS: usize = 4;

/// Parameters of a correction: splines times harmonics, then the tilt (a, b).
const PARAMETER_COUNT: usize = SPLINE_COUNT * (RANGE_HARMONICS + BEARING_HARMONICS) + 2;

/// Index of the tilt's first parameter.
const TILT_INDEX: usize = PARAMETER_COUNT - 2;

/// A correction of an initial map: log range, bearing, tilt.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct MapCorrection {
    parameters: Vec<f64>,
    /// Height of the viewpoint above the ground, metres.
    pub(super) viewpoint_height: f64,
}

/// A line point of the initial map.
#[derive(Debug, Clone)]
pub(super) struct CorrectionPoint {
    basis: BasisValues,
    variance: f64,
}

impl CorrectionPoint {
    /// `start`: its ground in the initial map, robot frame; standard deviations along and across the radius, metres.
    pub(super) fn new(start: [f64; 2], std_radial: f64, std_tangential: f64) -> Self {
        CorrectionPoint {
            basis: BasisValues::new(start),
            variance: 0.5 * (std_radial * std_radial + std_tangential * std_tangential),
        }
    }
}

/// Polar coordinates and basis functions of a point of the initial map.
#[derive(Debug, Clone)]
pub(super) struct BasisValues {
    range: f64,
    bearing: f64,
    first: usize,
    splines: [f64; 4],
    harmonics: [f64; RANGE_HARMONICS],
}

impl BasisValues {
    pub(super) fn new([x, y]: [f64; 2]) -> Self {
        let (range, bearing) = (math::hypot(x, y), math::atan2(y, x));
        let place = (math::asinh(range) / KNOT_STEP).min((SPLINE_COUNT - 3) as f64 - 1e-9);
        let (first, t) = (place as usize, place.fract());
        let (s, c) = math::sin_cos(bearing);
        BasisValues {
            range,
            bearing,
            first,
            splines: [
                (1.0 - t).powi(3) / 6.0,
                (3.0 * t.powi(3) - 6.0 * t * t + 4.0) / 6.0,
                (-3.0 * t.powi(3) + 3.0 * t * t + 3.0 * t + 1.0) / 6.0,
                t.powi(3) / 6.0,
            ],
            harmonics: [1.0, c, s, c * c - s * s, 2.0 * s * c],
        }
    }

    /// Calls with (parameter's index, value of its basis function, true if it corrects the bearing).
    fn for_each(&self, mut with: impl FnMut(usize, f64, bool)) {
        for (k, spline) in self.splines.iter().enumerate() {
            for (h, harmonic) in self.harmonics.iter().enumerate() {
                with(h * SPLINE_COUNT + self.first + k, spline * harmonic, false);
                if h > 0 {
                    let number = (RANGE_HARMONICS + h - 1) * SPLINE_COUNT + self.first + k;
                    with(number, spline * harmonic, true);
                }
            }
        }
    }
}

impl MapCorrection {
    pub(super) fn identity(height: f64) -> Self {
        MapCorrection {
            parameters: vec![0.0; PARAMETER_COUNT],
            viewpoint_height: height,
        }
    }

    /// Scales ranges by `scale` at one metre and by `scale`·3^`power` at three.
    pub(super) fn scaled(height: f64, scale: f64, power: f64) -> Self {
        let mut correction = MapCorrection::identity(height);
        for k in 0..SPLINE_COUNT {
            // Centre of a cubic B-spline's support.
            let range = math::sinh((k as f64 - 1.0) * KNOT_STEP).clamp(0.3, 12.0);
            correction.parameters[k] = math::ln(scale) + power * math::ln(range);
        }
        correction
    }

    /// Log range factor and bearing shift at a point.
    fn evaluate(&self, basis: &BasisValues) -> [f64; 2] {
        let mut shifts = [0.0; 2];
        basis.for_each(|number, value, bearing| {
            shifts[usize::from(bearing)] += self.parameters[number] * value;
        });
        shifts
    }

    /// The corrected ground point, with an additional tilt of one image.
    pub(super) fn correct_point(&self, basis: &BasisValues, image_tilt: [f64; 2]) -> [f64; 2] {
        let [shift, rotation] = self.evaluate(basis);
        self.apply_shift(basis, [shift, rotation], image_tilt)
    }

    fn apply_shift(
        &self,
        basis: &BasisValues,
        [shift, rotation]: [f64; 2],
        image_tilt: [f64; 2],
    ) -> [f64; 2] {
        let range = basis.range * math::exp(shift);
        let (sin, cos) = math::sin_cos(basis.bearing + rotation);
        let mirror_tilt = [0, 1].map(|i| self.parameters[TILT_INDEX + i]);
        tilt_ground_point(
            [range * cos, range * sin],
            mirror_tilt,
            image_tilt,
            self.viewpoint_height,
        )
    }

    /// Corrects the initial map.
    pub(super) fn correct_map(&self, start: &GroundMap) -> GroundMap {
        let mut map = start.clone();
        for (x, y) in map.x.iter_mut().zip(&mut map.y) {
            if x.is_finite() && y.is_finite() {
                let basis = BasisValues::new([f64::from(*x), f64::from(*y)]);
                let ground = self.correct_point(&basis, [0.0; 2]);
                let finite = ground.iter().all(|at| at.is_finite());
                [*x, *y] = if finite {
                    ground.map(|at| at as f32)
                } else {
                    [f32::NAN; 2]
                };
            }
        }
        map
    }
}

impl MapModel for MapCorrection {
    type Point = CorrectionPoint;

    fn parameter_count(&self) -> usize {
        PARAMETER_COUNT
    }

    fn parameters(&self) -> &[f64] {
        &self.parameters
    }

    fn parameters_mut(&mut self) -> &mut [f64] {
        &mut self.parameters
    }

    fn ground(&self, point: &CorrectionPoint, image_tilt: [f64; 2]) -> [f64; 2] {
        self.correct_point(&point.basis, image_tilt)
    }

    fn variance(&self, point: &CorrectionPoint) -> f64 {
        point.variance
    }

    fn linearize(
        &self,
        point: &CorrectionPoint,
        tilt: [f64; 2],
        row: &mut Vec<(usize, [f64; 2])>,
    ) -> ([f64; 2], [[f64; 2]; 2]) {
        const STEP: f64 = 1e-5;
        let basis = &point.basis;
        let [shift, rotation] = self.evaluate(basis);
        let here = self.apply_shift(basis, [shift, rotation], tilt);
        let by = |moved: [f64; 2]| [0, 1].map(|i| (moved[i] - here[i]) / STEP);
        let by_shift = by(self.apply_shift(basis, [shift + STEP, rotation], tilt));
        let by_rotation = by(self.apply_shift(basis, [shift, rotation + STEP], tilt));
        let by_tilt = [
            by(self.apply_shift(basis, [shift, rotation], [tilt[0] + STEP, tilt[1]])),
            by(self.apply_shift(basis, [shift, rotation], [tilt[0], tilt[1] + STEP])),
        ];
        basis.for_each(|number, value, bearing| {
            let by = if bearing { by_rotation } else { by_shift };
            row.push((number, by.map(|axis| value * axis)));
        });
        let [by_a, by_b] = by_mirror_tilt(by_tilt, self.viewpoint_height);
        row.push((TILT_INDEX, by_a));
        row.push((TILT_INDEX + 1, by_b));
        (here, by_tilt)
    }

    /// Weak priors: a correction is small and smooth.
    fn prior_terms(&self) -> Vec<PriorTerm> {
        let mut terms = Vec::new();
        for group in 0..RANGE_HARMONICS + BEARING_HARMONICS {
            // A guess may be 30 % off in range; over the bearing the tilt explains most, and a few percent remain.
            let (value, bend) = match group {
                0 => (0.3, 0.06),
                g if g < RANGE_HARMONICS => (0.02, 0.005),
                _ => (0.01, 0.003),
            };
            for k in 0..SPLINE_COUNT {
                let number = group * SPLINE_COUNT + k;
                terms.push(PriorTerm {
                    weight: 1.0 / (value * value),
                    target: 0.0,
                    row: vec![(number, 1.0)],
                });
                if k >= 2 {
                    let row = vec![(number - 2, 1.0), (number - 1, -2.0), (number, 1.0)];
                    terms.push(PriorTerm {
                        weight: 1.0 / (bend * bend),
                        target: 0.0,
                        row,
                    });
                }
            }
        }
        let tilt_std = 4f64.to_radians();
        for index in [TILT_INDEX, TILT_INDEX + 1] {
            terms.push(PriorTerm {
                weight: 1.0 / (tilt_std * tilt_std),
                target: 0.0,
                row: vec![(index, 1.0)],
            });
        }
        terms
    }
}
