//! What may a user change about the eyes? Every value with its unit and its reason.

use localize::config::{SettingError, bound, check_bounds};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

mod bounds;

pub use bounds::VISION_BOUNDS;

/// `[vision]` of a robot's configuration.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct VisionConfig {
    /// Where the image is read.
    pub scan: ScanConfig,
    /// What colours mean.
    pub colours: ColourConfig,
    /// Which white runs are lines.
    pub lines: LineConfig,
    /// Ball, robots and goals.
    pub objects: ObjectConfig,
    /// When and how far exposure and gain follow the light.
    pub exposure: AutoExposureConfig,
    /// The virtual sensors' windows.
    pub virtual_sensors: VirtualSensorConfig,
}

/// The scan pattern (minho2016 section III: 72 radial lines every 5°, 36 spirals each way every 10°).
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct ScanConfig {
    /// Straight lines outward from the mirror's axis, evenly around it.
    pub radial_lines: usize,
    /// Spirals each way, evenly around the axis; they cross markings that point at the robot.
    pub spirals_each_way: usize,
    /// How far a spiral winds from the axis to the rim, turns; more turns cross radial markings more squarely.
    pub spiral_turns: f32,
    /// Circles about the mirror's axis (lima2001 4.4), evenly spaced in the part of the image that shows ground within
    /// range; the spirals do their work.
    pub circles: usize,
    /// Nearer ground is the robot's own body, metres.
    pub range_min: f32,
    /// Farther ground is not scanned, metres.
    pub range_max: f32,
    /// Ground that a pixel covers along the viewing direction may be this many line widths and still tell a line.
    pub pixel_footprint_max: f32,
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
        }
    }
}

/// What colours mean when no labelled table is given: the carpet is found in the image, all else is relative to it.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct ColourConfig {
    /// The carpet is sought among ground pixels nearer than this, metres: beyond lies more of the surroundings.
    pub learning_range_max: f32,
    /// A pixel keeps this share of the carpet's chroma, at least, to be carpet; glare and lines bleach it.
    pub carpet_chroma_min: f32,
    /// A pixel's chroma may leave the carpet's hue by this share of the carpet's chroma, at most.
    pub carpet_hue_tolerance: f32,
    /// A pixel is at least this bright, as a share of the carpet's median, to be carpet; shadows are darker.
    pub carpet_brightness_min: f32,
    /// The carpet is learned anew when fewer of the carpet pixels than this share of when it was learned are carpet.
    pub relearn_carpet_share: f32,
    /// A frame is black if 95 % of its scanned pixels stay below this level, of 255.
    pub dark_image_level: u8,
    /// How colours are followed while playing.
    pub adaptation: ColourAdaptationConfig,
}

/// How carpet and white are followed from frame to frame, between what was learned and what is quite another light.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct ColourAdaptationConfig {
    /// False: colours stay as they were learned.
    pub enabled: bool,
    /// Every so many frames are looked at: light that changes faster is learned anew.
    pub interval_images: u32,
    /// Share of the way that the tracked colours go towards each such frame's: 0.03 of every tenth takes some ten seconds
    /// at 30 frames a second.
    pub smoothing_factor: f32,
    /// Brightness follows by this factor up or down, at most; another light is learned anew.
    pub brightness_factor_max: f32,
    /// A channel's share of the brightness follows by this share of the carpet's chroma, at most: still the same carpet.
    pub chroma_deviation_max: f32,
    /// Tables are rebuilt when a channel is off by this share: half of what a classification would notice.
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

/// Which white runs are lines.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct LineConfig {
    /// Narrowest run, in line widths; blur widens a run and never narrows it, a third of a pixel is allowed for noise.
    pub width_ratio_min: f32,
    /// Widest run, in line widths: a scan line that crosses a line at 20° sees three; pixel size on top.
    pub width_ratio_max: f32,
    /// A run stands out from the carpet beside it by this many standard deviations of the image's noise, at least.
    pub contrast_sigma_min: f32,
    /// A run stands out by this many levels, of 255, at least: coarser than the camera's own steps and JPEG's ripple.
    pub contrast_levels_min: f32,
    /// A line wider in the image than the blur has at least this share of the white–carpet contrast; glare takes the rest.
    pub white_share_min: f32,
    /// Width of the image's blur, pixels: thinner lines lose contrast in proportion.
    pub blur_px: f32,
    /// How far a run's added light may leave white's direction, as a share of the added brightness.
    pub hue_tolerance: f32,
    /// How well an edge is placed in the image, standard deviation, pixels.
    pub position_std_px: f32,
    /// Are the feet of white walls points too (lima2001 4)? For fields whose boundary lines are walls.
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

