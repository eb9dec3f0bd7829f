//! In which ranges do the numbers of vision work, and why?

use localize::config::{Bound, bound};

const SHARE: &str = "a share";
const RANGE: &str = "beyond it a pixel covers metres of ground";
const LINES: &str = "more than 2000 lines of one kind take too long for one image";
const LEVEL: &str = "a brightness level of 0 to 255";
const FACTOR: &str = "a factor of at least 1";
const PIXELS: &str = "pixels of an image";

/// Bounds of `VisionConfig`.
pub const VISION_BOUNDS: &[Bound] = &[
    bound("scan.radial_lines", 0.0, 2000.0, LINES),
    bound("scan.spirals_each_way", 0.0, 2000.0, LINES),
    bound(
        "scan.spiral_turns",
        0.0,
        100.0,
        "more turns read every pixel",
    ),
    bound("scan.circles", 0.0, 2000.0, LINES),
    bound("scan.range_min", 0.0, 100.0, RANGE),
    bound("scan.range_max", 0.01, 100.0, RANGE),
    bound(
        "scan.pixel_footprint_max",
        0.01,
        1000.0,
        "smaller refuses every pixel",
    ),
    bound("colours.learning_range_max", 0.01, 100.0, RANGE),
    bound(
        "colours.carpet_chroma_min",
        0.0,
        10.0,
        "a share of the carpet's chroma",
    ),
    bound(
        "colours.carpet_hue_tolerance",
        0.0,
        10.0,
        "a share of the carpet's chroma",
    ),
    bound(
        "colours.carpet_brightness_min",
        0.0,
        10.0,
        "a share of the carpet's brightness",
    ),
    bound("colours.relearn_carpet_share", 0.0, 1.0, SHARE),
    bound("colours.dark_image_level", 0.0, 255.0, LEVEL),
    bound(
        "colours.adaptation.interval_images",
        1.0,
        1.0e6,
        "every image at most",
    ),
    bound(
        "colours.adaptation.smoothing_factor",
        1.0e-6,
        1.0,
        "0 never adapts, 1 takes each image alone",
    ),
    bound(
        "colours.adaptation.brightness_factor_max",
        1.0,
        1000.0,
        FACTOR,
    ),
    bound("colours.adaptation.chroma_deviation_max", 0.0, 1.0, SHARE),
    bound(
        "colours.adaptation.rebuild_threshold",
        1.0e-6,
        100.0,
        "0 rebuilds the tables at each image",
    ),
    bound("lines.width_ratio_min", 0.0, 100.0, "in line widths"),
    bound("lines.width_ratio_max", 0.01, 100.0, "in line widths"),
    bound(
        "lines.contrast_sigma_min",
        0.0,
        1000.0,
        "in standard deviations of the image's noise",
    ),
    bound("lines.contrast_levels_min", 0.01, 255.0, LEVEL),
    bound("lines.white_share_min", 0.0, 1.0, SHARE),
    bound(
        "lines.blur_px",
        0.01,
        100.0,
        "no image is sharper than a hundredth of a pixel",
    ),
    bound(
        "lines.hue_tolerance",
        0.001,
        100.0,
        "a share of the added brightness",
    ),
    bound(
        "lines.position_std_px",
        0.001,
        100.0,
        "no edge is placed exactly",
    ),
    bound(
        "objects.ray_count",
        16.0,
        2000.0,
        "16 rays find the end of the carpet, more than 2000 take too long",
    ),
    bound(
        "objects.ray_step_px",
        1.0,
        100.0,
        "whole pixels; longer steps miss obstacles",
    ),
    bound("objects.carpet_gap_max", 0.0, 100.0, RANGE),
    bound(
        "objects.carpet_gap_per_range",
        0.0,
        100.0,
        "a share of the distance",
    ),
    bound(
        "objects.viewpoint_height",
        0.05,
        5.0,
        "height of a mirror above the ground, metres",
    ),
    bound("objects.ball_radius", 0.01, 1.0, "radius of a ball, metres"),
    bound("objects.ball_hue_deg", 0.0, 360.0, "hues go round once"),
    bound("objects.ball_visible_share_min", 0.0, 1.0, SHARE),
    bound("objects.ball_pixels_min", 0.0, 1.0e6, PIXELS),
    bound("objects.ball_range_max", 0.01, 100.0, RANGE),
    bound("objects.ball_probability_min", 0.0, 1.0, "a probability"),
    bound(
        "objects.obstacle_probability_min",
        0.0,
        1.0,
        "a probability",
    ),
    bound(
        "objects.robot_radius",
        0.0,
        5.0,
        "robots of the league are 0.5 m wide",
    ),
    bound(
        "objects.robot_width_min",
        0.0,
        100.0,
        "a width on the ground, metres",
    ),
    bound(
        "objects.robot_width_max",
        0.01,
        100.0,
        "a width on the ground, metres",
    ),
    bound(
        "objects.robot_depth_step_min",
        0.001,
        100.0,
        "0 takes every edge for a robot",
    ),
    bound(
        "objects.post_depth_step_min",
        0.001,
        100.0,
        "0 takes every edge for a post",
    ),
    bound("objects.robot_range_max", 0.01, 100.0, RANGE),
    bound("exposure.check_every", 1.0, 1.0e6, "every image at most"),
    bound("exposure.centre_range_max", 0.01, 100.0, RANGE),
    bound(
        "exposure.brightness_change_min",
        1.0e-4,
        100.0,
        "0 searches at each image",
    ),
    bound(
        "exposure.entropy_gain_min",
        0.0,
        8.0,
        "an image of 256 levels holds 8 bits a pixel",
    ),
    bound("exposure.step_factor_max", 1.0, 1000.0, FACTOR),
    bound(
        "exposure.convergence_tolerance",
        1.0e-4,
        100.0,
        "0 never ends the search",
    ),
    bound("virtual_sensors.bumper_range", 0.01, 100.0, RANGE),
    bound("virtual_sensors.bumper_size", 0.001, 100.0, RANGE),
    bound(
        "virtual_sensors.bumper_occupied_share_min",
        1.0e-6,
        1.0,
        "a share above 0",
    ),
    bound(
        "virtual_sensors.goal_colour_share_min",
        1.0e-6,
        1.0,
        "a share above 0",
    ),
    bound("virtual_sensors.kick_range", 0.01, 100.0, RANGE),
    bound("virtual_sensors.kick_size", 0.001, 100.0, RANGE),
    bound(
        "virtual_sensors.kick_colour_share_min",
        1.0e-6,
        1.0,
        "a share above 0",
    ),
    // The windows: `*` is one of the lists or a single window.
    bound(
        "virtual_sensors.*.left_px",
        0.0,
        65_535.0,
        "a window starts inside the image",
    ),
    bound(
        "virtual_sensors.*.top_px",
        0.0,
        65_535.0,
        "a window starts inside the image",
    ),
    bound(
        "virtual_sensors.*.width_px",
        1.0,
        65_535.0,
        "a window is at least a pixel wide",
    ),
    bound(
        "virtual_sensors.*.height_px",
        1.0,
        65_535.0,
        "a window is at least a pixel high",
    ),
];
