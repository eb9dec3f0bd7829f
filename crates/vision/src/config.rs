//! Which settings does vision have? Each with its unit and reason.

use localize::config::{SettingError, bound, check_bounds};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

mod bounds;

pub use bounds::VISION_BOUNDS;

/// `[vision]` of a robot's configuration.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct VisionConfig {
    /// Scan pattern: the pixels that are read.
    pub scan: ScanConfig,
    /// Colour classification.
    pub colours: ColourConfig,
    /// Line detection.
    pub lines: LineConfig,
    /// Detection of ball, robots and goals.
    pub objects: ObjectDetectionConfig,
    /// Automatic exposure and gain.
    pub exposure: AutoExposureConfig,
    /// Windows and thresholds of the virtual sensors.
    pub virtual_sensors: VirtualSensorConfig,
    /// Images from which nothing is claimed.
    pub image_check: ImageCheckConfig,
}

/// Which images are dark, blank, incomplete, torn, repeated or turned. Nothing is claimed from those.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct ImageCheckConfig {
    /// False processes every image.
    pub enabled: bool,
    /// An image is dark if 99 % of its samples are below this brightness, 0 to 255.
    pub dark_level: f32,
    /// An image is blank if the brightness of 90 % of the floor's parts differs by less than this, 0 to 255, or by less
    /// than the noise explains.
    pub contrast_min: f32,
    /// Share of the rows that must be empty or repeated until an image counts as incomplete or torn.
    pub bad_rows_min: f32,
    /// Columns that change sharply from one row to the next, more than twice those of any other pair of rows, from which an
    /// image counts as torn; as a share of the image's width.
    pub seam_share_min: f32,
}

impl Default for ImageCheckConfig {
    fn default() -> Self {
        ImageCheckConfig {
            enabled: true,
            dark_level: 14.0,
            contrast_min: 4.0,
            bad_rows_min: 0.03,
            seam_share_min: 0.06,
        }
    }
}

/// The scan pattern (minho2016 section III: 72 radial lines every 5°, 36 spirals each way every 10°).
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct ScanConfig {
    /// Number of radial scan lines, evenly spaced around the mirror's axis. More lines give more line points and cost
    /// more time.
    pub radial_lines: usize,
    /// Number of spirals in each direction of rotation, evenly spaced around the axis. They cross markings that point
    /// at the robot.
    pub spirals_each_way: usize,
    /// Rotation of a spiral from the axis to the rim, turns. More turns cross radial markings closer to a right angle.
    pub spiral_turns: f32,
    /// Number of circles about the mirror's axis (lima2001 4.4), evenly spaced over the ground within range. 0 if
    /// spirals replace them.
    pub circles: usize,
    /// Smallest ground distance scanned, metres. Nearer ground is hidden by the robot's own body.
    pub range_min: f32,
    /// Largest ground distance scanned, metres.
    pub range_max: f32,
    /// Largest ground extent of a scanned pixel along the viewing direction, in line widths. A larger value adds far
    /// points of lower quality.
    pub pixel_footprint_max: f32,
    /// Fewest line points expected of half of the scan lines at which only that half is read, in alternation, while the
    /// pose is tracked without doubt. All lines are read otherwise, and in every image at 0. Half of the lines take
    /// half of the time.
    pub interlaced_points_min: usize,
}

impl Default for ScanConfig {
    fn default() -> Self {
        ScanConfig {
            radial_lines: 72,
            spirals_each_way: 36,
            spiral_turns: 0.75,
            circles: 0,
            range_min: 0.25,
            range_max: 9.0,
            pixel_footprint_max: 2.0,
            interlaced_points_min: 40,
        }
    }
}

