//! What does a source yield? Stamped samples, the same from a robot, a simulation, a log or a folder.

use std::fmt::Debug;
use std::ops::Deref;
use std::sync::Arc;

use localize::Pose;
use localize::Stamp;
use localize::frames::{At, FieldFrame};
use localize::sample::{Compass, GoalObservation, Imu, LinePoint, Odometry, VelocityCommand};
use localize::team::TeamReport;
use vision::image::{Image, ImageView as Pixels, PixelFormat};
use vision::process::Detections;

/// Where things truly were.
#[derive(Debug, Clone, PartialEq)]
pub struct GroundTruth {
    /// When.
    pub stamp: Stamp,
    /// The robot.
    pub pose: Pose,
    /// The ball, if the source knows it.
    pub ball: Option<At<FieldFrame>>,
    /// Other robots, if the source knows them.
    pub robots: Vec<At<FieldFrame>>,
    /// Where they head, radians on the field, in their order; empty where the source does not know (a log keeps none).
    pub robot_headings: Vec<f32>,
}

/// One thing that arrived.
#[derive(Debug, Clone)]
pub enum Sample {
    /// From the wheels.
    Odometry(Odometry),
    /// From the compass.
    Compass(Compass),
    /// From the inertial unit.
    Imu(Imu),
    /// What the motors are told.
    Command(VelocityCommand),
    /// What a team-mate says.
    TeamReport(TeamReport),
    /// For scoring alone; no stage sees it.
    GroundTruth(GroundTruth),
    /// A frame: it ends a cycle.
    Image(CameraImage),
}

/// What vision starts from in a cycle.
#[derive(Debug, Clone)]
pub struct CameraImage {
    /// When it was exposed.
    pub stamp: Stamp,
    /// What it shows.
    pub content: ImageContent,
}

/// A frame's content.
#[derive(Debug, Clone)]
pub enum ImageContent {
    /// An image for our own vision.
    Pixels(SourceImage),
    /// What another vision (or an earlier run) found.
    Features {
        /// Line points.
        points: Vec<LinePoint>,
        /// Goals by their colours.
        goals: Vec<GoalObservation>,
    },
    /// What our own vision found in an earlier run.
    Detections(Box<Detections>),
    /// A frame that could not be read; the cycle runs on without sight.
    Unreadable(String),
}

/// An image as its source has it.
#[derive(Debug, Clone)]
pub enum SourceImage {
    /// Red, green, blue: from a file, a log or the simulator.
    Rgb(Arc<Image>),
    /// A camera's own bytes; JPEG is decoded before.
    Raw(RawImage),
}

/// Bytes of an image that belong to whoever made them, such as a camera's buffer pool.
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
    /// Its pixels, for vision.
    pub fn view(&self) -> Pixels<'_> {
        match self {
            SourceImage::Rgb(image) => image.view(),
            SourceImage::Raw(frame) => Pixels {
                width_px: frame.width_px,
                height_px: frame.height_px,
                format: frame.format,
                stride: frame.stride,
                data: &frame.data,
            },
        }
    }

    /// Red, green, blue, as vision takes the camera's bytes; none of a torn frame.
    pub fn to_rgb(&self) -> Option<Arc<Image>> {
        let frame = match self {
            SourceImage::Rgb(image) => return Some(Arc::clone(image)),
            SourceImage::Raw(_) => self.view(),
        };
        let (width_px, height_px) = (frame.width_px, frame.height_px);
        frame.check(width_px, height_px).ok()?;
        let mut rgb = Vec::with_capacity(3 * width_px * height_px);
        if frame.format == PixelFormat::Rgb8 {
            for row in frame.data.chunks(frame.stride).take(height_px) {
                rgb.extend_from_slice(&row[..3 * width_px]);
            }
        } else {
            for row in 0..height_px {
                rgb.extend((0..width_px).flat_map(|column| frame.rgb(column, row)));
            }
        }
        Some(Arc::new(Image {
            width_px,
            height_px,
            rgb,
        }))
    }

    /// True if red, green and blue hold all that vision sees: brightness and chroma round on their way there.
    pub fn is_lossless_in_rgb(&self) -> bool {
        !self.view().format.is_yuv()
    }
}

impl From<Image> for SourceImage {
    fn from(image: Image) -> Self {
        SourceImage::Rgb(Arc::new(image))
    }
}
