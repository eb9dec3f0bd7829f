//! Which settings were renamed? Old names are refused with the new one in the message, and translated in logs.

use anyhow::{Result, anyhow};
use localize::toml_location::key_location;
use std::path::Path;
use toml::{Table, Value};

/// Renamed settings: old and new dotted path.
pub const RENAMED_KEYS: &[(&str, &str)] = &[
    (
        "vision.scan.pixel_per_line_max",
        "vision.scan.pixel_footprint_max",
    ),
    (
        "vision.colours.carpet_range",
        "vision.colours.learning_range_max",
    ),
    (
        "vision.colours.carpet_hue_slack",
        "vision.colours.carpet_hue_tolerance",
    ),
    (
        "vision.colours.carpet_bright_min",
        "vision.colours.carpet_brightness_min",
    ),
    (
        "vision.colours.relearn_below",
        "vision.colours.relearn_carpet_share",
    ),
    (
        "vision.colours.black_frame_level",
        "vision.colours.dark_image_level",
    ),
    (
        "vision.colours.adapt.enabled",
        "vision.colours.adaptation.enabled",
    ),
    (
        "vision.colours.adapt.every",
        "vision.colours.adaptation.interval_images",
    ),
    (
        "vision.colours.adapt.rate",
        "vision.colours.adaptation.smoothing_factor",
    ),
    (
        "vision.colours.adapt.brightness_max",
        "vision.colours.adaptation.brightness_factor_max",
    ),
    (
        "vision.colours.adapt.chroma_max",
        "vision.colours.adaptation.chroma_deviation_max",
    ),
    (
        "vision.colours.adapt.rebuild_off",
        "vision.colours.adaptation.rebuild_threshold",
    ),
    ("vision.lines.width_min", "vision.lines.width_ratio_min"),
    ("vision.lines.width_max", "vision.lines.width_ratio_max"),
    (
        "vision.lines.contrast_noises",
        "vision.lines.contrast_sigma_min",
    ),
    (
        "vision.lines.contrast_levels",
        "vision.lines.contrast_levels_min",
    ),
    ("vision.lines.hue_slack", "vision.lines.hue_tolerance"),
    ("vision.lines.walls", "vision.lines.detect_wall_bases"),
    ("vision.objects.rays", "vision.objects.ray_count"),
    ("vision.objects.gap_max", "vision.objects.carpet_gap_max"),
    (
        "vision.objects.gap_share",
        "vision.objects.carpet_gap_per_range",
    ),
    (
        "vision.objects.ball_part_min",
        "vision.objects.ball_visible_share_min",
    ),
    (
        "vision.objects.robot_before_min",
        "vision.objects.robot_depth_step_min",
    ),
    (
        "vision.objects.post_before_min",
        "vision.objects.post_depth_step_min",
    ),
    (
        "vision.exposure.ring_range",
        "vision.exposure.centre_range_max",
    ),
    (
        "vision.exposure.change_min",
        "vision.exposure.brightness_change_min",
    ),
    (
        "vision.exposure.step_max",
        "vision.exposure.step_factor_max",
    ),
    (
        "vision.exposure.settled",
        "vision.exposure.convergence_tolerance",
    ),
    ("vision.windows.bumpers", "vision.virtual_sensors.bumpers"),
    ("vision.windows.goals", "vision.virtual_sensors.goals"),
    ("vision.windows.ball", "vision.virtual_sensors.ball"),
    ("vision.windows.kick", "vision.virtual_sensors.kick"),
    ("vision.windows.lens", "vision.virtual_sensors.lens"),
    (
        "vision.windows.bumper_range",
        "vision.virtual_sensors.bumper_range",
    ),
    (
        "vision.windows.bumper_size",
        "vision.virtual_sensors.bumper_size",
    ),
    (
        "vision.windows.bumper_share",
        "vision.virtual_sensors.bumper_occupied_share_min",
    ),
    (
        "vision.windows.goal_share",
        "vision.virtual_sensors.goal_colour_share_min",
    ),
    (
        "vision.windows.kick_range",
        "vision.virtual_sensors.kick_range",
    ),
    (
        "vision.windows.kick_size",
        "vision.virtual_sensors.kick_size",
    ),
    (
        "vision.windows.kick_share",
        "vision.virtual_sensors.kick_colour_share_min",
    ),
    ("localize.distance.cell", "localize.distance_field.cell"),
    ("localize.distance.margin", "localize.distance_field.margin"),
    (
        "localize.matching.reach_sigmas",
        "localize.matching.kernel_scale_sigmas",
    ),
    (
        "localize.matching.point_std_min",
        "localize.matching.map_std",
    ),
    (
        "localize.matching.step_end",
        "localize.matching.convergence_step",
    ),
    (
        "localize.matching.lean_std_deg",
        "localize.matching.tilt_std_deg",
    ),
    ("localize.relocalise.by", "localize.global_search.method"),
    (
        "localize.relocalise.hough.pixel",
        "localize.global_search.hough.pixel_size",
    ),
    (
        "localize.relocalise.hough.range",
        "localize.global_search.hough.range_max",
    ),
    (
        "localize.relocalise.hough.step_deg",
        "localize.global_search.hough.angle_step_deg",
    ),
    (
        "localize.relocalise.hough.vote_half_width_px",
        "localize.global_search.hough.vote_half_width_px",
    ),
    (
        "localize.relocalise.hough.lines",
        "localize.global_search.hough.lines_max",
    ),
    (
        "localize.relocalise.hough.array",
        "localize.global_search.hough.lines_per_direction_max",
    ),
    (
        "localize.relocalise.hough.columns_beside",
        "localize.global_search.hough.angle_half_window_steps",
    ),
    (
        "localize.relocalise.hough.line_width_deg",
        "localize.global_search.hough.suppression_angle_deg",
    ),
    (
        "localize.relocalise.hough.line_width",
        "localize.global_search.hough.suppression_distance",
    ),
    (
        "localize.relocalise.hough.tolerance",
        "localize.global_search.hough.tolerance",
    ),
    (
        "localize.relocalise.hough.relevant_deg",
        "localize.global_search.hough.relevance_width_deg",
    ),
    (
        "localize.relocalise.hough.relevant",
        "localize.global_search.hough.relevance_width",
    ),
    (
        "localize.relocalise.hough.orientations",
        "localize.global_search.hough.orientations_max",
    ),
    (
        "localize.relocalise.hough.maxima",
        "localize.global_search.hough.correlation_peaks_max",
    ),
    (
        "localize.relocalise.scan_map.cell",
        "localize.global_search.scan_map.cell",
    ),
    (
        "localize.relocalise.scan_map.outside",
        "localize.global_search.scan_map.margin",
    ),
    (
        "localize.relocalise.scan_map.range",
        "localize.global_search.scan_map.range_max",
    ),
    (
        "localize.relocalise.scan_map.range_min",
        "localize.global_search.scan_map.range_min",
    ),
    (
        "localize.relocalise.scan_map.spiral_turn_deg",
        "localize.global_search.scan_map.spiral_turn_deg",
    ),
    (
        "localize.relocalise.scan_map.reach",
        "localize.global_search.scan_map.kernel_scale",
    ),
    (
        "localize.relocalise.scan_map.half_weight",
        "localize.global_search.scan_map.half_weight_range",
    ),
    (
        "localize.relocalise.scan_map.local_half",
        "localize.global_search.scan_map.local_half",
    ),
    (
        "localize.relocalise.monte_carlo.particles",
        "localize.global_search.monte_carlo.particles",
    ),
    (
        "localize.relocalise.monte_carlo.particles_min",
        "localize.global_search.monte_carlo.particles_min",
    ),
    (
        "localize.relocalise.monte_carlo.point_std",
        "localize.global_search.monte_carlo.point_std",
    ),
    (
        "localize.relocalise.monte_carlo.deviation_max",
        "localize.global_search.monte_carlo.deviation_max",
    ),
    (
        "localize.relocalise.monte_carlo.effective_share",
        "localize.global_search.monte_carlo.effective_share_min",
    ),
    (
        "localize.relocalise.monte_carlo.motion_noise",
        "localize.global_search.monte_carlo.motion_noise",
    ),
    (
        "localize.relocalise.monte_carlo.jitter",
        "localize.global_search.monte_carlo.jitter",
    ),
    (
        "localize.relocalise.monte_carlo.jitter_deg",
        "localize.global_search.monte_carlo.jitter_deg",
    ),
    (
        "localize.relocalise.monte_carlo.spread",
        "localize.global_search.monte_carlo.converged_std",
    ),
    (
        "localize.relocalise.monte_carlo.spread_deg",
        "localize.global_search.monte_carlo.converged_std_deg",
    ),
    (
        "localize.relocalise.monte_carlo.accepted_share",
        "localize.global_search.monte_carlo.inlier_share_min",
    ),
    (
        "localize.relocalise.monte_carlo.cycles_max",
        "localize.global_search.monte_carlo.iterations_max",
    ),
    (
        "localize.relocalise.monte_carlo.seed",
        "localize.global_search.monte_carlo.seed",
    ),
    (
        "localize.relocalise.heading.turn_max_deg",
        "localize.global_search.heading_histogram.search_range_deg",
    ),
    (
        "localize.relocalise.heading.step_deg",
        "localize.global_search.heading_histogram.step_deg",
    ),
    (
        "localize.relocalise.heading.bin",
        "localize.global_search.heading_histogram.bin_width",
    ),
    (
        "localize.relocalise.heading.range_max",
        "localize.global_search.heading_histogram.range_max",
    ),
    ("localize.search.cell", "localize.branch_and_bound.cell"),
    (
        "localize.search.heading_step_deg",
        "localize.branch_and_bound.heading_step_deg",
    ),
    (
        "localize.search.outside",
        "localize.branch_and_bound.margin",
    ),
    (
        "localize.search.range_max",
        "localize.branch_and_bound.range_max",
    ),
    (
        "localize.search.reach",
        "localize.branch_and_bound.kernel_scale",
    ),
    (
        "localize.search.points_max",
        "localize.branch_and_bound.points_max",
    ),
    (
        "localize.search.hypotheses_max",
        "localize.branch_and_bound.hypotheses_max",
    ),
    (
        "localize.search.runner_up_share",
        "localize.branch_and_bound.runner_up_share",
    ),
    (
        "localize.search.runner_up_blocks",
        "localize.branch_and_bound.runner_up_blocks",
    ),
    (
        "localize.search.distinct",
        "localize.branch_and_bound.separation_min",
    ),
    (
        "localize.search.distinct_deg",
        "localize.branch_and_bound.separation_min_deg",
    ),
    (
        "localize.search.evidence_share",
        "localize.branch_and_bound.likelihood_exponent",
    ),
    ("localize.filter.fusion", "localize.filter.kind"),
    (
        "localize.filter.way_noise",
        "localize.filter.odometry_noise_per_metre",
    ),
    (
        "localize.filter.heading_per_way_noise_deg",
        "localize.filter.heading_noise_per_metre_deg",
    ),
    (
        "localize.filter.turn_noise",
        "localize.filter.heading_noise_per_radian",
    ),
    ("localize.filter.drift", "localize.filter.odometry_drift"),
    (
        "localize.filter.drift_deg",
        "localize.filter.odometry_drift_deg",
    ),
    (
        "localize.filter.slide_acceleration",
        "localize.filter.slip_acceleration",
    ),
    (
        "localize.filter.scale_std",
        "localize.filter.odometry_scale_std",
    ),
    (
        "localize.filter.scale_drift",
        "localize.filter.odometry_scale_drift",
    ),
    (
        "localize.filter.twist_noise",
        "localize.filter.velocity_process_noise",
    ),
    (
        "localize.filter.spin_noise",
        "localize.filter.yaw_rate_process_noise",
    ),
    (
        "localize.filter.lean_std_deg",
        "localize.filter.tilt_std_deg",
    ),
    (
        "localize.filter.mount_std_deg",
        "localize.filter.imu_mount_std_deg",
    ),
    (
        "localize.filter.collision.shock",
        "localize.filter.collision.shock_acceleration",
    ),
    (
        "localize.filter.collision.motor_acceleration",
        "localize.filter.collision.motor_acceleration_max",
    ),
    (
        "localize.filter.collision.slip_speed",
        "localize.filter.collision.slip_speed_max",
    ),
    (
        "localize.filter.collision.slip_turn",
        "localize.filter.collision.slip_yaw_rate_max",
    ),
    (
        "localize.filter.collision.significance",
        "localize.filter.collision.significance_sigmas",
    ),
    (
        "localize.filter.collision.hold",
        "localize.filter.collision.hold_time",
    ),
    (
        "localize.filter.collision.longest",
        "localize.filter.collision.timeout",
    ),
    (
        "localize.filter.decentralised.silence",
        "localize.filter.decentralised.wheel_timeout",
    ),
    (
        "localize.attitude.gravity_time",
        "localize.attitude.gravity_time_constant",
    ),
    (
        "localize.attitude.compass_time",
        "localize.attitude.compass_time_constant",
    ),
    (
        "localize.attitude.force_max",
        "localize.attitude.gravity_deviation_max",
    ),
    (
        "localize.attitude.doubt_longest",
        "localize.attitude.gravity_reset_time",
    ),
    (
        "localize.attitude.bend",
        "localize.attitude.tilt_compensation",
    ),
    (
        "localize.attitude.rest_after",
        "localize.attitude.stationary_after",
    ),
    (
        "localize.attitude.rest_rate_deg",
        "localize.attitude.stationary_rate_max_deg",
    ),
    (
        "localize.attitude.rest_time",
        "localize.attitude.bias_time_constant",
    ),
    ("localize.attitude.silence", "localize.attitude.timeout"),
    (
        "localize.attitude.disturbed_deg",
        "localize.attitude.compass_disturbance_deg",
    ),
    (
        "localize.attitude.disturbed_longest",
        "localize.attitude.compass_disturbance_timeout",
    ),
    (
        "localize.attitude.lean_std_deg",
        "localize.attitude.tilt_std_deg",
    ),
    (
        "localize.attitude.lean_offset_std_deg",
        "localize.attitude.tilt_bias_std_deg",
    ),
    ("localize.mode.rule", "localize.mode.suspect_rule"),
    (
        "localize.mode.deviation_max",
        "localize.mode.mean_distance_max",
    ),
    (
        "localize.mode.compass_max_deg",
        "localize.mode.compass_deviation_max_deg",
    ),
    ("localize.mode.gap_max", "localize.mode.odometry_gap_max"),
    (
        "localize.mode.usual_share_part",
        "localize.mode.inlier_share_drop_max",
    ),
    (
        "localize.mode.found_share_min",
        "localize.mode.global_inlier_share_min",
    ),
    (
        "localize.mode.surprise_max",
        "localize.mode.normalized_innovation_max",
    ),
    (
        "localize.mode.push_max",
        "localize.mode.unreported_motion_max",
    ),
    (
        "localize.mode.strikes_max",
        "localize.mode.suspect_frames_max",
    ),
    (
        "localize.mode.rival_share",
        "localize.mode.alternative_margin_share",
    ),
    (
        "localize.mode.rival_points",
        "localize.mode.alternative_margin_points",
    ),
    (
        "localize.mode.check_period",
        "localize.mode.global_check_period",
    ),
    (
        "localize.mode.decided",
        "localize.mode.decision_probability",
    ),
    ("localize.mode.lost_std", "localize.mode.lost_position_std"),
    (
        "localize.mode.lost_std_deg",
        "localize.mode.lost_heading_std_deg",
    ),
    ("localize.mode.past_max", "localize.mode.out_of_order_max"),
    (
        "localize.compass.known",
        "localize.compass.half_known_log_odds",
    ),
    (
        "localize.compass.reading_max",
        "localize.compass.reading_log_odds_max",
    ),
    (
        "localize.compass.evidence_max",
        "localize.compass.log_odds_max",
    ),
    (
        "localize.compass.alive_turn_deg",
        "localize.compass.verified_turn_deg",
    ),
    (
        "localize.compass.noise_time",
        "localize.compass.smoothing_time",
    ),
    (
        "localize.compass.strength_off_max",
        "localize.compass.strength_tolerance",
    ),
    ("world.speed_max", "world.own_speed_max"),
    ("world.lean_std_deg", "world.tilt_std_deg"),
    ("world.flight_share", "world.airborne_range_share"),
    ("world.flight.images_max", "world.flight.hypotheses_max"),
    ("world.ball.wander", "world.ball.acceleration_noise"),
    ("world.ball.speed_std", "world.ball.initial_speed_std"),
    ("world.ball.detection", "world.ball.detection_probability"),
    (
        "world.ball.false_alarm",
        "world.ball.false_alarm_probability",
    ),
    ("world.ball.newborn", "world.ball.birth_probability"),
    ("world.ball.confirmed", "world.ball.confirm_probability"),
    ("world.ball.lost", "world.ball.delete_probability"),
    ("world.ball.std_max", "world.ball.position_std_max"),
    ("world.ball.apart_min", "world.ball.separation_min"),
    ("world.robots.wander", "world.robots.acceleration_noise"),
    ("world.robots.speed_std", "world.robots.initial_speed_std"),
    (
        "world.robots.detection",
        "world.robots.detection_probability",
    ),
    (
        "world.robots.false_alarm",
        "world.robots.false_alarm_probability",
    ),
    ("world.robots.newborn", "world.robots.birth_probability"),
    ("world.robots.confirmed", "world.robots.confirm_probability"),
    ("world.robots.lost", "world.robots.delete_probability"),
    ("world.robots.std_max", "world.robots.position_std_max"),
    ("world.robots.apart_min", "world.robots.separation_min"),
    ("team.mates_max", "team.teammates_max"),
    ("team.age_max", "team.ball_age_max"),
    ("team.forget_after", "team.report_timeout"),
    ("team.ball_wander", "team.ball_acceleration_noise"),
    ("team.std_min", "team.position_std_min"),
    ("team.agree", "team.gate"),
    ("team.half_evidence_max", "team.half_log_odds_max"),
];

