//! How long does vision take? The sample recording, and a simulated image of 1024 × 1024.

use std::hint::black_box;
use std::time::Instant;

use anyhow::{Context, Result};
use localize::Mode;
use vision::image::{Image, ImageView, PixelFormat};
use vision::scan::pattern::ScanLines;
use vision::{Mount, Profile, Vision, optics};

use super::measure::{CallTimes, Figures, REPEATS};
use super::simulation_time::DemoScene;
use pipeline::paths;
use pipeline::sample::Sample;
use pipeline::setup::Setup;
use pipeline::simulation::Simulation;
use pipeline::{Pipeline, PipelineConfig};

/// Figures of `measure_vision`.
pub(super) const NAMES: &[&str] = &[
    "see_lines_480",
    "see_half_lines_480",
    "see_all_480",
    "see_new_light_480",
    "image_to_pose_480",
    "image_to_pose_480_p99",
    "image_to_world_480",
    "image_to_world_480_p99",
    "image_to_pose_30_hz",
    "image_to_pose_30_hz_p99",
    "image_to_world_30_hz",
    "image_to_world_30_hz_p99",
];

/// Times line points (along all scan lines, and along half of them, as while a pose is tracked), all features, and colour
/// learning over the images of a drive; then image to pose, and image to ball and robots.
pub(super) fn measure_vision(figures: &mut Figures) -> Result<()> {
    let folder = paths::find_resource("samples/sequence")?;
    let setup = Setup::load(&folder.join("robot.toml"), None)?;
    let (camera, map) = setup
        .camera
        .as_ref()
        .context("samples/sequence has no camera")?;
    let mut images = Vec::new();
    for number in 0..8 {
        images.push(Image::load(
            &folder.join(format!("frames/{number:03}.jpg")),
        )?);
    }
    let config = PipelineConfig::default();
    let mut vision = Vision::new(
        map,
        camera,
        setup.field.config.line_width,
        config.vision.clone(),
    )?;
    let mut number = 0;
    let mut next = || {
        number = (number + 1) % images.len();
        images[number].view()
    };
    figures.time_calls("see_lines_480", "<= 0.15", REPEATS, || {
        drop(black_box(vision.process_lines(&next())))
    });
    let mut halves = [ScanLines::Even, ScanLines::Odd].into_iter().cycle();
    figures.time_calls("see_half_lines_480", "<= 0.15", REPEATS, || {
        let lines = halves.next().unwrap_or_default();
        drop(black_box(vision.process_lines_with(&next(), lines)))
    });
    figures.time_calls("see_all_480", "<= 0.35", REPEATS, || {
        drop(black_box(vision.process(&next())))
    });
    figures.time_calls("see_new_light_480", "-", 30, || {
        vision.reset_colour_model();
        drop(black_box(vision.process(&next())));
    });
    if !NAMES[4..].iter().any(|name| figures.wants(name)) {
        return Ok(());
    }
    let recording =
        pipeline::recording::Recording::open(&folder, crate::commands::locate::EXTERNAL_POINT_STD)?;
    let samples: Vec<Sample> = recording.collect();
    let [to_pose, to_world] = time_cycles(&samples, &setup, 50)?;
    figures.push_times("image_to_pose_480", &to_pose, ["<= 0.45", "<= 0.9"]);
    figures.push_times("image_to_world_480", &to_world, ["-", "-"]);
    let (samples, setup) = simulated_drive()?;
    let [to_pose, to_world] = time_cycles(&samples, &setup, 10)?;
    figures.push_times("image_to_pose_30_hz", &to_pose, ["<= 0.45", "<= 0.9"]);
    figures.push_times("image_to_world_30_hz", &to_world, ["-", "-"]);
    Ok(())
}

/// Times from an image to its pose and to its ball and robots, over a drive that is repeated, once its pose is tracked: the
/// images before learn the colours and search the field.
fn time_cycles(samples: &[Sample], setup: &Setup, repeats: usize) -> Result<[CallTimes; 2]> {
    let [mut to_pose, mut to_world] = [Vec::new(), Vec::new()];
    for _ in 0..repeats {
        let mut pipeline = Pipeline::new(setup, &PipelineConfig::default())?;
        let mut is_tracking = false;
        for sample in samples.iter().cloned() {
            let started = Instant::now();
            let elapsed_ms = || started.elapsed().as_secs_f64() * 1e3;
            let mut pose_ms = 0.0;
            let cycle = pipeline.process_sample_with(sample, |_| pose_ms = elapsed_ms());
            let world_ms = elapsed_ms();
            if let Some(cycle) = cycle {
                if is_tracking {
                    to_pose.push(pose_ms);
                    to_world.push(world_ms);
                }
                is_tracking = cycle.estimate.mode == Mode::Tracking;
            }
        }
    }
    Ok([to_pose, to_world].map(CallTimes::of))
}

/// Three seconds of the demo: while the pose is tracked, half of the scan lines are read in each image.
fn simulated_drive() -> Result<(Vec<Sample>, Setup)> {
    let demo = paths::find_resource("config/scenarios/demo.toml")?;
    let mut drive = Simulation::load(&demo, None, Some(f64::MAX))?;
    let mut setup = drive.setup()?;
    // Nobody passes commands to the camera.
    setup.robot.exposure = None;
    let (mut samples, mut images) = (Vec::new(), 0);
    while images < 90 {
        let sample = drive.next_sample();
        images += usize::from(matches!(sample, Sample::Image(_)));
        samples.push(sample);
    }
    Ok((samples, setup))
}

/// Figures of `measure_vision_large`.
pub(super) const LARGE_NAMES: &[&str] = &["see_lines_1024", "see_all_1024"];

/// The same features in an image of 1024 × 1024: the demo's robot among nine others.
pub(super) fn measure_vision_large(figures: &mut Figures) -> Result<()> {
    const SIDE_PX: usize = 1024;
    let demo = DemoScene::load(SIDE_PX)?;
    let profile = Profile::load(&demo.mirror)?;
    let map = optics::trace_rays(&demo.camera, &profile, &Mount::default())?.ground_map();
    let mut renderer = demo.renderer()?;
    let mut images = Vec::new();
    for turn in 0..4u8 {
        let mut rgb = Vec::new();
        demo.render(&mut renderer, f32::from(turn), &mut rgb);
        images.push(rgb);
    }
    let mut vision = Vision::new(
        &map,
        &demo.camera,
        demo.field.config.line_width,
        PipelineConfig::default().vision,
    )?;
    let mut number = 0;
    let mut next = || {
        number = (number + 1) % images.len();
        ImageView::packed(SIDE_PX, SIDE_PX, PixelFormat::Rgb8, &images[number])
    };
    figures.time_calls("see_lines_1024", "-", REPEATS, || {
        drop(black_box(vision.process_lines(&next())))
    });
    figures.time_calls("see_all_1024", "<= 0.8", REPEATS, || {
        drop(black_box(vision.process(&next())))
    });
    Ok(())
}
