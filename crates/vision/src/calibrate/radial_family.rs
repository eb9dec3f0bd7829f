//! Which mirrors are there? A family of radial functions that covers those of the league.

use localize::math;

/// A member of the family: r(x) = near·x / (1 − (x / horizon)^power), x the image radius over the rim's radius.
///
/// Near the axis range is proportional to radius for every smooth mirror. It diverges where the mirror shows the
/// horizon. Hyperbolic and spherical mirrors have powers of 2 to 4, horizontally isometric ones up to 10.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct RadialFunction {
    /// Metres per rim radius near the axis.
    pub(super) near: f64,
    /// Radius of the horizon over the rim's radius.
    pub(super) horizon: f64,
    pub(super) power: f64,
}

impl RadialFunction {
    /// Log range and its derivative by x; infinite at and beyond the horizon.
    pub(super) fn log_range(&self, x: f64) -> [f64; 2] {
        let part = math::powf(x / self.horizon, self.power);
        if part >= 0.99 {
            return [f64::INFINITY; 2];
        }
        let x = x.max(1e-3);
        [
            math::ln(self.near * x / (1.0 - part)),
            1.0 / x + self.power * part / (x * (1.0 - part)),
        ]
    }
}

/// Metres per rim radius near the axis: steps of a quarter from a mirror that shows the near ground large to one that
/// is isometric up to 6 m.
const NEAR_FIRST: f64 = 0.8;
const NEAR_STEP: f64 = 1.22;
const NEAR_COUNT: usize = 13;
/// Horizons over the rim's radius. Some mirrors show much that is above the horizon, and a rim outside the image is a guess.
const HORIZONS: [f64; 5] = [0.7, 0.83, 0.98, 1.1, 1.3];
const POWERS: [f64; 2] = [3.0, 8.0];

/// Radii of the horizon and powers of shapes whose scale is not known, finer than those of the family.
const SHAPE_HORIZONS: [f64; 9] = [0.62, 0.7, 0.76, 0.83, 0.9, 0.98, 1.1, 1.3, 2.0];
const SHAPE_POWERS: [f64; 4] = [2.0, 3.0, 5.0, 8.0];
/// Their scale: about the middle of the family.
const SHAPE_NEAR: f64 = 2.6;

/// Members of one scale, for what does not depend on it.
pub(super) fn shapes() -> impl Iterator<Item = RadialFunction> {
    SHAPE_HORIZONS.iter().flat_map(|&horizon| {
        SHAPE_POWERS.iter().map(move |&power| RadialFunction {
            near: SHAPE_NEAR,
            horizon,
            power,
        })
    })
}

/// All members.
pub(super) fn family() -> impl Iterator<Item = RadialFunction> {
    let near = (0..NEAR_COUNT).map(|k| NEAR_FIRST * NEAR_STEP.powi(k as i32));
    near.flat_map(|near| {
        HORIZONS.iter().flat_map(move |&horizon| {
            POWERS.iter().map(move |&power| RadialFunction {
                near,
                horizon,
                power,
            })
        })
    })
}
