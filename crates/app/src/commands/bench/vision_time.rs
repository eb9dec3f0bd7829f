//! How long does vision take? The sample recording, and a simulated image of 1024 × 1024.

use std::hint::black_box;
use std::time::Instant;

use anyhow::{Context, Result};
use vision::image::{Image, ImageView, PixelFormat};
use vision::scan::pattern::ScanLines;
use vision::{Mount, Profile, Vision, optics};

use super::measure::{CallTimes, Figures, REPEATS};
use super::simulation_time::DemoScene;
use pipeline::paths;
use pipeline::sample::Sample;
use pipeline::setup::Setup;
use pipeline::{Pipeline, PipelineConfig};

/// Figures of `measure_vision`.
pub(super) const NAMES: &[&str] = &[
    "see_lines_480",
    "see_half_lines_480",
    "see_all_480",
    "see_new_light_480",
    "image_to_pose_480",
    "image_to_pose_480_p99",
];

/// Times line points (along all scan lines, and along half of them, as while a pose is tracked), all features, colour learning, and image to pose, over the images of a drive.
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
    if !figures.wants("image_to_pose_480_p99") {
        return Ok(());
    }
    let recording =
        pipeline::recording::Recording::open(&folder, crate::commands::locate::EXTERNAL_POINT_STD)?;
    let samples: Vec<Sample> = recording.collect();
    let mut image_to_pose = Vec::new();
    for _ in 0..10 {
        let mut pipeline = Pipeline::new(&setup, &config)?;
        for sample in &samples {
            let started = Instant::now();
            if let Some(cycle) = pipeline.process_sample(sample.clone()) {
                // The first image is left out: it learns the colours and searches the field.
                if cycle
                    .inputs
                    .odometry
                    .first()
                    .is_some_and(|odometry| odometry.stamp.0 > 0)
                {
                    image_to_pose.push(started.elapsed().as_secs_f64() * 1e3);
                }
            }
        }
    }
    let times = CallTimes::of(image_to_pose);
    figures.push_times("image_to_pose_480", &times, ["<= 0.45", "<= 0.9"]);
    Ok(())
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