/// Colour classes without a labelled table. The carpet is found in the image and all other colours are classified
/// relative to it.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct ColourConfig {
    /// Largest ground distance of pixels used to learn the carpet, metres. Farther pixels include more of the
    /// surroundings.
    pub learning_range_max: f32,
    /// Smallest chroma of a carpet pixel, as a share of the carpet's chroma. Glare and lines reduce it.
    pub carpet_chroma_min: f32,
    /// Largest deviation of a carpet pixel's chroma from the carpet's hue, as a share of the carpet's chroma.
    pub carpet_hue_tolerance: f32,
    /// Smallest brightness of a carpet pixel, as a share of the carpet's median. A smaller value includes darker
    /// shadows.
    pub carpet_brightness_min: f32,
    /// The carpet is relearned if the share of carpet pixels falls below this share of its value at learning. 0 never
    /// relearns for this reason.
    pub relearn_carpet_share: f32,
    /// Brightness threshold of a black image, level of 255. An image is black if 95 % of its scanned pixels stay below
    /// it.
    pub dark_image_level: u8,
    /// Adaptation of the colours during play.
    pub adaptation: ColourAdaptationConfig,
}

/// Tracking of carpet and white from image to image. Changes of light beyond its limits cause relearning.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct ColourAdaptationConfig {
    /// False keeps the colours as learned.
    pub enabled: bool,
    /// Images between updates. Light that changes faster is relearned.
    pub interval_images: u32,
    /// Share of the difference by which an update moves the colours. 0.03 on every tenth image takes about ten seconds
    /// at 30 images per second.
    pub smoothing_factor: f32,
    /// Largest factor by which the tracked brightness may rise or fall from the learned one. Larger changes are
    /// relearned.
    pub brightness_factor_max: f32,
    /// Largest relative deviation of a channel's share of the brightness from the learned one, as a share of the
    /// carpet's chroma. The limit keeps the colours on the same carpet.
    pub chroma_deviation_max: f32,
    /// Relative deviation of a channel at which tables are rebuilt. The default is half of what changes a
    /// classification.
    pub rebuild_threshold: f32,
}

impl Default for ColourAdaptationConfig {
    fn default() -> Self {
        ColourAdaptationConfig {
            enabled: true,
            interval_images: 10,
            smoothing_factor: 0.03,
            brightness_factor_max: 1.6,
            chroma_deviation_max: 0.25,
            rebuild_threshold: 0.08,
        }
    }
}

impl Default for ColourConfig {
    fn default() -> Self {
        ColourConfig {
            learning_range_max: 4.0,
            carpet_chroma_min: 0.35,
            carpet_hue_tolerance: 0.45,
            carpet_brightness_min: 0.25,
            relearn_carpet_share: 0.5,
            dark_image_level: 12,
            adaptation: ColourAdaptationConfig::default(),
        }
    }
}

/// Acceptance of white runs as lines.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct LineConfig {
    /// Smallest width of a run, in line widths. Blur only widens runs; a third of a pixel is allowed for noise.
    pub width_ratio_min: f32,
    /// Largest width of a run, in line widths. A scan line at 20° to a line measures three; pixel size is added.
    pub width_ratio_max: f32,
    /// Smallest contrast of a run with the adjacent carpet, in standard deviations of the image noise. A smaller value
    /// accepts fainter lines and more noise.
    pub contrast_sigma_min: f32,
    /// Smallest contrast of a run, levels of 255. It exceeds the camera's quantisation and JPEG ripple.
    pub contrast_levels_min: f32,
    /// Smallest contrast of a run wider than the blur, as a share of the white–carpet contrast. Glare reduces the
    /// contrast.
    pub white_share_min: f32,
    /// Width of the image blur, pixels. The contrast of thinner lines is reduced in proportion.
    pub blur_px: f32,
    /// Largest deviation of a run's added light from the hue of white, as a share of the added brightness.
    pub hue_tolerance: f32,
    /// Standard deviation of an edge position in the image, pixels. A larger value reduces the weight of all line
    /// points.
    pub position_std_px: f32,
    /// True also detects the bases of white walls as line points (lima2001 4). For fields whose boundary lines are
    /// walls.
    pub detect_wall_bases: bool,
}

impl Default for LineConfig {
    fn default() -> Self {
        LineConfig {
            width_ratio_min: 0.7,
            width_ratio_max: 3.0,
            contrast_sigma_min: 5.0,
            contrast_levels_min: 8.0,
            white_share_min: 0.25,
            blur_px: 3.0,
            hue_tolerance: 0.45,
            position_std_px: 0.5,
            detect_wall_bases: false,
        }
    }
}