/// Renamed values of settings: the setting, its old and its new value.
pub const RENAMED_VALUES: &[(&str, &str, &str)] =
    &[("localize.matching.minimiser", "newton", "gauss_newton")];

/// Settings that no longer exist, and what replaced them.
const REMOVED_KEYS: &[(&str, &str)] = &[
    ("localize.filter.noise_learning", NOISE_LEARNING),
    ("localize.filter.noise_adaptation_rate", NOISE_LEARNING),
    ("localize.filter.sight_std", REPEATED_ERRORS),
    ("localize.filter.sight_std_deg", REPEATED_ERRORS),
    ("localize.filter.systematic_position_std", REPEATED_ERRORS),
    (
        "localize.filter.systematic_heading_std_deg",
        REPEATED_ERRORS,
    ),
    ("world.ball.reach", RANGE_OF_MISSES),
    ("world.ball.range_max", RANGE_OF_MISSES),
    ("world.robots.reach", RANGE_OF_MISSES),
    ("world.robots.range_max", RANGE_OF_MISSES),
    (
        "vision.image_check.seam_ratio_min",
        "a seam is found by its sharp steps, see vision.image_check.seam_share_min",
    ),
];

const NOISE_LEARNING: &str =
    "the noise is learned with its uncertainty, see localize.filter.noise_learning_std";
