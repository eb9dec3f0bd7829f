//! Where is the mirror's rim in the images? Pictures of one camera in, a circle out.
//!
//! Outside the rim a picture stays dark, whatever the mirror shows. So the brightest values of each pixel over all pictures
//! separate the two better than any single picture; the very brightest may be those of a picture that does not belong here.
//! Corners of the image often show the only arcs of the rim.

use crate::image::Image;
use localize::math;

/// The mirror's rim in the image.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Rim {
    /// Centre: column and row, pixels.
    pub centre_px: [f32; 2],
    /// Radius, pixels.
    pub radius_px: f32,
    /// Root mean square distance of the edge points from the circle, pixels.
    pub rms_px: f32,
    /// Part of the circle at which an edge was found, of the part inside the image.
    pub visible_share: f32,
}

/// Why no rim is found.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum RimError {
    /// No image, or images of different sizes.
    #[error("no images of one size (expected at least one)")]
    NoImages,
    /// No dark border around the mirror.
    #[error("no dark border around the mirror. The rim is hidden, or the mirror fills the image")]
    NoBorder,
    /// The edges of the dark border lie on no circle.
    #[error("the edge of the dark border is not a circle: {percent} % of it lies on the best one")]
    NotACircle {
        /// Edge points on the best circle, of all.
        percent: u32,
    },
}

/// Directions from the image's centre in which the edge is sought.
const DIRECTIONS: usize = 720;

/// Distance of an edge point on the circle, pixels: a blurred rim is this wide.
const TOLERANCE_PX: f32 = 2.5;

/// Width of the halo of stray light beyond the rim, as a share of its radius.
const HALO_SHARE: f32 = 0.08;

/// Half the distance over which a fall of the values is measured, pixels.
const FALL_PX: f32 = 2.0;

/// The rim is the outermost fall that is at least this share of the steepest one: the scene near it has edges, too.
const STEEP_SHARE: f32 = 0.5;

/// Least contrast of the rim, levels.
const CONTRAST_MIN: f32 = 8.0;

/// Fewest edge points that determine a circle.
const POINTS_MIN: usize = 24;

/// One in so many pictures may be bright beyond the rim: broken, or of another camera.
const FOREIGN_INTERVAL: usize = 8;
const FOREIGN_MAX: usize = 7;

/// Fits the rim's circle to pictures of one camera.
pub fn find_rim(images: &[&Image]) -> Result<Rim, RimError> {
    let first = images.first().ok_or(RimError::NoImages)?;
    let size = [first.width_px, first.height_px];
    if images
        .iter()
        .any(|image| [image.width_px, image.height_px] != size)
    {
        return Err(RimError::NoImages);
    }
    let foreign = (images.len() / FOREIGN_INTERVAL).min(FOREIGN_MAX);
    let brightest = brightest_values(images, size, foreign);
    let fit = |rank: usize| {
        let values: Vec<f32> = brightest.iter().map(|values| values[rank]).collect();
        fit_rim(&values, size)
    };
    match (fit(0), fit(foreign)) {
        // Nothing is foreign: all pictures show more of the rim than some of them.
        (Ok(all), Ok(rest)) if is_same_circle(&all, &rest) => Ok(all),
        (all, rest) => rest.or(all),
    }
}

fn is_same_circle(a: &Rim, b: &Rim) -> bool {
    let [du, dv] = [0, 1].map(|axis| a.centre_px[axis] - b.centre_px[axis]);
    math::hypot(du, dv) + (a.radius_px - b.radius_px).abs() <= TOLERANCE_PX
}

/// Fits the rim's circle to the values of pixels that stay dark outside it.
fn fit_rim(brightest: &[f32], size: [usize; 2]) -> Result<Rim, RimError> {
    let edges = border_edges(brightest, size);
    if edges.len() < POINTS_MIN {
        return Err(RimError::NoBorder);
    }
    let (rim, inliers) = fit_edges(&edges, size)?;
    let [u, v] = rim.centre_px;
    let circle = [u, v, rim.radius_px];
    let inside = circle_points(circle)
        .filter(|[u, v]| {
            let margin = TOLERANCE_PX;
            (margin..size[0] as f32 - 1.0 - margin).contains(u)
                && (margin..size[1] as f32 - 1.0 - margin).contains(v)
        })
        .count();
    let found = circle_points(circle)
        .filter(|at| {
            inliers
                .iter()
                .any(|edge| math::hypot(edge[0] - at[0], edge[1] - at[1]) < 2.0 * TOLERANCE_PX)
        })
        .count();
    Ok(Rim {
        visible_share: found as f32 / inside.max(1) as f32,
        ..rim
    })
}