/// Ball, robots and goals, and where the carpet ends.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct ObjectConfig {
    /// Directions in which the first obstacle is sought, evenly around the mirror's axis; 2° is 14 cm at 4 m.
    pub ray_count: usize,
    /// Pixels from one sample of a ray to the next; an obstacle's edge is then sought pixel by pixel.
    pub ray_step_px: usize,
    /// Something that is neither carpet nor line ends the carpet when it covers more of the ground than this
    /// along the viewing direction, metres.
    pub carpet_gap_max: f32,
    /// As much on top of `gap_max`, as a share of the distance: a ball's height hides 0.4 of it.
    pub carpet_gap_per_range: f32,
    /// Height of the point that the mirror sees from, metres; robots of the league are at most 0.8 m high.
    pub viewpoint_height: f32,
    /// The ball's radius, metres (size 5).
    pub ball_radius: f32,
    /// The ball's hue from..to, degrees (red 0, yellow 60, green 120, blue 240); from > to passes over red.
    /// The league's balls are orange to yellow; beside a yellow goal take 8 to 45.
    #[serde(deserialize_with = "localize::fixed_array::deserialize")]
    pub ball_hue_deg: [f32; 2],
    /// A ball covers at least this share of the pixels that a whole one would cover at its place.
    pub ball_visible_share_min: f32,
    /// Fewer pixels are no ball.
    pub ball_pixels_min: usize,
    /// Balls are sought up to this distance, metres.
    pub ball_range_max: f32,
    /// A robot's radius, metres: its middle lies that far behind its nearest edge.
    pub robot_radius: f32,
    /// Narrower obstacles are rods and cables, metres.
    pub robot_width_min: f32,
    /// Wider obstacles are the carpet's edge or a wall, metres.
    pub robot_width_max: f32,
    /// What has a marker but no dark foot is a robot if it stands this much before what ends the carpet beside it, metres.
    pub robot_depth_step_min: f32,
    /// A post stands this much before what ends the carpet on both its sides, metres: half a goal's depth is carpet too.
    pub post_depth_step_min: f32,
    /// Robots are sought up to this distance, metres.
    pub robot_range_max: f32,
}

impl Default for ObjectConfig {
    fn default() -> Self {
        ObjectConfig {
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
            robot_radius: 0.25,
            robot_width_min: 0.15,
            robot_width_max: 1.1,
            robot_depth_step_min: 0.4,
            post_depth_step_min: 0.25,
            robot_range_max: 7.0,
        }
    }
}

/// When and how far exposure and gain follow the light; what the camera can do is `[exposure]` of robot.toml.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct AutoExposureConfig {
    /// False: exposure is neither watched nor changed.
    pub enabled: bool,
    /// The centre's brightness is looked at in every so many frames: light does not change faster than a tenth of a second.
    pub check_every: u64,
    /// Carpet nearer than this belongs to the centre, metres: it is in view wherever the robot is.
    pub centre_range_max: f32,
    /// The best setting is sought when the centre's brightness changed by this share; a line or ball nearby changes less.
    pub brightness_change_min: f32,
    /// Another setting must promise so many bits of entropy more: below lies what the scene changes by itself.
    pub entropy_gain_min: f32,
    /// One command changes the light by this factor, at most: predictions from a clipped picture go wrong beyond.
    pub step_factor_max: f32,
    /// The search ends when a step would change the light by less than this share.
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
    /// Its left edge.
    pub left_px: f32,
    /// Its upper edge.
    pub top_px: f32,
    /// From left to right.
    pub width_px: f32,
    /// From top to bottom.
    pub height_px: f32,
}

/// The virtual sensors of lima2001 section 3.3. Windows that are not given are laid out by the ground map.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct VirtualSensorConfig {
    /// The bumpers, from the left over the front to the right; none given: nine squares evenly around the robot.
    pub bumpers: Vec<ImageRect>,
    /// Goals are sought in these; none given: three in front, from half way out to the rim.
    pub goals: Vec<ImageRect>,
    /// The ball counts inside this one; left out: everywhere.
    pub ball: Option<ImageRect>,
    /// The ball inside this one touches the kicker; left out: just before the robot.
    pub kick: Option<ImageRect>,
    /// The camera's lens must be seen inside this one; left out: around where the mirror's axis should be.
    pub lens: Option<ImageRect>,
    /// Middle of the bumpers that are laid out, metres from the robot's centre.
    pub bumper_range: f32,
    /// Ground that such a bumper covers along the ray, metres.
    pub bumper_size: f32,
    /// A bumper is hit when this share of it is not floor: a line that passes covers less than half.
    pub bumper_occupied_share_min: f32,
    /// A goal is seen when this share of one of its windows has its colour.
    pub goal_colour_share_min: f32,
    /// Middle of the kick window that is laid out, metres before the robot's centre: half a robot and a ball's radius.
    pub kick_range: f32,
    /// Ground that it covers along the ray, metres: a ball's diameter.
    pub kick_size: f32,
    /// The ball touches the kicker when this share of the kick window has its colour.
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
    /// Refuses values that cannot work, and names the first. To be called on what a user wrote.
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
        // Twice the radius: the mirror must see the ball from above.
        let lowest = 2.0 * f64::from(self.objects.ball_radius) + 0.01;
        bound("", lowest, 5.0, "the mirror must look down on the ball").check(
            "vision.objects.viewpoint_height",
            f64::from(self.objects.viewpoint_height),
        )
    }
}