const RANGE_OF_MISSES: &str =
    "a miss says less the farther the object, see world.robots.half_detection_range";
const REPEATED_ERRORS: &str = "the uncertainty of the map determines errors that images repeat";

/// Refuses an overlay with old names; names each, with `file` and its line if there is one.
pub(super) fn refuse_renamed(overlay: &Table, file: Option<(&Path, &str)>) -> Result<()> {
    let keys = RENAMED_KEYS.iter().filter_map(|(old, new)| {
        find(overlay, old).map(|_| (*old, format!("unknown setting {old} (renamed {new})")))
    });
    let values = RENAMED_VALUES.iter().filter_map(|(key, old, new)| {
        let value = find(overlay, key)?.as_str()?;
        (value == *old).then(|| {
            (
                *key,
                format!("{key} = {old:?}: unknown value (renamed {new:?})"),
            )
        })
    });
    let removed = REMOVED_KEYS.iter().filter_map(|(old, reason)| {
        find(overlay, old).map(|_| (*old, format!("unknown setting {old} (removed: {reason})")))
    });
    let refused: Vec<String> = keys
        .chain(values)
        .chain(removed)
        .map(|(key, message)| match file {
            Some((path, text)) => format!("{}: {message}", key_location(path, text, key)),
            None => message,
        })
        .collect();
    if refused.is_empty() {
        return Ok(());
    }
    Err(anyhow!(refused.join("\n")))
}