/// Detection of ball, robots, goals and the end of the carpet.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct ObjectDetectionConfig {
    /// Number of rays that are searched for the nearest obstacle, evenly spaced around the mirror's axis. A spacing of
    /// 2° is 14 cm at 4 m.
    pub ray_count: usize,
    /// Distance between samples of a ray, pixels. The edge of an obstacle is refined to one pixel.
    pub ray_step_px: usize,
    /// Ground extent along the ray, metres, beyond which pixels that are neither carpet nor line end the carpet.
    pub carpet_gap_max: f32,
    /// Added to `carpet_gap_max` per metre of distance. The height of a ball occludes 0.4 of the distance.
    pub carpet_gap_per_range: f32,
    /// Height of the viewpoint in the mirror, metres. Robots of the league are at most 0.8 m high.
    pub viewpoint_height: f32,
    /// Radius of the ball, metres (size 5).
    pub ball_radius: f32,
    /// Range of the ball's hue, degrees (red 0, yellow 60, green 120, blue 240). A range with from > to includes red.
    /// Balls of the league are orange to yellow. Near a yellow goal, use 8 to 45.
    #[serde(deserialize_with = "localize::fixed_array::deserialize")]
    pub ball_hue_deg: [f32; 2],
    /// Smallest visible share of a ball's expected pixels. A smaller value accepts balls that are more occluded.
    pub ball_visible_share_min: f32,
    /// Smallest number of pixels of a ball. A larger value rejects small or distant ones.
    pub ball_pixels_min: usize,
    /// Largest distance of a detected ball, metres.
    pub ball_range_max: f32,
    /// Smallest probability of a ball by the networks that judge its pixels. A larger value accepts fewer false balls.
    pub ball_probability_min: f32,
    /// Smallest probability of a robot or person by the networks that judge its pixels.
    pub obstacle_probability_min: f32,
    /// Radius of a robot, metres: distance of its centre behind its nearest edge.
    pub robot_radius: f32,
    /// Smallest width of a robot, metres. Narrower obstacles are rods and cables.
    pub robot_width_min: f32,
    /// Largest width of a robot, metres. Wider obstacles are walls or the carpet's edge.
    pub robot_width_max: f32,
    /// Smallest depth step from a robot to the end of the carpet on both sides, metres. A robot needs two of three
    /// cues: depth step, team marker, dark base.
    pub robot_depth_step_min: f32,
    /// Smallest depth step from a goal post to the end of the carpet on both sides, metres. The carpet continues for
    /// half a goal's depth.
    pub post_depth_step_min: f32,
    /// Largest distance of a detected robot, metres.
    pub robot_range_max: f32,
}

impl Default for ObjectDetectionConfig {
    fn default() -> Self {
        ObjectDetectionConfig {
            ray_count: 180,
            ray_step_px: 2,
            carpet_gap_max: 0.3,
            carpet_gap_per_range: 0.45,
            viewpoint_height: localize::robot::DEFAULT_MIRROR_RIM_HEIGHT,
            ball_radius: 0.11,
            ball_hue_deg: [8.0, 62.0],
            ball_visible_share_min: 0.2,
            ball_pixels_min: 6,
            ball_range_max: 9.0,
            ball_probability_min: 0.8,
            obstacle_probability_min: 0.6,
            robot_radius: 0.25,
            robot_width_min: 0.15,
            robot_width_max: 1.1,
            robot_depth_step_min: 0.4,
            post_depth_step_min: 0.25,
            robot_range_max: 12.0,
        }
    }
}