/// The circle that most edge points lie on, and these points. `size`: of the image, pixels. The visible share is that of the edge points.
pub(crate) fn fit_edges(
    edges: &[[f32; 2]],
    size: [usize; 2],
) -> Result<(Rim, Vec<[f32; 2]>), RimError> {
    if edges.len() < POINTS_MIN {
        return Err(RimError::NotACircle { percent: 0 });
    }
    let circle = best_circle(edges, size).ok_or(RimError::NotACircle { percent: 0 })?;
    let is_on = |point: &&[f32; 2]| distance(circle, **point).abs() <= TOLERANCE_PX;
    let inliers: Vec<[f32; 2]> = edges.iter().filter(is_on).copied().collect();
    let share = inliers.len() as f32 / edges.len() as f32;
    if inliers.len() < POINTS_MIN || share < 0.3 {
        return Err(RimError::NotACircle {
            percent: (100.0 * share) as u32,
        });
    }
    let [u, v, radius] = fit_circle(&inliers).unwrap_or(circle);
    let off = |at: &[f32; 2]| distance([u, v, radius], *at).powi(2);
    let rim = Rim {
        centre_px: [u, v],
        radius_px: radius,
        rms_px: (inliers.iter().map(off).sum::<f32>() / inliers.len() as f32).sqrt(),
        visible_share: share,
    };
    Ok((rim, inliers))
}

/// The `foreign` + 1 brightest values of each pixel over all images, falling: of its brightest channel, averaged over 3 × 3
/// pixels before, as single hot pixels would make the border bright.
fn brightest_values(
    images: &[&Image],
    [width, height]: [usize; 2],
    foreign: usize,
) -> Vec<[f32; FOREIGN_MAX + 1]> {
    let mut brightest = vec![[0.0f32; FOREIGN_MAX + 1]; width * height];
    for image in images {
        let value: Vec<f32> = image
            .rgb
            .chunks_exact(3)
            .map(|rgb| f32::from(rgb[0].max(rgb[1]).max(rgb[2])))
            .collect();
        for v in 0..height {
            let rows = v.saturating_sub(1)..(v + 2).min(height);
            for u in 0..width {
                let columns = u.saturating_sub(1)..(u + 2).min(width);
                let count = (rows.len() * columns.len()) as f32;
                let sum: f32 = rows
                    .clone()
                    .map(|row| {
                        value[row * width + columns.start..row * width + columns.end]
                            .iter()
                            .sum::<f32>()
                    })
                    .sum();
                let mut value = sum / count;
                for place in &mut brightest[v * width + u][..=foreign] {
                    if value > *place {
                        std::mem::swap(place, &mut value);
                    }
                }
            }
        }
    }
    brightest
}

/// Outermost points, seen from the image's centre, beyond which the image stays dark. Stray light makes a halo beyond the rim,
/// so the steepest fall near the outermost bright value is the edge.
fn border_edges(brightest: &[f32], [width, height]: [usize; 2]) -> Vec<[f32; 2]> {
    let mut sorted = brightest.to_vec();
    sorted.sort_by(f32::total_cmp);
    let quantile = |share: f32| sorted[(share * (sorted.len() - 1) as f32) as usize];
    // The border's level is that of the darkest pixels; noise and stray light raise it a little.
    let (dark, bright) = (quantile(0.01), quantile(0.5));
    let threshold = dark + (0.2 * (bright - dark)).max(CONTRAST_MIN);
    let centre = [(width as f32 - 1.0) / 2.0, (height as f32 - 1.0) / 2.0];
    let mut edges = Vec::new();
    for direction in 0..DIRECTIONS {
        let (sin, cos) =
            math::sin_cos(std::f32::consts::TAU * direction as f32 / DIRECTIONS as f32);
        let at = |radius: f32| {
            let (u, v) = (centre[0] + radius * cos, centre[1] + radius * sin);
            let inside =
                u >= 0.0 && v >= 0.0 && u <= width as f32 - 1.0 && v <= height as f32 - 1.0;
            inside.then(|| brightest[v.round() as usize * width + u.round() as usize])
        };
        let mut radius = 0.0;
        while at(radius + 1.0).is_some() {
            radius += 1.0;
        }
        let end = radius;
        // Inward from the image's edge, to the first value above the threshold.
        while radius > 0.0 && at(radius).is_some_and(|value| value < threshold) {
            radius -= 1.0;
        }
        // A border narrower than this is the darkening at the image's edge.
        if end - radius < 4.0 || radius <= 0.25 * end {
            continue;
        }
        let edge = steepest_fall(at, radius);
        edges.push([centre[0] + edge * cos, centre[1] + edge * sin]);
    }
    edges
}

