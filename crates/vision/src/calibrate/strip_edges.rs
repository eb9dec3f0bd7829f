//! Detects the strip's edges in one image, along its middle, which may deviate from its nominal direction.

use crate::image::Image;
use localize::math;
use localize::robot::CameraConfig;

/// One edge of the strip in the image, about the mirror's axis.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct PolarEdge {
    /// Index of the edge, from the robot outward.
    pub(super) edge_index: usize,
    /// Distance from the axis, pixels.
    pub(super) radius: f64,
    /// Angle from the strip's nominal direction towards greater robot bearings, radians.
    pub(super) deviation: f64,
}

/// What one image shows of the strip.
#[derive(Debug, Clone, Default)]
pub(super) struct DetectedStrip {
    /// Its edges, from the robot outward.
    pub(super) edges: Vec<PolarEdge>,
    /// Metres by which the bars lie nearer than their indices say, by how wide they appear. None if too few bars show their width.
    pub(super) distance_offset: Option<f64>,
}

/// Detects the strip's edges in one image.
pub(super) struct StripEdgeDetector<'a> {
    pub(super) camera: &'a CameraConfig,
    pub(super) image: &'a Image,
    /// Nominal direction of the strip, robot frame, radians.
    pub(super) direction: f64,
    pub(super) first_edge: f64,
    pub(super) spacing: f64,
    pub(super) edge_count: usize,
    pub(super) width: f64,
    pub(super) starts_black: bool,
}

/// Fewest bars whose widths tell where the strip begins.
const WIDTHS_MIN: usize = 4;

/// Sampling step along the strip, pixels.
const PROFILE_STEP_PX: f64 = 0.25;

/// Smallest amplitude of an edge, as a fraction of the profile's range: glare and blur reduce it.
const AMPLITUDE_RATIO_MIN: f64 = 0.18;

/// The middle of a bar across the strip.
#[derive(Debug, Clone, Copy)]
struct BarCentre {
    /// Distance from the axis, pixels.
    radius: f64,
    /// Angle from the strip's nominal direction, radians.
    deviation: f64,
    /// On the ground by its index, metres.
    distance: f64,
    /// How wide the bar appears from the axis, radians.
    width: f64,
}

/// An edge in a radial profile.
#[derive(Debug, Clone, Copy)]
struct ProfileEdge {
    radius: f64,
    rising: bool,
    amplitude: f64,
}

