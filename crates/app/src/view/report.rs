//! Screenshots of the window, and reports: a folder with the state of the shown cycle and of the run.

use std::fmt::Write as _;
use std::path::Path;

use anyhow::{Context, Result};
use eframe::egui::ColorImage;
use localize::estimate::Mode;
use vision::image::Image;
use vision::output_file::write_file;

use super::session::Session;
use super::settings;
use super::source::decoded_cycle::rgb_image;
use super::time_series::Quantity;
use pipeline::PipelineConfig;

/// Columns of run.csv after the pose and the mode.
const COLUMNS: [(&str, Quantity); 8] = [
    ("error_m", Quantity::PositionError),
    ("heading_error_deg", Quantity::HeadingError),
    ("std_x_m", Quantity::StdX),
    ("std_y_m", Quantity::StdY),
    ("residual_m", Quantity::Residual),
    ("line_points", Quantity::LinePoints),
    ("see_ms", Quantity::VisionTime),
    ("localize_ms", Quantity::LocalizationTime),
];

/// Writes a screenshot of the window.
pub(crate) fn write_screenshot(picture: &ColorImage, path: &Path) -> Result<()> {
    let rgb = picture
        .pixels
        .iter()
        .flat_map(|pixel| [pixel.r(), pixel.g(), pixel.b()])
        .collect();
    let [width_px, height_px] = picture.size;
    let image = Image {
        width_px,
        height_px,
        rgb,
    };
    Ok(image.save(path)?)
}

/// Writes a report: report.md, run.csv, overlay.toml, and images of the window and the camera.
pub(crate) fn write_report(
    folder: &Path,
    session: &Session,
    window: Option<&ColorImage>,
) -> Result<()> {
    std::fs::create_dir_all(folder)
        .with_context(|| format!("cannot create {}", folder.display()))?;
    let write = |name: &str, text: String| {
        let path = folder.join(name);
        write_file(&path, text).with_context(|| format!("cannot write {}", path.display()))
    };
    if let Some(window) = window {
        write_screenshot(window, &folder.join("window.png"))?;
    }
    let image = session.shown.as_ref().and_then(|now| rgb_image(&now.cycle));
    if let Some(image) = image {
        image.save(&folder.join("camera.png"))?;
    }
    write("run.csv", run_csv(session))?;
    let overlay = settings::diff_overlay(&PipelineConfig::default(), session.settings.config());
    write("overlay.toml", overlay.to_string())?;
    write("report.md", report_markdown(session)?)
}

fn run_csv(session: &Session) -> String {
    let names: Vec<&str> = COLUMNS.iter().map(|(name, _)| *name).collect();
    let mut text = format!("stamp_s,x_m,y_m,theta_rad,mode,{}\n", names.join(","));
    for sample in session.series.samples() {
        let number = |value: f32| {
            if value.is_finite() {
                format!("{value}")
            } else {
                String::new()
            }
        };
        let mode = |mode: Mode| match session.holds_poses {
            true => format!("{mode:?}").to_lowercase(),
            false => String::new(),
        };
        let values: Vec<String> = sample
            .pose
            .into_iter()
            .map(number)
            .chain([mode(sample.mode)])
            .chain(
                COLUMNS
                    .iter()
                    .map(|(_, quantity)| number(sample.value(*quantity))),
            )
            .collect();
        text += &format!("{:.6},{}\n", sample.time, values.join(","));
    }
    text
}

fn report_markdown(session: &Session) -> Result<String> {
    let mut text = format!("# {}\n\n", session.title);
    writeln!(text, "mirrorball {}\n", env!("CARGO_PKG_VERSION"))?;
    if let Some(now) = &session.shown {
        let estimate = &now.cycle.estimate;
        writeln!(
            text,
            "At {:.3} s: {}",
            now.cycle.stamp.seconds(),
            session.mode_and_reason(estimate)
        )?;
        if let Some(pose) = estimate.pose {
            writeln!(
                text,
                "Pose {:.3} m, {:.3} m, {:.2}°; residual {:.1} cm, {} line points, {:.0} % on markings",
                pose.x,
                pose.y,
                pose.theta.to_degrees(),
                100.0 * estimate.inlier_rms,
                estimate.line_points,
                100.0 * estimate.inlier_share
            )?;
        }
    }
    if let Some(error) = session.series.mean_error() {
        writeln!(
            text,
            "\nMean position error of the run: {:.2} cm",
            100.0 * error
        )?;
    }
    if let Some(recompute) = &session.recompute {
        let error = recompute.series.mean_error().unwrap_or(f32::NAN);
        writeln!(
            text,
            "Recomputed with overlay.toml: {:.2} cm, {} of {} poses differ",
            100.0 * error,
            recompute.changed_poses,
            recompute.cycles
        )?;
    }
    writeln!(text, "\n## Marks\n")?;
    for mark in &session.marks {
        writeln!(text, "- {:.3} s {}", mark.time, mark.text)?;
    }
    writeln!(text, "\n## Devices\n")?;
    for device in &session.devices.devices {
        let state = device.state(session.devices.stamp).label();
        writeln!(
            text,
            "- {}: {state}, {} samples, longest gap {:.0} ms, {} errors",
            device.name,
            device.samples,
            1e3 * device.longest_gap,
            device.fault_count
        )?;
    }
    let notices = session.notices();
    if !notices.is_empty() {
        writeln!(text, "\n## Missing\n")?;
        for line in &notices {
            writeln!(text, "- {line}")?;
        }
    }
    Ok(text)
}