/// Settings of a log of an earlier version, under the names of this one. Text that is no TOML comes back as it is.
pub(crate) fn translate(text: &str) -> String {
    let Ok(mut settings) = toml::from_str::<Table>(text) else {
        return text.to_owned();
    };
    for (old, new) in RENAMED_KEYS {
        if let Some(value) = take(&mut settings, old) {
            put(&mut settings, new, value);
        }
    }
    for (old, _) in REMOVED_KEYS {
        take(&mut settings, old);
    }
    for (key, old, new) in RENAMED_VALUES {
        if find(&settings, key).and_then(Value::as_str) == Some(old) {
            put(&mut settings, key, Value::String((*new).to_owned()));
        }
    }
    settings.to_string()
}

/// The value at a dotted path.
fn find<'a>(table: &'a Table, path: &str) -> Option<&'a Value> {
    match path.split_once('.') {
        Some((section, rest)) => find(table.get(section)?.as_table()?, rest),
        None => table.get(path),
    }
}

/// Removes the value at a dotted path, and the sections that it leaves empty.
fn take(table: &mut Table, path: &str) -> Option<Value> {
    let Some((section, rest)) = path.split_once('.') else {
        return table.remove(path);
    };
    let inner = table.get_mut(section)?.as_table_mut()?;
    let value = take(inner, rest);
    if inner.is_empty() {
        table.remove(section);
    }
    value
}

