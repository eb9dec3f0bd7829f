//! Model-free calibration of the ground map from images of the robot turned next to a strip with known edges.
//!
//! nubot2013 3.2 (Voigtländer): no symmetry and no profile of the mirror is assumed, so a tilted mirror calibrates too.

use localize::math;

use crate::calibrate::polar_map::{FourierSeries, PolarMap};
use crate::calibrate::repeated_images::repeated_images;
use crate::calibrate::strip_edges::{PolarEdge, StripEdgeDetector, median};
use crate::calibrate::strip_target::{BarColour, Strip};
use crate::calibrate::{CalibrationError, Correspondence, ImageResidual};
use crate::image::Image;
use crate::optics::ground_map::GroundMap;
use localize::robot::CameraConfig;

/// One image of the strip.
#[derive(Debug, Clone)]
pub struct StripImage {
    /// Its file, for messages.
    pub name: String,
    /// Direction of the strip, robot frame, radians.
    pub direction: f64,
    /// The image.
    pub image: Image,
}

/// The map and its residuals.
#[derive(Debug, Clone)]
pub struct StripCalibration {
    /// The ground map.
    pub map: GroundMap,
    /// One per image.
    pub images: Vec<ImageResidual>,
    /// Root mean square of all used points' distances from the fit in the image, pixels.
    pub rms_px: f64,
    /// Detected edges of the used images.
    pub points: Vec<Correspondence>,
}

/// Fewest directions that separate a tilt from noise.
const IMAGES_MIN: usize = 8;

/// Fewest edges that give a map along the radius.
const RINGS_MIN: usize = 4;

/// Harmonics around the circle: one for offset, two for tilt, the rest for a mirror that is not round.
const HARMONICS_MAX: usize = 4;

/// An image whose edges lie farther from where the others say, by the median, is excluded, pixels.
const IMAGE_RESIDUAL_MAX_PX: f64 = 2.0;

/// A single edge with a larger residual is an outlier, pixels.
const EDGE_RESIDUAL_MAX_PX: f64 = 1.0;

/// Calibrates the map; inconsistent images are excluded and named.
pub fn calibrate_strip(
    camera: &CameraConfig,
    strip: &Strip,
    images: &[StripImage],
) -> Result<StripCalibration, CalibrationError> {
    strip.check()?;
    let mut edges_by_image = Vec::with_capacity(images.len());
    let mut distance_offsets = Vec::with_capacity(images.len());
    for image in images {
        image
            .image
            .view()
            .check(camera.width_px, camera.height_px)
            .map_err(|source| CalibrationError::Image {
                name: image.name.clone(),
                source,
            })?;
        let search = StripEdgeDetector {
            camera,
            image: &image.image,
            direction: image.direction,
            first_edge: strip.first_edge,
            spacing: strip.spacing,
            edge_count: strip.bars + 1,
            width: strip.width,
            starts_black: strip.first_bar == BarColour::Black,
        };
        let found = search.detect();
        distance_offsets.extend(found.distance_offset);
        edges_by_image.push(found.edges);
    }
    ensure_bars_are_numbered(strip, distance_offsets)?;
    let repeated = repeated_images(images.iter().map(|image| &image.image));
    let mut left_out: Vec<Option<String>> = edges_by_image
        .iter()
        .zip(repeated)
        .map(|(edges, repeated)| {
            if let Some(first) = repeated {
                return Some(format!("the same picture as {}", images[first].name));
            }
            (edges.len() < RINGS_MIN).then(|| {
                format!(
                    "too few edges of the strip: {} (expected at least {RINGS_MIN})",
                    edges.len()
                )
            })
        })
        .collect();
    // Exclude images one by one, the worst first, since an outlier affects the fit of all.
    loop {
        let rings = fit_rings(strip, images, &edges_by_image, &left_out);
        let rings = rings.ok_or_else(|| too_little_seen(&left_out))?;
        let offs: Vec<Option<f64>> = (0..images.len())
            .map(|index| {
                let offs = edges_by_image[index].iter().filter_map(|edge| {
                    let ring = rings
                        .iter()
                        .find(|ring| ring.edge_index == edge.edge_index)?;
                    Some(ring.distance_px(images[index].direction, edge))
                });
                median(offs.collect()).filter(|_| left_out[index].is_none())
            })
            .collect();
        let worst = (0..images.len())
            .filter_map(|index| offs[index].map(|off| (index, off)))
            .max_by(|a, b| a.1.total_cmp(&b.1));
        match worst {
            Some((index, off)) if off > IMAGE_RESIDUAL_MAX_PX => {
                left_out[index] = Some(format!(
                    "its edges lie {off:.1} pixels from where the other images say: is its direction right?"
                ));
            }
            _ => {
                return Ok(build_calibration(
                    camera,
                    strip,
                    images,
                    &edges_by_image,
                    left_out,
                    &rings,
                ));
            }
        }
    }
}

