//! What does a source yield? Stamped samples. Robot, simulation, log and recording folder use the same types.

use std::fmt::Debug;
use std::ops::Deref;
use std::sync::Arc;

use localize::Pose;
use localize::Stamp;
use localize::frames::{At, FieldFrame};
use localize::map_correction::MapFit;
use localize::robot::ExposureSetting;
use localize::sample::{Compass, GoalObservation, Imu, LinePoint, Odometry, VelocityCommand};
use localize::team::TeamReport;
use nalgebra::Matrix3;
use vision::image::{Image, ImageView, PixelFormat};
use vision::process::Detections;

use crate::warm_start::WarmStart;

/// True poses and positions at one time.
#[derive(Debug, Clone, PartialEq)]
pub struct GroundTruth {
    /// Time.
    pub stamp: Stamp,
    /// Pose of the robot.
    pub pose: Pose,
    /// The ball, if the source knows it.
    pub ball: Option<At<FieldFrame>>,
    /// Height of the ball's lowest point above the ground, metres; 0 if the source does not know it.
    pub ball_height: f32,
    /// Other robots, if the source knows them.
    pub robots: Vec<At<FieldFrame>>,
    /// Headings of `robots` on the field, radians, in the same order. Empty if unknown.
    pub robot_headings: Vec<f32>,
    /// People, if the source knows them.
    pub people: Vec<At<FieldFrame>>,
}

/// One stamped input of the pipeline.
#[derive(Debug, Clone)]
pub enum Sample {
    /// Motion from the wheels.
    Odometry(Odometry),
    /// Heading from the compass.
    Compass(Compass),
    /// Reading of the inertial measurement unit.
    Imu(Imu),
    /// Velocity command to the motors.
    Command(VelocityCommand),
    /// Message of a teammate.
    TeamReport(TeamReport),
    /// Ground truth, for scoring. No stage reads it.
    GroundTruth(GroundTruth),
    /// Settings (TOML) that were changed during the run and hold from the next cycle on. Who owns the pipeline replaces it.
    Settings(SettingsChange),
    /// Covariance of (x, y, θ) that is added to the poses of a doubtful set-up from the next cycle on. Zero ends the doubt.
    SetupDoubt(Matrix3<f32>),
    /// Errors of the ground map that images told, which are in use from the next cycle on.
    MapFit(Box<MapFit>),
    /// An image. It completes a cycle.
    Image(CameraImage),
}

/// Settings that were changed during the run, with the state from which the pipeline goes on.
#[derive(Debug, Clone)]
pub struct SettingsChange {
    /// All settings (TOML).
    pub config_toml: Arc<str>,
    /// None in older logs: replay then goes on from its own state.
    pub warm_start: Option<WarmStart>,
}

/// The input of vision in one cycle.
#[derive(Debug, Clone)]
pub struct CameraImage {
    /// Time of exposure.
    pub stamp: Stamp,
    /// Exposure and gain with which the image was taken, if the camera reports them.
    pub setting: Option<ExposureSetting>,
    /// Pixels, or features that replace them.
    pub content: ImageContent,
}

/// Content of an image.
#[derive(Debug, Clone)]
pub enum ImageContent {
    /// An image for our own vision.
    Pixels(SourceImage),
    /// Features from another vision system or an earlier run.
    Features {
        /// Line points.
        points: Vec<LinePoint>,
        /// Coloured goals.
        goals: Vec<GoalObservation>,
    },
    /// Detections of our own vision in an earlier run.
    Detections(Box<Detections>),
    /// An image that could not be read, with the reason. The cycle runs without features.
    Unreadable(String),
}

/// An image in the format of its source.
#[derive(Debug, Clone)]
pub enum SourceImage {
    /// Red, green, blue: from a file, a log or the simulator.
    Rgb(Arc<Image>),
    /// Bytes in the camera's own format. JPEG is decoded earlier.
    Raw(RawImage),
}

/// Bytes of an image owned by its producer, such as the buffer pool of a camera.
pub trait ImageBytes: Deref<Target = [u8]> + Debug + Send + Sync {}

impl<T: Deref<Target = [u8]> + Debug + Send + Sync> ImageBytes for T {}

/// An image in a camera's own pixel format.
#[derive(Debug, Clone)]
pub struct RawImage {
    /// Columns.
    pub width_px: usize,
    /// Rows.
    pub height_px: usize,
    /// Layout of the bytes.
    pub format: PixelFormat,
    /// Bytes from one row to the next.
    pub stride: usize,
    /// Row by row from the top.
    pub data: Arc<dyn ImageBytes>,
}

impl SourceImage {
    /// View of the pixels for vision.
    pub fn view(&self) -> ImageView<'_> {
        match self {
            SourceImage::Rgb(image) => image.view(),
            SourceImage::Raw(raw) => ImageView {
                width_px: raw.width_px,
                height_px: raw.height_px,
                format: raw.format,
                stride: raw.stride,
                data: &raw.data,
            },
        }
    }

    /// RGB image, converted as in vision. None if the image is truncated.
    pub fn to_rgb(&self) -> Option<Arc<Image>> {
        let view = match self {
            SourceImage::Rgb(image) => return Some(Arc::clone(image)),
            SourceImage::Raw(_) => self.view(),
        };
        let (width_px, height_px) = (view.width_px, view.height_px);
        view.check(width_px, height_px).ok()?;
        let mut rgb = Vec::with_capacity(3 * width_px * height_px);
        if view.format == PixelFormat::Rgb8 {
            for row in view.data.chunks(view.stride).take(height_px) {
                rgb.extend_from_slice(&row[..3 * width_px]);
            }
        } else {
            for row in 0..height_px {
                rgb.extend((0..width_px).flat_map(|column| view.rgb(column, row)));
            }
        }
        Some(Arc::new(Image {
            width_px,
            height_px,
            rgb,
        }))
    }

    /// True if RGB represents the pixels exactly. Conversion from YUV rounds.
    pub fn is_lossless_in_rgb(&self) -> bool {
        !self.view().format.is_yuv()
    }
}

impl From<Image> for SourceImage {
    fn from(image: Image) -> Self {
        SourceImage::Rgb(Arc::new(image))
    }
}
