//! Ground map from rings of known distance, interpolated along the radius and around the circle.
//!
//! nubot2013 3.2 interpolates along the radius, then periodically around the circle. Here each ring's radius and
//! deviation are trigonometric polynomials of the bearing, which averages noise. The distance is a monotone cubic of the
//! radius, which cannot oscillate between rings.

use localize::math;
use nalgebra::{DMatrix, DVector};
use rayon::prelude::*;

use crate::optics::ground_map::GroundMap;
use localize::robot::CameraConfig;

/// A periodic function: 1, cos φ, sin φ, cos 2φ, …
#[derive(Debug, Clone, PartialEq)]
pub(super) struct FourierSeries {
    coefficients: Vec<f64>,
}

impl FourierSeries {
    /// Least squares through (angle, value); `order` harmonics.
    pub(super) fn fit(points: &[[f64; 2]], order: usize) -> Option<Self> {
        let unknowns = 2 * order + 1;
        if points.len() < unknowns {
            return None;
        }
        let rows = DMatrix::from_fn(points.len(), unknowns, |row, column| {
            fourier_basis(points[row][0], column)
        });
        let values = DVector::from_iterator(points.len(), points.iter().map(|point| point[1]));
        let solution = rows.svd(true, true).solve(&values, 1e-9).ok()?;
        Some(FourierSeries {
            coefficients: solution.iter().copied().collect(),
        })
    }

    pub(super) fn evaluate(&self, angle: f64) -> f64 {
        let (sin, cos) = math::sin_cos(angle);
        let (mut s, mut c) = (0.0, 1.0);
        let mut sum = self.coefficients[0];
        for pair in self.coefficients[1..].chunks_exact(2) {
            (s, c) = (s * cos + c * sin, c * cos - s * sin);
            sum += pair[0] * c + pair[1] * s;
        }
        sum
    }
}

fn fourier_basis(angle: f64, column: usize) -> f64 {
    let harmonic = column.div_ceil(2) as f64;
    match column {
        0 => 1.0,
        odd if odd % 2 == 1 => math::cos(harmonic * angle),
        _ => math::sin(harmonic * angle),
    }
}

/// Rings of known distance and their image in polar coordinates about the mirror's axis.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct PolarMap {
    /// Distance of each ring, metres, ascending.
    pub(super) distances: Vec<f64>,
    /// Image radius of each ring as a function of the robot bearing, pixels.
    pub(super) radii: Vec<FourierSeries>,
    /// Image angle minus nominal angle of each ring as a function of the robot bearing, radians.
    pub(super) deviations: Vec<FourierSeries>,
}

impl PolarMap {
    /// Ground distance and robot bearing at an image radius (pixels) and nominal bearing. None more than one spacing
    /// beyond the rings.
    fn ground_at(&self, radius: f64, nominal: f64) -> Option<[f64; 2]> {
        let mut bearing = nominal;
        let mut distance = 0.0;
        for _ in 0..4 {
            let radii: Vec<f64> = self
                .radii
                .iter()
                .map(|ring| ring.evaluate(bearing))
                .collect();
            if radii.windows(2).any(|pair| pair[1] <= pair[0]) {
                return None;
            }
            distance = monotone_cubic(&radii, &self.distances, radius)?;
            let deviations: Vec<f64> = self
                .deviations
                .iter()
                .map(|ring| ring.evaluate(bearing))
                .collect();
            let clamped = radius.clamp(radii[0], radii[radii.len() - 1]);
            bearing = nominal - monotone_cubic(&radii, &deviations, clamped)?;
        }
        Some([distance, bearing])
    }

    /// Evaluates the map at all pixels.
    pub(super) fn ground_map(&self, camera: &CameraConfig) -> GroundMap {
        let (width_px, height_px) = (camera.width_px, camera.height_px);
        let pixels: Vec<[f32; 2]> = (0..height_px)
            .into_par_iter()
            .flat_map_iter(|v| (0..width_px).map(move |u| (u, v)))
            .map(|(u, v)| {
                let [x, y] = camera.robot_direction_px(u as f32, v as f32).map(f64::from);
                let inside = camera.is_inside_mirror(u as f32, v as f32);
                let ground = self
                    .ground_at(math::hypot(x, y), math::atan2(y, x))
                    .filter(|_| inside);
                ground.map_or([f32::NAN; 2], |[distance, bearing]| {
                    [
                        (distance * math::cos(bearing)) as f32,
                        (distance * math::sin(bearing)) as f32,
                    ]
                })
            })
            .collect();
        GroundMap {
            width_px,
            height_px,
            x: pixels.iter().map(|pixel| pixel[0]).collect(),
            y: pixels.iter().map(|pixel| pixel[1]).collect(),
        }
    }
}

/// Fritsch and Carlson's monotone cubic through (x, y), extrapolated linearly by one step beyond each end.
pub(super) fn monotone_cubic(x: &[f64], y: &[f64], at: f64) -> Option<f64> {
    let last = x.len().checked_sub(1)?;
    if last == 0 {
        return None;
    }
    let secant = |i: usize| (y[i + 1] - y[i]) / (x[i + 1] - x[i]);
    let slope = |i: usize| {
        if i == 0 {
            return secant(0);
        }
        if i == last {
            return secant(last - 1);
        }
        let (before, after) = (secant(i - 1), secant(i));
        if before * after <= 0.0 {
            return 0.0;
        }
        // Weighted harmonic mean (Fritsch and Butland).
        let (h0, h1) = (x[i] - x[i - 1], x[i + 1] - x[i]);
        let (w0, w1) = (2.0 * h1 + h0, h1 + 2.0 * h0);
        (w0 + w1) / (w0 / before + w1 / after)
    };
    if at < x[0] {
        return (at >= x[0] - (x[1] - x[0])).then(|| y[0] + slope(0) * (at - x[0]));
    }
    if at > x[last] {
        return (at <= x[last] + (x[last] - x[last - 1]))
            .then(|| y[last] + slope(last) * (at - x[last]));
    }
    let upper = x.partition_point(|&value| value <= at).clamp(1, last);
    let lower = upper - 1;
    let step = x[upper] - x[lower];
    let s = (at - x[lower]) / step;
    let (m0, m1) = (slope(lower) * step, slope(upper) * step);
    let (a, b) = (
        2.0 * (y[lower] - y[upper]) + m0 + m1,
        3.0 * (y[upper] - y[lower]) - 2.0 * m0 - m1,
    );
    Some(y[lower] + s * (m0 + s * (b + s * a)))
}
