//! By how much is a map off? A smooth correction of range and bearing, and a lean, with few enough numbers to be fitted.

use crate::optics::ground_map::GroundMap;

/// Knots of the range correction lie evenly in asinh(range / 1 m): linear near the robot, logarithmic far away.
const KNOT_STEP: f64 = 0.4;

/// Cubic B-splines over 0 to 12 m.
pub(super) const SPLINE_COUNT: usize = 11;

/// Functions of the bearing: 1, cos φ, sin φ, cos 2φ, sin 2φ for the range; the last four for the bearing.
const RANGE_HARMONICS: usize = 5;
const BEARING_HARMONICS: usize = 4;

/// Numbers of a correction: splines times harmonics, then the lean (a, b).
pub(super) const PARAMETER_COUNT: usize = SPLINE_COUNT * (RANGE_HARMONICS + BEARING_HARMONICS) + 2;

/// Where the lean starts among the numbers.
const TILT_INDEX: usize = PARAMETER_COUNT - 2;

/// A correction of a start map: log range, bearing, lean.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct MapCorrection {
    pub(super) parameters: Vec<f64>,
    /// Height of the viewpoint above the ground, metres.
    pub(super) viewpoint_height: f64,
}

/// A start map's point made ready: its polar coordinates and basis functions.
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
        let (range, bearing) = (x.hypot(y), y.atan2(x));
        let place = (range.asinh() / KNOT_STEP).min((SPLINE_COUNT - 3) as f64 - 1e-9);
        let (first, t) = (place as usize, place.fract());
        let (s, c) = bearing.sin_cos();
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

    /// Calls with (number, value of its basis function, is it a correction of the bearing).
    pub(super) fn for_each(&self, mut with: impl FnMut(usize, f64, bool)) {
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
            // The middle of a cubic B-spline's support.
            let range = ((k as f64 - 1.0) * KNOT_STEP).sinh().clamp(0.3, 12.0);
            correction.parameters[k] = scale.ln() + power * range.ln();
        }
        correction
    }

    /// Corrected log range factor and bearing difference at a point.
    fn evaluate(&self, basis: &BasisValues) -> [f64; 2] {
        let mut shifts = [0.0; 2];
        basis.for_each(|number, value, bearing| {
            shifts[usize::from(bearing)] += self.parameters[number] * value;
        });
        shifts
    }

    /// The corrected ground point, seen with an additional lean of one frame.
    pub(super) fn correct_point(&self, basis: &BasisValues, frame_lean: [f64; 2]) -> [f64; 2] {
        let [shift, turn] = self.evaluate(basis);
        self.apply_shift(basis, [shift, turn], frame_lean)
    }

    fn apply_shift(
        &self,
        basis: &BasisValues,
        [shift, turn]: [f64; 2],
        frame_lean: [f64; 2],
    ) -> [f64; 2] {
        let range = basis.range * shift.exp();
        let (sin, cos) = (basis.bearing + turn).sin_cos();
        let lean = [0, 1].map(|i| self.parameters[TILT_INDEX + i] + frame_lean[i]);
        tilt_ground_point([range * cos, range * sin], lean, self.viewpoint_height)
    }

    /// The corrected point and its derivatives by log range, bearing and lean (a, b).
    pub(super) fn jacobian(
        &self,
        basis: &BasisValues,
        lean: [f64; 2],
    ) -> ([f64; 2], [[f64; 2]; 4]) {
        const STEP: f64 = 1e-5;
        let [shift, turn] = self.evaluate(basis);
        let here = self.apply_shift(basis, [shift, turn], lean);
        let by = |moved: [f64; 2]| [0, 1].map(|i| (moved[i] - here[i]) / STEP);
        let derivatives = [
            by(self.apply_shift(basis, [shift + STEP, turn], lean)),
            by(self.apply_shift(basis, [shift, turn + STEP], lean)),
            by(self.apply_shift(basis, [shift, turn], [lean[0] + STEP, lean[1]])),
            by(self.apply_shift(basis, [shift, turn], [lean[0], lean[1] + STEP])),
        ];
        (here, derivatives)
    }

    /// Adds to a gradient row: derivatives by log range, bearing and lean, spread over the numbers.
    pub(super) fn append_jacobian(basis: &BasisValues, by: [f64; 4], row: &mut Vec<(usize, f64)>) {
        basis.for_each(|number, value, bearing| {
            row.push((number, value * by[usize::from(bearing)]))
        });
        row.push((TILT_INDEX, by[2]));
        row.push((TILT_INDEX + 1, by[3]));
    }

    /// Weak beliefs about a correction: (weight, row) of squares to be added, each row times the numbers being zero.
    pub(super) fn prior_terms() -> Vec<(f64, Vec<(usize, f64)>)> {
        let mut beliefs = Vec::new();
        for group in 0..RANGE_HARMONICS + BEARING_HARMONICS {
            // A guess may be 30 % off in range all around; around the circle the lean below does most, a few percent are left.
            let (value, bend) = match group {
                0 => (0.3, 0.06),
                g if g < RANGE_HARMONICS => (0.02, 0.005),
                _ => (0.01, 0.003),
            };
            for k in 0..SPLINE_COUNT {
                let number = group * SPLINE_COUNT + k;
                beliefs.push((1.0 / (value * value), vec![(number, 1.0)]));
                if k >= 2 {
                    let row = vec![(number - 2, 1.0), (number - 1, -2.0), (number, 1.0)];
                    beliefs.push((1.0 / (bend * bend), row));
                }
            }
        }
        let lean = 4f64.to_radians();
        beliefs.push((1.0 / (lean * lean), vec![(TILT_INDEX, 1.0)]));
        beliefs.push((1.0 / (lean * lean), vec![(TILT_INDEX + 1, 1.0)]));
        beliefs
    }

    /// The start map, corrected.
    pub(super) fn correct_map(&self, start: &GroundMap) -> GroundMap {
        let mut map = start.clone();
        for (x, y) in map.x.iter_mut().zip(&mut map.y) {
            if x.is_finite() && y.is_finite() {
                let basis = BasisValues::new([f64::from(*x), f64::from(*y)]);
                let ground = self.correct_point(&basis, [0.0; 2]);
                let seen = ground.iter().all(|at| at.is_finite());
                [*x, *y] = if seen {
                    ground.map(|at| at as f32)
                } else {
                    [f32::NAN; 2]
                };
            }
        }
        map
    }
}

/// Where a point of an upright robot's map lies on the ground with tilt (a, b) (docs/methods.md 3.3); NaN at the horizon.
fn tilt_ground_point(point: [f64; 2], tilt: [f64; 2], height: f64) -> [f64; 2] {
    localize::tilt::ground_above_depth(point, tilt, height, 0.05 * height).unwrap_or([f64::NAN; 2])
}
