//! Is this an image of the field at all? Names images that are dark, blank, incomplete, torn, repeated or turned.
//!
//! The check reads a few thousand pixels that show ground in the map. Each fault contradicts what every working camera
//! delivers: noise in each pixel, contrast on the floor, rows that follow each other, and a robot that stays where it is
//! in its own image.

mod mounting;
mod repeats;
mod rows;
mod samples;
mod seam;
mod visible_rim;

use localize::Stamp;
use localize::robot::CameraConfig;

use crate::calibrate::Rim;
use crate::config::ImageCheckConfig;
use crate::image::ImageView;
use crate::optics::ground_map::GroundMap;
use mounting::MountingCheck;
use repeats::Repeats;
use rows::SampledRows;
use seam::SeamFinder;
use visible_rim::RecentRim;
pub use visible_rim::VisibleRim;

/// Why an image is not used.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
pub enum ImageFault {
    /// No light reaches the sensor.
    #[error(
        "the image is dark: 99 % of it is {} (lens cap, light off, or exposure too short)",
        darkness(*level)
    )]
    Dark {
        /// Brightness that 99 % of the samples do not exceed.
        level: f32,
    },
    /// All samples are saturated.
    #[error("the image is white (overexposed)")]
    White,
    /// Nothing on the floor differs from the rest of it.
    #[error(
        "the image shows no contrast: {contrast:.1} of 255 on the floor (covered lens, or light off)"
    )]
    Blank {
        /// Difference of the floor's brightness.
        contrast: f32,
    },
    /// Rows without content.
    #[error("the image is incomplete: rows {first} to {last} have no content")]
    Incomplete {
        /// First row.
        first: usize,
        /// Last row.
        last: usize,
    },
    /// The same image again.
    #[error("the image repeats the one before, to the bit (frozen camera)")]
    Frozen,
    /// An earlier image again.
    #[error("the image repeats an earlier one (the camera or its driver delivers old images)")]
    Old,
    /// Some rows of the image before.
    #[error("the image is torn: rows {first} to {last} repeat the image before")]
    Stale {
        /// First row.
        first: usize,
        /// Last row.
        last: usize,
    },
    /// Two parts that do not fit.
    #[error("the image is torn: row {row} does not continue the one above")]
    Seam {
        /// First row of the lower part.
        row: usize,
    },
    /// The robot's own parts have turned in the image.
    #[error("the camera is turned by {turn_deg}° against earlier images (check its mount)")]
    Turned {
        /// Rotation in the image, counter-clockwise.
        turn_deg: u32,
    },
}

/// A brightness that is not exceeded, in words.
fn darkness(level: f32) -> String {
    if level < 1.0 {
        "black (0 of 255)".to_owned()
    } else {
        format!("no brighter than {level:.0} of 255")
    }
}

/// Longer gaps separate images that need not follow each other, seconds.
const SEQUENCE_GAP_MAX: f64 = 1.0;

/// Checks the images of one camera in their order.
#[derive(Debug, Clone)]
pub struct ImageCheck {
    config: ImageCheckConfig,
    rows: SampledRows,
    repeats: Repeats,
    seam: SeamFinder,
    mounting: MountingCheck,
    rim: Option<RecentRim>,
    last_stamp: Option<Stamp>,
    /// The image that was checked last has no fault of its own.
    is_usable: bool,
}

impl ImageCheck {
    /// Selects the samples: pixels that show ground.
    pub fn new(map: &GroundMap, camera: &CameraConfig, config: ImageCheckConfig) -> Self {
        ImageCheck {
            config,
            rows: SampledRows::new(map),
            repeats: Repeats::default(),
            seam: SeamFinder::default(),
            mounting: MountingCheck::new(map, camera),
            rim: RecentRim::new(camera, [map.width_px, map.height_px]),
            last_stamp: None,
            is_usable: false,
        }
    }

    /// The image's first fault, or that of the camera's mount in earlier ones. Images of another size than the map's are not
    /// judged. `path`: of the wheels up to now, metres, turns included; constant without wheels.
    pub fn check(&mut self, stamp: Stamp, image: &ImageView<'_>, path: f64) -> Option<ImageFault> {
        let (width_px, height_px) = self.rows.size_px();
        if !self.config.enabled || image.check(width_px, height_px).is_err() {
            return None;
        }
        let follows = self
            .last_stamp
            .replace(stamp)
            .is_some_and(|last| (0.0..=SEQUENCE_GAP_MAX).contains(&(stamp - last)));
        if !follows {
            self.mounting.restart_run();
            self.repeats.restart();
        }
        self.rows.read(image, follows);
        let is_old = self.repeats.add(&self.rows, path);
        let fault = self.fault_of_rows(image, is_old);
        self.is_usable = fault.is_none();
        fault.or(self
            .mounting
            .turn_deg()
            .map(|turn_deg| ImageFault::Turned { turn_deg }))
    }

    /// Looks for the robot's own parts in the image that was checked last. It takes several images to tell that they have
    /// turned, so this need not hold up the pose of each: the next check says what was found. `heading`: of the robot on the field in this
    /// image, radians. None if it is not known.
    pub fn check_mounting(&mut self, image: &ImageView<'_>, heading: Option<f32>) {
        if std::mem::take(&mut self.is_usable) {
            self.mounting.update(image, heading);
            if let Some(rim) = &mut self.rim {
                rim.add(image);
            }
        }
    }

    /// The mirror's rim in the last images. None where it is not seen about where the camera's set-up says.
    pub fn visible_rim(&self) -> Option<Rim> {
        self.rim.as_ref()?.find()
    }

    fn fault_of_rows(&mut self, image: &ImageView<'_>, is_old: bool) -> Option<ImageFault> {
        let config = &self.config;
        let rows = &self.rows;
        if rows.is_empty() {
            return None;
        }
        let levels = rows.levels();
        if levels.upper < config.dark_level {
            let level = levels.upper;
            return Some(ImageFault::Dark { level });
        }
        if levels.lower >= 253.0 {
            return Some(ImageFault::White);
        }
        let enough = ((config.bad_rows_min * rows.count() as f32).ceil() as usize).max(2);
        let repeated = rows.repeated_run();
        if repeated.count * 100 >= rows.count() * 98 {
            return Some(ImageFault::Frozen);
        }
        if is_old {
            return Some(ImageFault::Old);
        }
        if repeated.count >= enough {
            let (first, last) = (repeated.first, repeated.last);
            return Some(ImageFault::Stale { first, last });
        }
        let empty = rows.empty_run();
        if empty.count >= enough {
            let (first, last) = (empty.first, empty.last);
            return Some(ImageFault::Incomplete { first, last });
        }
        if let Some(row) = self.seam.find(rows, image, config.seam_share_min) {
            return Some(ImageFault::Seam { row });
        }
        let contrast = rows.contrast();
        (contrast.spread < config.contrast_min.max(contrast.by_noise)).then_some(
            ImageFault::Blank {
                contrast: contrast.spread,
            },
        )
    }
}