impl StripEdgeDetector<'_> {
    /// All detected edges with their indices, and whether these fit how wide the bars appear.
    pub(super) fn detect(&self) -> DetectedStrip {
        // Deviation of the strip from its direction: offset and slope over the radius, refined iteratively.
        let mut bend = [0.0f64, 0.0];
        let mut found = DetectedStrip::default();
        for _ in 0..6 {
            let numbered = self.number_edges(&self.find_profile_edges(bend));
            let mut distance_offset = None;
            if numbered.len() >= 3 {
                let bars = self.find_bar_centres(&numbered, bend);
                let middles: Vec<[f64; 2]> =
                    bars.iter().map(|bar| [bar.radius, bar.deviation]).collect();
                bend = fit_theil_sen(&middles).unwrap_or(bend);
                distance_offset = find_distance_offset(&bars);
            }
            let edges = numbered.iter();
            found = DetectedStrip {
                edges: edges
                    .map(|&(number, edge)| self.polar(number, edge, bend))
                    .collect(),
                distance_offset,
            };
            if numbered.len() < 3 {
                break;
            }
        }
        found
    }

    fn polar(&self, number: usize, edge: ProfileEdge, bend: [f64; 2]) -> PolarEdge {
        PolarEdge {
            edge_index: number,
            radius: edge.radius,
            deviation: bend[0] + bend[1] * edge.radius,
        }
    }

    fn brightness(&self, radius: f64, deviation: f64) -> Option<f64> {
        let angle = self.direction + deviation;
        let [[ux, uy], [vx, vy]] = self.camera.image_from_robot().map(|row| row.map(f64::from));
        let (cos, sin) = (math::cos(angle), math::sin(angle));
        let u = f64::from(self.camera.centre_px[0]) + radius * (ux * cos + uy * sin);
        let v = f64::from(self.camera.centre_px[1]) + radius * (vx * cos + vy * sin);
        if !(u >= 0.0 && v >= 0.0) {
            return None;
        }
        let (column, row) = (u as usize, v as usize);
        if column + 1 >= self.image.width_px || row + 1 >= self.image.height_px {
            return None;
        }
        if !self.camera.is_inside_mirror(u as f32, v as f32) {
            return None;
        }
        let grey = |column: usize, row: usize| {
            let at = 3 * (row * self.image.width_px + column);
            let [r, g, b] = [0, 1, 2].map(|i| f64::from(self.image.rgb[at + i]));
            (r + g + b) / 3.0
        };
        let (fu, fv) = (u.fract(), v.fract());
        let top = grey(column, row) * (1.0 - fu) + grey(column + 1, row) * fu;
        let bottom = grey(column, row + 1) * (1.0 - fu) + grey(column + 1, row + 1) * fu;
        Some(top * (1.0 - fv) + bottom * fv)
    }

    /// Brightness along the strip's middle, averaged over three pixels across; from the axis outward.
    fn radial_profile(&self, bend: [f64; 2]) -> Vec<f64> {
        let rim = self.image.width_px.max(self.image.height_px) as f64;
        let mut profile = Vec::new();
        for step in 0..(rim / PROFILE_STEP_PX) as usize {
            let radius = step as f64 * PROFILE_STEP_PX;
            let deviation = bend[0] + bend[1] * radius;
            let across = [-1.0, 0.0, 1.0]
                .map(|offset| self.brightness(radius, deviation + offset / radius.max(1.0)));
            let [Some(a), Some(b), Some(c)] = across else {
                break;
            };
            profile.push((a + b + c) / 3.0);
        }
        profile
    }

    /// Half-height crossings between successive extrema of the profile.
    fn find_profile_edges(&self, bend: [f64; 2]) -> Vec<ProfileEdge> {
        let profile = self.radial_profile(bend);
        let span = profile.iter().fold(f64::INFINITY, |a, &b| a.min(b));
        let span = profile.iter().fold(span, |a, &b| a.max(b)) - span;
        let extremes = find_extrema(&profile, AMPLITUDE_RATIO_MIN * span);
        let mut edges = Vec::new();
        for pair in extremes.windows(2) {
            let (from, to) = (pair[0], pair[1]);
            let (a, b) = (profile[from], profile[to]);
            let half = (a + b) / 2.0;
            let crossing =
                (from..to).find(|&i| (profile[i] - half) * (profile[i + 1] - half) <= 0.0);
            let Some(i) = crossing else { continue };
            let part = (half - profile[i]) / (profile[i + 1] - profile[i]);
            let part = if part.is_finite() { part } else { 0.5 };
            edges.push(ProfileEdge {
                radius: (i as f64 + part) * PROFILE_STEP_PX,
                rising: b > a,
                amplitude: (b - a).abs(),
            });
        }
        edges
    }

    /// Assigns indices: the first edge of full amplitude from the first bar to the second is edge 1.
    ///
    /// Spacing changes slowly with the radius; the sequence ends where it does not.
    fn number_edges(&self, edges: &[ProfileEdge]) -> Vec<(usize, ProfileEdge)> {
        let largest = edges.iter().map(|edge| edge.amplitude).fold(0.0, f64::max);
        let full =
            |edge: &ProfileEdge| edge.rising == self.starts_black && edge.amplitude > 0.6 * largest;
        let Some(second) = edges.iter().position(full) else {
            return Vec::new();
        };
        let mut numbered = vec![(1, edges[second])];
        let mut gap = None;
        for &edge in &edges[second + 1..] {
            let (number, last) = numbered[numbered.len() - 1];
            let step = edge.radius - last.radius;
            if number + 1 >= self.edge_count
                || gap.is_some_and(|gap: f64| step < 0.5 * gap || step > 1.8 * gap)
            {
                break;
            }
            gap = Some(step);
            numbered.push((number + 1, edge));
        }
        // The near end borders carpet, not a bar: smaller amplitude, so only its spacing is checked.
        if let (Some(gap), Some(&edge)) = (gap, second.checked_sub(1).and_then(|i| edges.get(i))) {
            let step = edges[second].radius - edge.radius;
            if step > 0.7 * gap && step < 1.4 * gap {
                numbered.insert(0, (0, edge));
            }
        }
        numbered
    }

    /// Centre of the strip across, at the middle of each bar.
    fn find_bar_centres(
        &self,
        numbered: &[(usize, ProfileEdge)],
        bend: [f64; 2],
    ) -> Vec<BarCentre> {
        let mut middles = Vec::new();
        for pair in numbered.windows(2) {
            let ((number, inner), (_, outer)) = (pair[0], pair[1]);
            let distance = self.first_edge + (number as f64 + 0.5) * self.spacing;
            let radius = (inner.radius + outer.radius) / 2.0;
            let expected = bend[0] + bend[1] * radius;
            // Half of the strip's width as an angle; the search covers about twice that.
            let half = math::atan(self.width / 2.0 / distance);
            let steps = (2.2 * half * radius / PROFILE_STEP_PX).ceil() as i64;
            let reach = 0.25 * (outer.radius - inner.radius);
            let across: Vec<Option<f64>> = (-steps..=steps)
                .map(|step| {
                    let deviation = expected + step as f64 * PROFILE_STEP_PX / radius;
                    let [a, b, c] = [-reach, 0.0, reach]
                        .map(|along| self.brightness(radius + along, deviation));
                    Some((a? + b? + c?) / 3.0)
                })
                .collect();
            let Some(across) = across.into_iter().collect::<Option<Vec<f64>>>() else {
                continue;
            };
            let side = |from: i64, to: i64| -> Option<f64> {
                let level = |step: i64| across[(step + steps) as usize];
                let (inside, outside) = (level(0), level(to));
                let half_level = (inside + outside) / 2.0;
                if (inside - outside).abs() < 15.0 {
                    return None;
                }
                let sign = (to - from).signum();
                let mut step = from;
                while step != to {
                    let (here, next) = (level(step), level(step + sign));
                    if (here - half_level) * (next - half_level) <= 0.0 && here != next {
                        return Some(
                            step as f64 + sign as f64 * (half_level - here) / (next - here),
                        );
                    }
                    step += sign;
                }
                None
            };
            if let (Some(left), Some(right)) = (side(0, -steps), side(0, steps)) {
                let width = (right - left) * PROFILE_STEP_PX / radius;
                if (0.6..1.6).contains(&(width / (2.0 * half))) {
                    middles.push(BarCentre {
                        radius,
                        deviation: expected + (left + right) / 2.0 * PROFILE_STEP_PX / radius,
                        distance,
                        width,
                    });
                }
            }
        }
        middles
    }
}

