//! How well is the place found? Seeded drives, kidnaps, single frames and rendered stills, scored against truth.

use anyhow::{Context, Result};
use localize::drive::{DriveConfig, anywhere};
use localize::experiment::{TrackScore, find, kidnap, track};
use localize::frame::wrap_angle;
use localize::{Field, LocalizeConfig, Pose, Stamp};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use sim::Scenario;
use sim::render::{Renderer, Scene, Setting};
use vision::Profile;
use vision::image::Image;
use vision::robot::RobotConfig;

use super::Figure;
use crate::cycle::{Spine, SpineConfig};
use crate::home;
use crate::sample::{Content, Frame, Sample};
use crate::setup::Setup;

/// Figures of `drives`.
pub(super) const DRIVES: &[&str] = &[
    "track_mean",
    "track_mean_heading",
    "track_max",
    "track_max_heading",
    "track_nees",
    "track_false_alarms",
    "track_half_outliers",
    "track_3_m",
    "track_3_m_lost",
    "track_40_rays",
    "occluded_12_mean",
    "occluded_12_max",
    "occluded_25_mean",
    "occluded_25_max",
    "occluded_50_mean",
    "occluded_50_mean_heading",
    "occluded_50_max",
    "find_no_prior",
    "find_no_prior_first_five",
    "find_compass",
    "kidnap_said",
    "kidnap_back",
];

/// Figures of `stills`.
pub(super) const STILLS: &[&str] = &[
    "stills_2001_found",
    "stills_2001_mean_x",
    "stills_2001_mean_y",
    "stills_2001_std_x",
    "stills_2001_std_y",
    "stills_2001_std_heading",
];

fn figure(name: &'static str, value: f64, unit: &'static str, wanted: &'static str) -> Figure {
    Figure {
        name,
        value,
        unit,
        wanted,
    }
}

/// The larger of the mean deviations in x and y, or of the largest ones, centimetres.
fn worse_cm([x, y, _]: [f32; 3]) -> f64 {
    100.0 * f64::from(x.max(y))
}

/// Drives on 18 × 12 m as existing systems were measured on: 30 Hz, σ 3 to 5 cm, odometry biased by 3 %.
pub(super) fn drives(figures: &mut Vec<Figure>) -> Result<()> {
    let field = Field::load(&home::find("config/fields/msl_18x12.toml")?)?;
    let config = LocalizeConfig::default();
    let usual = DriveConfig::default();
    // Ten minutes, by one robot after another.
    let score = track(&field, &config, &usual, 0..20, 900);
    figures.extend([
        figure("track_mean", worse_cm(score.mean), "cm", "<= 0.7"),
        figure(
            "track_mean_heading",
            f64::from(score.mean[2]),
            "degrees",
            "<= 0.12",
        ),
        figure("track_max", worse_cm(score.max), "cm", "<= 4"),
        figure(
            "track_max_heading",
            f64::from(score.max[2]),
            "degrees",
            "<= 1",
        ),
        figure("track_nees", f64::from(score.nees), "", "about 3"),
        figure(
            "track_false_alarms",
            score.alarms as f64,
            "frames of 17400",
            "0",
        ),
    ]);
    let with = |drive: DriveConfig| track(&field, &config, &drive, 0..5, 900);
    let outliers = with(DriveConfig {
        outliers: 0.5,
        ..usual.clone()
    });
    let near = with(DriveConfig {
        range: 3.0,
        ..usual.clone()
    });
    let few = with(DriveConfig {
        rays: 40,
        ..usual.clone()
    });
    figures.extend([
        figure(
            "track_half_outliers",
            worse_cm(outliers.mean),
            "cm",
            "<= 1.2",
        ),
        figure("track_3_m", worse_cm(near.mean), "cm", "<= 2.5"),
        figure("track_3_m_lost", near.lost as f64, "frames of 4350", "0"),
        figure("track_40_rays", worse_cm(few.mean), "cm", "<= 1.2"),
    ]);
    let covered = |covered: f32| -> TrackScore {
        with(DriveConfig {
            covered,
            ..usual.clone()
        })
    };
    let [eighth, quarter, half] = [0.125, 0.25, 0.5].map(covered);
    figures.extend([
        figure("occluded_12_mean", worse_cm(eighth.mean), "cm", "<= 2"),
        figure("occluded_12_max", worse_cm(eighth.max), "cm", "<= 10"),
        figure("occluded_25_mean", worse_cm(quarter.mean), "cm", "<= 2"),
        figure("occluded_25_max", worse_cm(quarter.max), "cm", "<= 10"),
        figure("occluded_50_mean", worse_cm(half.mean), "cm", "<= 2"),
        figure(
            "occluded_50_mean_heading",
            f64::from(half.mean[2].to_radians()),
            "rad",
            "<= 0.01",
        ),
        figure("occluded_50_max", worse_cm(half.max), "cm", "<= 10"),
    ]);
    let frames = 1000;
    let percent = |part: usize, of: usize| 100.0 * part as f64 / of as f64;
    let blind = find(&field, &config, &usual, false, 1, frames);
    let led = find(&field, &config, &usual, true, 1, frames);
    let covered = DriveConfig {
        covered: 0.25,
        ..usual
    };
    let carried = kidnap(&field, &config, &covered, 1, 200);
    figures.extend([
        figure(
            "find_no_prior",
            percent(blind.first, frames),
            "%",
            ">= 97.5",
        ),
        figure(
            "find_no_prior_first_five",
            percent(blind.first_five, frames),
            "%",
            ">= 99.5",
        ),
        figure("find_compass", percent(led.first, frames), "%", ">= 99.7"),
        figure(
            "kidnap_said",
            percent(carried.said, carried.kidnaps),
            "%",
            ">= 99",
        ),
        figure(
            "kidnap_back",
            percent(carried.back, carried.kidnaps),
            "%",
            ">= 99",
        ),
    ]);
    Ok(())
}