/// Radius of the outermost steep fall of a ray's values, from a radius beyond it inward, to a fraction of a pixel.
fn steepest_fall(at: impl Fn(f32) -> Option<f32>, outermost: f32) -> f32 {
    let fall = |radius: f32| Some(at(radius - FALL_PX)? - at(radius + FALL_PX)?);
    let reach = (HALO_SHARE * outermost).max(2.0 * FALL_PX) as usize;
    let radii = (0..=reach).map(|step| outermost + FALL_PX - step as f32);
    let falls: Vec<(f32, f32)> = radii
        .filter_map(|radius| Some((radius, fall(radius)?)))
        .collect();
    let steepest = falls.iter().fold(0.0f32, |most, &(_, fall)| most.max(fall));
    let Some(first) = falls
        .iter()
        .position(|&(_, fall)| fall >= STEEP_SHARE * steepest)
    else {
        return outermost;
    };
    // The fall's own summit, and its middle between samples.
    let rest = &falls[first..];
    let rising = rest.windows(2).take_while(|pair| pair[1].1 >= pair[0].1);
    let summit = first + rising.count();
    let [before, here, after] = [summit.wrapping_sub(1), summit, summit + 1]
        .map(|index| falls.get(index).map_or(0.0, |&(_, fall)| fall));
    let curvature = before - 2.0 * here + after;
    let offset = match curvature < 0.0 {
        true => (0.5 * (before - after) / curvature).clamp(-0.5, 0.5),
        false => 0.0,
    };
    falls[summit].0 - offset
}

/// The circle (column, row, radius) through three of the points that most points lie on.
fn best_circle(points: &[[f32; 2]], [width, height]: [usize; 2]) -> Option<[f32; 3]> {
    let least = 0.25 * width.min(height) as f32;
    let most = width.max(height) as f32;
    let mut state = 1u64;
    let mut draw = || {
        state = state
            .wrapping_mul(6_364_136_223_846_793_005)
            .wrapping_add(1_442_695_040_888_963_407);
        (state >> 33) as usize % points.len()
    };
    let mut best: Option<(usize, [f32; 3])> = None;
    for _ in 0..3000 {
        let Some(circle) = circle_through([points[draw()], points[draw()], points[draw()]]) else {
            continue;
        };
        let [u, v, radius] = circle;
        let near_centre = (u - width as f32 / 2.0).abs() < 0.25 * width as f32
            && (v - height as f32 / 2.0).abs() < 0.25 * height as f32;
        if !(least..most).contains(&radius) || !near_centre {
            continue;
        }
        let on = points
            .iter()
            .filter(|point| distance(circle, **point).abs() <= TOLERANCE_PX)
            .count();
        if best.is_none_or(|(most, _)| on > most) {
            best = Some((on, circle));
        }
    }
    best.map(|(_, circle)| circle)
}

fn circle_through([a, b, c]: [[f32; 2]; 3]) -> Option<[f32; 3]> {
    let (bx, by) = (b[0] - a[0], b[1] - a[1]);
    let (cx, cy) = (c[0] - a[0], c[1] - a[1]);
    let twice_area = 2.0 * (bx * cy - by * cx);
    // Nearly collinear points determine no circle.
    if twice_area.abs() < 100.0 {
        return None;
    }
    let (b2, c2) = (bx * bx + by * by, cx * cx + cy * cy);
    let (x, y) = (
        (cy * b2 - by * c2) / twice_area,
        (bx * c2 - cx * b2) / twice_area,
    );
    Some([a[0] + x, a[1] + y, math::hypot(x, y)])
}

/// Least squares circle, by Gauss-Newton on the distances.
fn fit_circle(points: &[[f32; 2]]) -> Option<[f32; 3]> {
    use nalgebra::{Matrix3, Vector3};
    let mean = |axis: usize| points.iter().map(|p| p[axis]).sum::<f32>() / points.len() as f32;
    let start = [mean(0), mean(1)];
    let radius = points
        .iter()
        .map(|p| math::hypot(p[0] - start[0], p[1] - start[1]))
        .sum::<f32>()
        / points.len() as f32;
    let mut circle = Vector3::new(start[0], start[1], radius);
    for _ in 0..50 {
        let mut normal = Matrix3::<f32>::zeros();
        let mut gradient = Vector3::<f32>::zeros();
        for point in points {
            let (du, dv) = (point[0] - circle[0], point[1] - circle[1]);
            let range = math::hypot(du, dv).max(1e-3);
            let row = Vector3::new(-du / range, -dv / range, -1.0);
            normal += row * row.transpose();
            gradient += row * (range - circle[2]);
        }
        let step = normal.try_inverse()? * gradient;
        circle -= step;
        if step.amax() < 1e-4 {
            break;
        }
    }
    circle
        .iter()
        .all(|value| value.is_finite())
        .then(|| [circle[0], circle[1], circle[2]])
}

fn distance([u, v, radius]: [f32; 3], point: [f32; 2]) -> f32 {
    math::hypot(point[0] - u, point[1] - v) - radius
}

/// Points of the circle, half a degree apart.
fn circle_points([u, v, radius]: [f32; 3]) -> impl Iterator<Item = [f32; 2]> {
    (0..DIRECTIONS).map(move |direction| {
        let (sin, cos) =
            math::sin_cos(std::f32::consts::TAU * direction as f32 / DIRECTIONS as f32);
        [u + radius * cos, v + radius * sin]
    })
}