/// The bars must be where strip.toml says by how wide they appear. `distance_offsets`: by which they are nearer, metres, of each image.
///
/// A bar's place is known by its number alone: a first bar of the wrong colour moves all of them by one.
fn ensure_bars_are_numbered(
    strip: &Strip,
    distance_offsets: Vec<f64>,
) -> Result<(), CalibrationError> {
    match median(distance_offsets) {
        Some(offset) if offset.abs() > 0.5 * strip.spacing => {
            Err(CalibrationError::StripElsewhere { nearer: offset })
        }
        _ => Ok(()),
    }
}

fn too_little_seen(left_out: &[Option<String>]) -> CalibrationError {
    let reasons: Vec<&str> = left_out
        .iter()
        .flatten()
        .map(String::as_str)
        .take(3)
        .collect();
    let reasons = reasons.join("; ");
    let used = left_out.iter().filter(|reason| reason.is_none()).count();
    if used >= IMAGES_MIN {
        return CalibrationError::Undecided(format!(
            "fewer than {RINGS_MIN} edges of the strip are seen in half of the {used} usable images. {reasons}"
        ));
    }
    CalibrationError::TooFewImages {
        used,
        total: left_out.len(),
        required: IMAGES_MIN,
        reasons,
    }
}

/// One edge of the strip as a function of the direction.
struct EdgeRing {
    edge_index: usize,
    radius: FourierSeries,
    deviation: FourierSeries,
}

impl EdgeRing {
    /// Distance of an edge in the image of a direction from where the fit says, pixels.
    fn distance_px(&self, direction: f64, edge: &PolarEdge) -> f64 {
        let along = edge.radius - self.radius.evaluate(direction);
        let across = edge.radius * (edge.deviation - self.deviation.evaluate(direction));
        math::hypot(along, across)
    }
}

/// Fits each edge's radius and deviation over the directions. None if too few images remain.
fn fit_rings(
    strip: &Strip,
    images: &[StripImage],
    edges_by_image: &[Vec<PolarEdge>],
    left_out: &[Option<String>],
) -> Option<Vec<EdgeRing>> {
    let used = left_out.iter().filter(|reason| reason.is_none()).count();
    if used < IMAGES_MIN {
        return None;
    }
    let mut rings: Vec<EdgeRing> = Vec::new();
    for number in 0..=strip.bars {
        let all: Vec<(f64, PolarEdge)> = (0..images.len())
            .filter(|&index| left_out[index].is_none())
            .filter_map(|index| {
                let edge = edges_by_image[index]
                    .iter()
                    .find(|edge| edge.edge_index == number)?;
                Some((images[index].direction, *edge))
            })
            .collect();
        if all.len() < IMAGES_MIN || 2 * all.len() < used {
            continue;
        }
        let order = HARMONICS_MAX.min((all.len() - 1) / 4);
        let Some(radius) = fit_robust_periodic(&all, order, |edge| edge.radius, |_| 1.0) else {
            continue;
        };
        let Some(deviation) =
            fit_robust_periodic(&all, order, |edge| edge.deviation, |edge| edge.radius)
        else {
            continue;
        };
        rings.push(EdgeRing {
            edge_index: number,
            radius,
            deviation,
        });
    }
    (rings.len() >= RINGS_MIN).then_some(rings)
}