/// The experiment of lima2001 4.6: 90 images on 9 × 4.5 m through the isometric mirror, each located by itself by the
/// Hough transform (the goals' colours tell the half), refined by matching.
pub(super) fn stills(figures: &mut Vec<Figure>) -> Result<()> {
    const COUNT: usize = 90;
    let (scenario, _) = Scenario::load(&home::find("config/scenarios/still_9x4.5.toml")?)?;
    let robot_file = home::find("config/robots/default.toml")?;
    let robot = RobotConfig::load(&robot_file)?;
    let field = Field::load(&home::find("config/fields/msl_2001.toml")?)?;
    let camera = robot.camera.as_ref().context("the robot has no camera")?;
    let mirror = robot.mirror.as_ref().context("the robot has no mirror")?;
    let mut renderer = Renderer::new(&Setting {
        camera,
        profile: &Profile::load(&mirror.profile)?,
        mount: scenario.mount,
        body: &robot.body.clone().unwrap_or_default(),
        field: &field,
        light: &scenario.light,
        blur_px: scenario.film.blur_px,
        seed: scenario.seed,
    })?;
    let (width_px, height_px) = (camera.width_px, camera.height_px);
    let setup = Setup::new(&robot_file, robot.clone(), field.clone(), None)?;
    let mut spine = Spine::new(&setup, &SpineConfig::preset("lima2001")?)?;
    let mut rng = ChaCha8Rng::seed_from_u64(scenario.seed);
    let mut errors: Vec<[f64; 3]> = Vec::new();
    let mut rgb = Vec::new();
    for number in 0..COUNT {
        let free = |pose: &Pose| {
            pose.x.abs() < field.length / 2.0 - 0.4 && pose.y.abs() < field.width / 2.0 - 0.4
        };
        let truth = std::iter::repeat_with(|| anywhere(&field, &mut rng))
            .find(free)
            .context("no place on the field")?;
        let scene = Scene {
            pose: truth,
            robots: &[],
            ball: None,
            lamp: [1.0; 3],
            occlusions: &[],
        };
        renderer.render(&scene, &scenario.film, &mut rgb);
        let image = Image {
            width_px,
            height_px,
            rgb: rgb.clone(),
        };
        let frame = Frame {
            stamp: Stamp::from_seconds(40.0 * number as f64),
            content: Content::Image(image.into()),
        };
        let cycle = spine.take(Sample::Frame(frame));
        let Some(pose) = cycle.and_then(|cycle| cycle.estimate.pose) else {
            continue;
        };
        let turn = wrap_angle(pose.theta - truth.theta).to_degrees();
        errors.push([pose.x - truth.x, pose.y - truth.y, turn].map(f64::from));
    }
    let found = errors
        .iter()
        .filter(|[x, y, turn]| x.hypot(*y) < 0.5 && turn.abs() < 15.0);
    let found: Vec<[f64; 3]> = found.copied().collect();
    let count = found.len().max(1) as f64;
    let mean = |i: usize| found.iter().map(|error| error[i]).sum::<f64>() / count;
    let std = |i: usize| {
        let mean = mean(i);
        (found
            .iter()
            .map(|error| (error[i] - mean).powi(2))
            .sum::<f64>()
            / count)
            .sqrt()
    };
    figures.extend([
        figure("stills_2001_found", found.len() as f64, "of 90", "90"),
        figure("stills_2001_mean_x", 100.0 * mean(0).abs(), "cm", "<= 1"),
        figure("stills_2001_mean_y", 100.0 * mean(1).abs(), "cm", "<= 1"),
        figure("stills_2001_std_x", 100.0 * std(0), "cm", "<= 3"),
        figure("stills_2001_std_y", 100.0 * std(1), "cm", "<= 3"),
        figure("stills_2001_std_heading", std(2), "degrees", "<= 0.5"),
    ]);
    Ok(())
}
