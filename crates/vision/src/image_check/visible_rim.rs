//! Where is the mirror's rim in the images of a camera whose set-up says where it should be?
//!
//! Beyond the rim a picture stays dark, whatever the mirror shows. So the brightest values of some pixels about the stated circle
//! separate the two. They cost little enough to be kept while a robot drives.

use crate::calibrate::Rim;
use crate::calibrate::rim::fit_edges;
use crate::image::ImageView;
use localize::math;
use localize::robot::CameraConfig;

use super::mounting::brightest_channel;

/// Directions and radii at which an image is read.
const ANGLES: usize = 180;
const RADII: usize = 61;
/// The first and last radius, shares of the stated one.
const RADIUS_RANGE: [f32; 2] = [0.88, 1.12];
/// Half the distance over which a fall of the values is measured, radii.
const FALL: usize = 2;
/// The rim is the outermost fall that is at least this share of the steepest one in its direction.
const STEEP_SHARE: f32 = 0.5;
/// Least contrast of the rim, levels.
const CONTRAST_MIN: f32 = 8.0;
/// Directions in which a rim must be seen, of those inside the image.
const VISIBLE_MIN: f32 = 0.5;
/// A circle whose radius differs by more than this share from the stated one is no image of the rim.
const RADIUS_TOLERANCE: f32 = 0.03;

/// The brightest values of the pixels about the stated rim.
#[derive(Debug, Clone)]
pub struct VisibleRim {
    size: [usize; 2],
    centre_px: [f32; 2],
    radius_px: f32,
    /// Pixels by angle, then radius. None outside the image.
    pixels: Vec<Option<[u16; 2]>>,
    brightest: Vec<f32>,
    images: u32,
}

/// Images that are joined, of which so many lie between two.
const JOINED_IMAGES: u32 = 40;
const IMAGE_INTERVAL: u32 = 8;

/// The rim in the last images of a drive, during which the camera may be pushed.
#[derive(Debug, Clone)]
pub(super) struct RecentRim {
    empty: VisibleRim,
    present: VisibleRim,
    before: VisibleRim,
    skipped: u32,
}

impl RecentRim {
    /// None for a camera whose set-up states no rim. `size`: of the images, pixels.
    pub(super) fn new(camera: &CameraConfig, size: [usize; 2]) -> Option<Self> {
        let empty = VisibleRim::new(camera, size)?;
        Some(RecentRim {
            present: empty.clone(),
            before: empty.clone(),
            empty,
            skipped: 0,
        })
    }

    /// The next image of the drive.
    pub(super) fn add(&mut self, image: &ImageView<'_>) {
        self.skipped = (self.skipped + 1) % IMAGE_INTERVAL;
        if self.skipped != 0 {
            return;
        }
        if self.present.images >= JOINED_IMAGES {
            self.before = std::mem::replace(&mut self.present, self.empty.clone());
        }
        self.present.add(image);
    }

    /// None where too little of it is seen, or another circle.
    pub(super) fn find(&self) -> Option<Rim> {
        let is_enough = 2 * self.present.images >= JOINED_IMAGES;
        let rim = if is_enough {
            &self.present
        } else {
            &self.before
        };
        rim.find()
    }
}

impl VisibleRim {
    /// None for a camera whose set-up states no rim. `size`: of the images, pixels.
    pub fn new(camera: &CameraConfig, size: [usize; 2]) -> Option<Self> {
        let (centre_px, radius_px) = (camera.centre_px, camera.outer_radius_px?);
        let mut rim = VisibleRim {
            size,
            centre_px,
            radius_px,
            pixels: Vec::new(),
            brightest: vec![0.0; ANGLES * RADII],
            images: 0,
        };
        let pixel = |index: usize| {
            let at = rim.place((index / RADII) as f32, (index % RADII) as f32);
            let [u, v] = at.map(f32::round);
            let inside = (0.0..size[0] as f32).contains(&u) && (0.0..size[1] as f32).contains(&v);
            inside.then_some([u as u16, v as u16])
        };
        rim.pixels = (0..ANGLES * RADII).map(pixel).collect();
        Some(rim)
    }

    /// Adds an image. One of another size than stated is left out.
    pub fn add(&mut self, image: &ImageView<'_>) {
        if image.check(self.size[0], self.size[1]).is_err() {
            return;
        }
        self.images += 1;
        for (brightest, pixel) in self.brightest.iter_mut().zip(&self.pixels) {
            if let Some(pixel) = pixel {
                *brightest = brightest.max(brightest_channel(image, *pixel));
            }
        }
    }

    /// The rim in the images so far. None where too little of it is seen, or another circle.
    pub fn find(&self) -> Option<Rim> {
        let is_inside = |pixels: &&[Option<[u16; 2]>]| pixels.iter().all(Option::is_some);
        let inside = self.pixels.chunks(RADII).filter(is_inside).count();
        let profiles = self.pixels.chunks(RADII).zip(self.brightest.chunks(RADII));
        let edges = profiles
            .enumerate()
            .filter_map(|(angle, (pixels, values))| {
                let known = pixels.iter().take_while(|pixel| pixel.is_some()).count();
                Some(self.place(angle as f32, outermost_fall(&values[..known])?))
            });
        let edges: Vec<[f32; 2]> = edges.collect();
        let (rim, inliers) = fit_edges(&edges, self.size).ok()?;
        let is_rim = inliers.len() as f32 >= VISIBLE_MIN * inside as f32
            && (rim.radius_px / self.radius_px - 1.0).abs() <= RADIUS_TOLERANCE;
        is_rim.then_some(rim)
    }

    /// Column and row at an angle and a radius, in steps.
    fn place(&self, angle: f32, radius: f32) -> [f32; 2] {
        let (sin, cos) = math::sin_cos(std::f32::consts::TAU * angle / ANGLES as f32);
        let [near, far] = RADIUS_RANGE;
        let share = near + (far - near) * radius / (RADII - 1) as f32;
        let [u, v] = self.centre_px;
        [
            u + share * self.radius_px * cos,
            v + share * self.radius_px * sin,
        ]
    }
}

/// Where the values of growing radii fall steeply for the last time, in steps.
fn outermost_fall(values: &[f32]) -> Option<f32> {
    let falls: Vec<f32> = values
        .windows(2 * FALL + 1)
        .map(|window| window[0] - window[2 * FALL])
        .collect();
    let steepest = falls.iter().copied().fold(CONTRAST_MIN, f32::max);
    let last = falls
        .iter()
        .rposition(|fall| *fall >= STEEP_SHARE * steepest)?;
    // The fall's own summit, and its middle between steps.
    let rising = falls[..=last].windows(2).rev();
    let summit = last - rising.take_while(|pair| pair[0] >= pair[1]).count();
    let at = |index: usize| falls.get(index).copied().unwrap_or(0.0);
    let [before, here, after] = [summit.wrapping_sub(1), summit, summit + 1].map(at);
    let curvature = before - 2.0 * here + after;
    let offset = match curvature < 0.0 {
        true => (0.5 * (before - after) / curvature).clamp(-0.5, 0.5),
        false => 0.0,
    };
    Some((summit + FALL) as f32 + offset)
}
