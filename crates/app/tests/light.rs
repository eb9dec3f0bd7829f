//! The light falls to a quarter and rises to four times the start: the camera follows, and no frame's place is lost.

use std::path::Path;

use localize::estimate::Mode;
use pipeline::sample::{Sample, SourceImage};
use pipeline::simulation::Simulation;
use pipeline::{Pipeline, PipelineConfig};
use vision::Image;

/// The carpet's brightness in the image is back when it is within this factor of what it was before the change.
const RECOVERY_FACTOR: f32 = 1.2;

/// The median of green around the robot, of 255: most of it is carpet, whatever stands or lies there.
fn brightness(image: &Image) -> f32 {
    let reach = image.width_px / 4;
    let around = |middle: usize| middle - reach..middle + reach;
    let mut greens: Vec<u8> = around(image.height_px / 2)
        .flat_map(|row| around(image.width_px / 2).map(move |column| row * image.width_px + column))
        .map(|pixel| image.rgb[3 * pixel + 1])
        .collect();
    greens.sort_unstable();
    f32::from(greens[greens.len() / 2])
}

/// When each frame was taken, its brightness, and whether its place was tracked.
fn run_light_scenario(keyframes: &str, duration: f64, seed: u64) -> Vec<(f64, f32, bool)> {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("../..");
    let scenario = root.join("config/scenarios/light_change.toml");
    let over = toml::from_str(&format!("[light]\nkeyframes = [{keyframes}]")).expect("keyframes");
    let mut simulation = Simulation::with_overrides(&scenario, &over, Some(seed), Some(duration))
        .expect("a scenario");
    let setup = simulation.setup().expect("a setup");
    let mut spine = Pipeline::new(&setup, &PipelineConfig::default()).expect("a spine");
    let mut frames = Vec::new();
    while let Some(sample) = simulation.next() {
        let is_frame = matches!(sample, Sample::Image(_));
        let Some(cycle) = spine.process_sample(sample).filter(|_| is_frame) else {
            continue;
        };
        let seconds = cycle.stamp.seconds();
        let Some(SourceImage::Rgb(image)) = &cycle.inputs.image else {
            panic!("the simulator's frames are images");
        };
        // The first frames find the place; from then on it is carried on.
        let tracked = cycle.estimate.mode == Mode::Tracking || seconds < 0.2;
        frames.push((seconds, brightness(image), tracked));
        if let Some(command) = cycle.camera_command() {
            simulation.command_camera(command);
        }
    }
    frames
}

/// Frames after `changed` (seconds) until the brightness is what it was at `before`, and stays so until `until`.
fn frames_until_recovery(
    frames: &[(f64, f32, bool)],
    before: f64,
    changed: f64,
    until: f64,
) -> usize {
    let at_before = frames.iter().rfind(|frame| frame.0 <= before);
    let wanted = at_before.expect("a frame before the change").1;
    let after: Vec<f32> = frames
        .iter()
        .filter(|frame| (changed..until).contains(&frame.0))
        .map(|frame| frame.1)
        .collect();
    let off = |light: &f32| (light / wanted).ln().abs() > RECOVERY_FACTOR.ln();
    after.iter().rposition(off).map_or(0, |last| last + 1)
}

#[test]
fn exposure_recovers_within_10_frames_of_a_fourfold_light_change() {
    let keyframes = "
        { time = 1.0, level = 1.0 }, { time = 2.0, level = 0.25 },
        { time = 3.0, level = 0.25 }, { time = 4.0, level = 1.0 },
        { time = 5.0, level = 1.0 }, { time = 6.0, level = 4.0 }";
    for seed in 0..3 {
        let frames = run_light_scenario(keyframes, 7.0, seed);
        assert!(frames.len() > 200, "{} frames", frames.len());
        let lost = frames.iter().filter(|frame| !frame.2).count();
        let fallen = frames_until_recovery(&frames, 1.0, 2.0, 3.0);
        let risen = frames_until_recovery(&frames, 5.0, 6.0, 7.0);
        println!(
            "seed {seed}: brightness from {:.0}, back after {fallen} and {risen} frames, {lost} lost",
            frames[20].1
        );
        assert_eq!(lost, 0, "frames lost with seed {seed}");
        assert!(fallen <= 10, "{fallen} frames after a quarter, seed {seed}");
        assert!(risen <= 10, "{risen} frames after four times, seed {seed}");
    }
}

#[test]
fn sudden_light_change_loses_no_pose() {
    let keyframes = "
        { time = 1.0, level = 1.0 }, { time = 1.001, level = 0.25 },
        { time = 2.5, level = 0.25 }, { time = 2.501, level = 1.0 },
        { time = 4.0, level = 1.0 }, { time = 4.001, level = 4.0 }";
    let frames = run_light_scenario(keyframes, 5.5, 0);
    let lost = frames.iter().filter(|frame| !frame.2).count();
    let [fallen, back, risen] = [(0.99, 1.01, 2.5), (2.49, 2.51, 4.0), (3.99, 4.01, 5.5)]
        .map(|(before, changed, until)| frames_until_recovery(&frames, before, changed, until));
    println!("switched: back after {fallen}, {back} and {risen} frames, {lost} lost");
    assert_eq!(lost, 0, "frames lost");
    assert!(
        fallen.max(back).max(risen) <= 10,
        "{fallen}, {back}, {risen} frames"
    );
}