/// A periodic fit that drops wrong readings; `pixels` turns a residual into pixels.
fn fit_robust_periodic(
    edges: &[(f64, PolarEdge)],
    order: usize,
    value: impl Fn(&PolarEdge) -> f64,
    pixels: impl Fn(&PolarEdge) -> f64,
) -> Option<FourierSeries> {
    let mut kept: Vec<&(f64, PolarEdge)> = edges.iter().collect();
    loop {
        let points: Vec<[f64; 2]> = kept
            .iter()
            .map(|(angle, edge)| [*angle, value(edge)])
            .collect();
        let fit = FourierSeries::fit(&points, order)?;
        let off = |(angle, edge): &(f64, PolarEdge)| {
            ((value(edge) - fit.evaluate(*angle)) * pixels(edge)).abs()
        };
        let worst = kept
            .iter()
            .enumerate()
            .map(|(index, edge)| (index, off(edge)))
            .max_by(|a, b| a.1.total_cmp(&b.1))?;
        // Keep as many edges as the fit needs.
        if worst.1 <= EDGE_RESIDUAL_MAX_PX || kept.len() <= (2 * order + 1).max(edges.len() * 2 / 3)
        {
            return Some(fit);
        }
        kept.remove(worst.0);
    }
}

fn build_calibration(
    camera: &CameraConfig,
    strip: &Strip,
    images: &[StripImage],
    edges_by_image: &[Vec<PolarEdge>],
    left_out: Vec<Option<String>>,
    rings: &[EdgeRing],
) -> StripCalibration {
    let distance = |number: usize| strip.first_edge + number as f64 * strip.spacing;
    let (mut residuals, mut points) = (Vec::new(), Vec::new());
    let (mut sum, mut count) = (0.0, 0);
    for ((image, edges), left_out) in images.iter().zip(edges_by_image).zip(left_out) {
        let offs: Vec<f64> = edges
            .iter()
            .filter_map(|edge| {
                let ring = rings
                    .iter()
                    .find(|ring| ring.edge_index == edge.edge_index)?;
                Some(ring.distance_px(image.direction, edge))
            })
            .collect();
        let squares: f64 = offs.iter().map(|off| off * off).sum();
        if left_out.is_none() {
            sum += squares;
            count += offs.len();
            points.extend(edges.iter().map(|edge| {
                let angle = image.direction + edge.deviation;
                let [[ux, uy], [vx, vy]] = camera.image_from_robot().map(|row| row.map(f64::from));
                let (cos, sin) = (
                    edge.radius * math::cos(angle),
                    edge.radius * math::sin(angle),
                );
                let reach = distance(edge.edge_index);
                Correspondence {
                    position_px: [
                        f64::from(camera.centre_px[0]) + ux * cos + uy * sin,
                        f64::from(camera.centre_px[1]) + vx * cos + vy * sin,
                    ],
                    ground: [
                        reach * math::cos(image.direction),
                        reach * math::sin(image.direction),
                    ],
                }
            }));
        }
        residuals.push(ImageResidual {
            name: image.name.clone(),
            points: edges.len(),
            rms_px: (squares / offs.len().max(1) as f64).sqrt(),
            left_out,
        });
    }
    let polar = PolarMap {
        distances: rings.iter().map(|ring| distance(ring.edge_index)).collect(),
        radii: rings.iter().map(|ring| ring.radius.clone()).collect(),
        deviations: rings.iter().map(|ring| ring.deviation.clone()).collect(),
    };
    StripCalibration {
        map: polar.ground_map(camera),
        images: residuals,
        rms_px: (sum / f64::from(count.max(1) as u32)).sqrt(),
        points,
    }
}