/// Sets the value at a dotted path, making sections as needed.
fn put(table: &mut Table, path: &str, value: Value) {
    let Some((section, rest)) = path.split_once('.') else {
        table.insert(path.to_owned(), value);
        return;
    };
    let inner = table
        .entry(section)
        .or_insert_with(|| Value::Table(Table::new()));
    if let Value::Table(inner) = inner {
        put(inner, rest, value);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::PipelineConfig;

    /// The default configuration with every optional setting.
    fn all_settings() -> Table {
        let mut config = PipelineConfig::default();
        let window = vision::config::ImageRect {
            left_px: 0.0,
            top_px: 0.0,
            width_px: 10.0,
            height_px: 10.0,
        };
        let sensors = &mut config.vision.virtual_sensors;
        (sensors.ball, sensors.kick, sensors.lens) = (Some(window), Some(window), Some(window));
        Table::try_from(&config).expect("a table")
    }

    #[test]
    fn new_names_exist_and_old_names_do_not() {
        let settings = all_settings();
        for (old, new) in RENAMED_KEYS {
            assert!(find(&settings, new).is_some(), "{new} does not exist");
            assert!(find(&settings, old).is_none(), "{old} exists");
        }
        for (key, _, new) in RENAMED_VALUES {
            let text = find(&settings, key).and_then(Value::as_str);
            assert_eq!(text, Some(*new), "{key}");
        }
    }

    #[test]
    fn settings_of_an_earlier_version_are_translated_whole() {
        let mut old = all_settings();
        for (old_key, new_key) in RENAMED_KEYS {
            let value = take(&mut old, new_key).expect(new_key);
            put(&mut old, old_key, value);
        }
        put(
            &mut old,
            "localize.matching.minimiser",
            Value::String("newton".to_owned()),
        );
        let text = old.to_string();
        assert!(toml::from_str::<PipelineConfig>(&text).is_err());
        let translated: Table = toml::from_str(&translate(&text)).expect("TOML");
        assert_eq!(translated, all_settings());
        // What has today's names stays as it is.
        let new = all_settings();
        let same: Table = toml::from_str(&translate(&new.to_string())).expect("TOML");
        assert_eq!(same, new);
    }

    #[test]
    fn old_names_are_refused_with_file_line_and_new_name() {
        let text = "[localize.filter]\ncamera_latency = 0.1\ndrift = 0.02\n\n[localize.search]\ncell = 0.1\n";
        let overlay: Table = toml::from_str(text).expect("TOML");
        let error = refuse_renamed(&overlay, Some((Path::new("own.toml"), text)))
            .expect_err("old names")
            .to_string();
        let lines: Vec<&str> = error.lines().collect();
        assert!(
            lines.contains(
                &"own.toml: line 3: unknown setting localize.filter.drift (renamed localize.filter.odometry_drift)"
            ),
            "{error}"
        );
        assert!(
            lines.contains(
                &"own.toml: line 6: unknown setting localize.search.cell (renamed localize.branch_and_bound.cell)"
            ),
            "{error}"
        );
    }
}
