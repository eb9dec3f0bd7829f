//! Writes what was calibrated in the window as a robot folder.

use std::path::Path;

use anyhow::{Context, Result, ensure};
use pipeline::PipelineConfig;
use pipeline::config::PIPELINE_FILE;
use pipeline::log::Header;
use vision::colour::lookup_table::CLASS_NAMES;
use vision::output_file::write_file;

use super::brush::Brush;
use super::session::Session;
use super::settings;

/// Writes robot.toml, field.toml, map.npz (masked pixels show no ground), the colour table, the labels and the settings.
///
/// # Errors
/// A source without a robot, a mask of another size than the map, or a file that cannot be written.
pub(crate) fn write_robot_folder(session: &Session, dir: &Path) -> Result<()> {
    std::fs::create_dir_all(dir).with_context(|| format!("cannot create {}", dir.display()))?;
    let scene = session
        .scene
        .as_ref()
        .context("no robot configuration to write")?;
    let brush = &session.calibration.brush;
    let mut map = scene.camera.as_ref().map(|camera| (*camera.map).clone());
    if let (Some(map), Some(mask)) = (&mut map, &brush.mask) {
        ensure!(
            mask.len() == map.x.len(),
            "mask and ground map differ in size"
        );
        for (pixel, visible) in mask.iter().enumerate() {
            if !visible {
                (map.x[pixel], map.y[pixel]) = (f32::NAN, f32::NAN);
            }
        }
    }
    let table = session
        .colour_table
        .as_deref()
        .or(scene.colour_table.as_ref());
    let header = Header::new("view", None).with_robot(&scene.robot, map.as_ref(), table)?;
    let overlay = settings::diff_overlay(&PipelineConfig::default(), session.settings.config());
    header
        .with_file(PIPELINE_FILE, overlay.to_string())
        .save_files(dir)?;
    if brush.labels.is_empty() {
        return Ok(());
    }
    write_labels(dir, brush)
}

/// Writes the labels as `labels.csv`, with their images.
fn write_labels(dir: &Path, brush: &Brush) -> Result<()> {
    for (number, (_, image)) in brush.labelled_images.iter().enumerate() {
        image.save(&dir.join(format!("label_{number}.png")))?;
    }
    let mut text = "file,u,v,class\n".to_owned();
    for ((stamp, [u, v]), label) in &brush.labels {
        let place = brush
            .labelled_images
            .iter()
            .position(|(labelled, _)| labelled == stamp);
        let Some(number) = place else { continue };
        text += &format!("label_{number}.png,{u},{v},{}\n", CLASS_NAMES[label.class]);
    }
    let path = dir.join("labels.csv");
    write_file(&path, text).with_context(|| format!("cannot write {}", path.display()))
}
