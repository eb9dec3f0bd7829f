//! The light falls to a quarter and rises fourfold: exposure control follows, and no pose is lost.

use std::path::Path;

use localize::estimate::Mode;
use pipeline::sample::{Sample, SourceImage};
use pipeline::simulation::Simulation;
use pipeline::{Pipeline, PipelineConfig};
use vision::Image;

/// The brightness has recovered when it is within this factor of the brightness before the change.
const RECOVERY_FACTOR: f32 = 1.2;

/// Median of the green channel around the robot, 0 to 255: most of the pixels show carpet.
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

/// An image of a run.
struct ImageRecord {
    /// Seconds after the start.
    time: f64,
    brightness: f32,
    tracked: bool,
}

fn run_light_scenario(keyframes: &str, duration: f64, seed: u64) -> Vec<ImageRecord> {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("../..");
    let scenario = root.join("config/scenarios/light_change.toml");
    let overrides =
        toml::from_str(&format!("[light]\nkeyframes = [{keyframes}]")).expect("keyframes");
    let mut simulation =
        Simulation::with_overrides(&scenario, &overrides, Some(seed), Some(duration))
            .expect("a scenario");
    let setup = simulation.setup().expect("a setup");
    let mut pipeline = Pipeline::new(&setup, &PipelineConfig::default()).expect("a pipeline");
    let mut images = Vec::new();
    while let Some(sample) = simulation.next() {
        let is_image = matches!(sample, Sample::Image(_));
        let Some(cycle) = pipeline.process_sample(sample).filter(|_| is_image) else {
            continue;
        };
        let time = cycle.stamp.seconds();
        let Some(SourceImage::Rgb(image)) = &cycle.inputs.image else {
            panic!("a simulated image has pixels");
        };
        // The first images find the pose by a global search.
        let tracked = cycle.estimate.mode == Mode::Tracking || time < 0.2;
        images.push(ImageRecord {
            time,
            brightness: brightness(image),
            tracked,
        });
        if let Some(command) = cycle.camera_command() {
            simulation.command_camera(command);
        }
    }
    images
}

/// Number of images after `changed` (seconds) until the brightness has recovered to that at `before` and stays so until
/// `until`.
fn images_until_recovery(images: &[ImageRecord], before: f64, changed: f64, until: f64) -> usize {
    let reference = images.iter().rfind(|image| image.time <= before);
    let reference = reference.expect("an image before the change").brightness;
    let after: Vec<f32> = images
        .iter()
        .filter(|image| (changed..until).contains(&image.time))
        .map(|image| image.brightness)
        .collect();
    let deviates = |brightness: &f32| (brightness / reference).ln().abs() > RECOVERY_FACTOR.ln();
    after.iter().rposition(deviates).map_or(0, |last| last + 1)
}

#[test]
fn exposure_recovers_within_10_frames_of_a_fourfold_light_change() {
    let keyframes = "
        { time = 1.0, level = 1.0 }, { time = 2.0, level = 0.25 },
        { time = 3.0, level = 0.25 }, { time = 4.0, level = 1.0 },
        { time = 5.0, level = 1.0 }, { time = 6.0, level = 4.0 }";
    for seed in 0..3 {
        let images = run_light_scenario(keyframes, 7.0, seed);
        assert!(images.len() > 200, "{} images", images.len());
        let lost = images.iter().filter(|image| !image.tracked).count();
        let fallen = images_until_recovery(&images, 1.0, 2.0, 3.0);
        let risen = images_until_recovery(&images, 5.0, 6.0, 7.0);
        println!(
            "seed {seed}: brightness {:.0}, recovery after {fallen} and {risen} images, {lost} lost",
            images[20].brightness
        );
        assert_eq!(lost, 0, "poses lost with seed {seed}");
        assert!(fallen <= 10, "{fallen} images after the fall, seed {seed}");
        assert!(risen <= 10, "{risen} images after the rise, seed {seed}");
    }
}

#[test]
fn sudden_light_change_loses_no_pose() {
    let keyframes = "
        { time = 1.0, level = 1.0 }, { time = 1.001, level = 0.25 },
        { time = 2.5, level = 0.25 }, { time = 2.501, level = 1.0 },
        { time = 4.0, level = 1.0 }, { time = 4.001, level = 4.0 }";
    let images = run_light_scenario(keyframes, 5.5, 0);
    let lost = images.iter().filter(|image| !image.tracked).count();
    let [fallen, back, risen] = [(0.99, 1.01, 2.5), (2.49, 2.51, 4.0), (3.99, 4.01, 5.5)]
        .map(|(before, changed, until)| images_until_recovery(&images, before, changed, until));
    println!("sudden change: recovery after {fallen}, {back} and {risen} images, {lost} lost");
    assert_eq!(lost, 0, "poses lost");
    assert!(
        fallen.max(back).max(risen) <= 10,
        "{fallen}, {back}, {risen} images"
    );
}