/// Indices of alternating minima and maxima that differ by at least `swing`.
fn find_extrema(values: &[f64], swing: f64) -> Vec<usize> {
    let mut found = Vec::new();
    let (mut low, mut high) = (0, 0);
    let mut rising: Option<bool> = None;
    for (index, &value) in values.iter().enumerate() {
        if rising != Some(false) && value > values[high] {
            high = index;
        }
        if rising != Some(true) && value < values[low] {
            low = index;
        }
        if rising != Some(true) && value - values[low] > swing {
            found.push(low);
            (rising, high) = (Some(true), index);
        } else if rising != Some(false) && values[high] - value > swing {
            found.push(high);
            (rising, low) = (Some(false), index);
        }
    }
    match rising {
        Some(true) => found.push(high),
        Some(false) => found.push(low),
        None => {}
    }
    found
}

/// Metres by which bars lie nearer than their indices say, so that all have one width. A bar at distance d − offset appears as wide as
/// 2 atan(w / 2 (d − offset)): over 1/d, the reciprocal of its width in units of d is a straight line.
fn find_distance_offset(bars: &[BarCentre]) -> Option<f64> {
    if bars.len() < WIDTHS_MIN {
        return None;
    }
    let points: Vec<[f64; 2]> = bars
        .iter()
        .map(|bar| {
            let widths_away = 0.5 / math::tan(bar.width / 2.0);
            [1.0 / bar.distance, widths_away / bar.distance]
        })
        .collect();
    let [offset, slope] = fit_theil_sen(&points)?;
    Some(-slope / offset).filter(|offset| offset.is_finite())
}

/// Offset and slope through points (x, y): median slope over all pairs (Theil–Sen), robust to outliers.
fn fit_theil_sen(points: &[[f64; 2]]) -> Option<[f64; 2]> {
    if points.len() < 4 {
        let offsets: Vec<f64> = points.iter().map(|point| point[1]).collect();
        return median(offsets).map(|offset| [offset, 0.0]);
    }
    let mut slopes = Vec::new();
    for (index, a) in points.iter().enumerate() {
        for b in &points[index + 1..] {
            slopes.push((b[1] - a[1]) / (b[0] - a[0]));
        }
    }
    let slope = median(slopes)?;
    let offset = median(
        points
            .iter()
            .map(|point| point[1] - slope * point[0])
            .collect(),
    )?;
    Some([offset, slope])
}

pub(super) fn median(mut values: Vec<f64>) -> Option<f64> {
    values.retain(|value| value.is_finite());
    if values.is_empty() {
        return None;
    }
    values.sort_by(f64::total_cmp);
    let middle = values.len() / 2;
    Some(if values.len() % 2 == 1 {
        values[middle]
    } else {
        (values[middle - 1] + values[middle]) / 2.0
    })
}