/// Automatic control of exposure and gain. The camera's limits are in `[exposure]` of robot.toml.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct AutoExposureConfig {
    /// False disables monitoring and control of the exposure.
    pub enabled: bool,
    /// Images between checks of the centre's brightness. The light is assumed constant for a tenth of a second.
    pub check_every: u64,
    /// Largest distance of carpet in the measured centre, metres. Near carpet is visible at every position of the
    /// robot. Of a mirror that shows no carpet so near, the nearest half metre is measured.
    pub centre_range_max: f32,
    /// Relative change of the centre's brightness that starts a search. A nearby line or ball changes it less.
    pub brightness_change_min: f32,
    /// Smallest predicted gain of entropy for a new setting, bits. Smaller gains are within the variation of the scene.
    pub entropy_gain_min: f32,
    /// Largest factor of light per command. Predictions from a clipped image are unreliable beyond it.
    pub step_factor_max: f32,
    /// Relative change of light below which the search ends.
    pub convergence_tolerance: f32,
}

impl Default for AutoExposureConfig {
    fn default() -> Self {
        AutoExposureConfig {
            enabled: true,
            check_every: 3,
            centre_range_max: 1.0,
            brightness_change_min: 0.12,
            entropy_gain_min: 0.05,
            step_factor_max: 8.0,
            convergence_tolerance: 0.1,
        }
    }
}

/// A rectangle of the image, pixels.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct ImageRect {
    /// Left edge.
    pub left_px: f32,
    /// Upper edge.
    pub top_px: f32,
    /// Width.
    pub width_px: f32,
    /// Height.
    pub height_px: f32,
}

/// The virtual sensors of lima2001 section 3.3. Windows that are absent are placed by the ground map.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct VirtualSensorConfig {
    /// Bumper windows, from left through front to right. If empty: nine squares evenly spaced around the robot.
    pub bumpers: Vec<ImageRect>,
    /// Goal windows. If empty: three in front of the robot, from half the radius to the rim.
    pub goals: Vec<ImageRect>,
    /// Window in which a ball is reported. If absent: the whole image.
    pub ball: Option<ImageRect>,
    /// Window in which a ball touches the kicker. If absent: directly in front of the robot.
    pub kick: Option<ImageRect>,
    /// Window in which the camera lens must appear. If absent: around the configured mirror axis.
    pub lens: Option<ImageRect>,
    /// Distance of the centres of default bumper windows from the robot's centre, metres.
    pub bumper_range: f32,
    /// Ground extent of a default bumper window along the ray, metres.
    pub bumper_size: f32,
    /// Smallest share of pixels that are not floor for a bumper hit. A crossing line covers less than half.
    pub bumper_occupied_share_min: f32,
    /// Smallest share of a window with the goal's colour for a goal detection.
    pub goal_colour_share_min: f32,
    /// Distance of the centre of the default kick window from the robot's centre, metres: half a robot plus a ball's
    /// radius.
    pub kick_range: f32,
    /// Ground extent of the default kick window along the ray, metres: a ball's diameter.
    pub kick_size: f32,
    /// Smallest share of the kick window with the ball's colour for a ball contact.
    pub kick_colour_share_min: f32,
}

impl Default for VirtualSensorConfig {
    fn default() -> Self {
        VirtualSensorConfig {
            bumpers: Vec::new(),
            goals: Vec::new(),
            ball: None,
            kick: None,
            lens: None,
            bumper_range: 0.6,
            bumper_size: 0.3,
            bumper_occupied_share_min: 0.5,
            goal_colour_share_min: 0.1,
            kick_range: 0.36,
            kick_size: 0.22,
            kick_colour_share_min: 0.3,
        }
    }
}

impl VisionConfig {
    /// Returns an error for the first invalid value.
    pub fn check(&self) -> Result<(), SettingError> {
        check_bounds("vision", self, VISION_BOUNDS)?;
        let scan = &self.scan;
        let lines = scan.radial_lines + scan.spirals_each_way + scan.circles;
        bound(
            "",
            1.0,
            6000.0,
            "radial lines, spirals and circles together",
        )
        .check("vision.scan.radial_lines", lines as f64)?;
        // At least the ball's diameter: the viewpoint must be above the ball.
        let lowest = 2.0 * f64::from(self.objects.ball_radius) + 0.01;
        bound("", lowest, 5.0, "the mirror must look down on the ball").check(
            "vision.objects.viewpoint_height",
            f64::from(self.objects.viewpoint_height),
        )
    }
}
