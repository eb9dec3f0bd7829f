//! Calibration panel: colour labels, mask, virtual sensor windows, ground map calibration and its residuals.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use anyhow::{Context, Result, ensure};
use eframe::egui::{self, RichText, Ui};
use egui_plot::{Bar, BarChart, Plot};
use vision::calibrate::calibrate_mask;
use vision::colour::lookup_table::{CLASS_NAMES, ColourClass};
use vision::config::ImageRect;
use vision::image::Image;
use vision::output_file::write_file;

use super::parameters::ParametersPanel;
use crate::view::accessibility::AccessibleLabel;
use crate::view::brush::{Brush, Tool};
use crate::view::calibration_job::{CalibrationJob, CalibrationMethod, MapCalibration};
use crate::view::palette;
use crate::view::session::Session;
use crate::view::settings;
use crate::view::source::decoded_cycle::rgb_image;
use pipeline::config::PIPELINE_FILE;
use pipeline::log::Header;

/// Images for the mask at most; when exceeded, every other one is dropped.
const MASK_IMAGES: usize = 60;

/// State of the panel.
pub(crate) struct CalibrationPanel {
    method: CalibrationMethod,
    dir: String,
    map_path: String,
    job: Option<CalibrationJob>,
    result: Option<MapCalibration>,
    output_dir: String,
    /// Images collected for the mask.
    mask_images: Vec<Image>,
    collecting: bool,
    last_collected: Option<localize::Stamp>,
    /// Result of the last action; true if it succeeded.
    message: Option<(bool, String)>,
}

impl Default for CalibrationPanel {
    fn default() -> Self {
        CalibrationPanel {
            method: CalibrationMethod::default(),
            dir: "samples/calibration".to_owned(),
            map_path: "map.npz".to_owned(),
            job: None,
            result: None,
            output_dir: "calibrated".to_owned(),
            mask_images: Vec::new(),
            collecting: false,
            last_collected: None,
            message: None,
        }
    }
}

impl CalibrationPanel {
    /// Draws the panel.
    pub(crate) fn show(
        &mut self,
        ui: &mut Ui,
        session: &mut Session,
        brush: &mut Brush,
        parameters: &mut ParametersPanel,
    ) {
        self.collect_mask_image(session);
        egui::ScrollArea::vertical().auto_shrink(false).show(ui, |ui| {
            if let Some((ok, text)) = &self.message {
                ui.colored_label(if *ok { palette::GREEN } else { palette::VERMILION }, text);
            }
            egui::CollapsingHeader::new("Colours")
                .default_open(true)
                .show(ui, |ui| colours(ui, session, brush));
            egui::CollapsingHeader::new("Mask")
                .default_open(true)
                .show(ui, |ui| self.mask(ui, session, brush));
            egui::CollapsingHeader::new("Windows of the virtual sensors")
                .show(ui, |ui| virtual_sensor_section(ui, session, parameters));
            egui::CollapsingHeader::new("Map")
                .default_open(true)
                .show(ui, |ui| self.map(ui));
            egui::CollapsingHeader::new("Write the configuration")
                .default_open(true)
                .show(ui, |ui| {
                    ui.label("Writes a folder with robot.toml, field.toml, map.npz (masked pixels show no ground), the colour table, the labels with their images, and the settings.");
                    ui.horizontal(|ui| {
                        ui.add(egui::TextEdit::singleline(&mut self.output_dir).desired_width(180.0)).with_accessible_label("Folder to write");
                        if ui.button("Write").clicked() {
                            let result = self.write_robot_folder(session, brush, parameters);
                            self.set_message(result.map(|()| format!("wrote {}", self.output_dir)));
                        }
                    });
                });
        });
        // Learning a colour table is slow: wait until the stroke ends.
        if brush.dirty && !ui.input(|input| input.pointer.any_down()) {
            apply_labels(session, brush);
        }
    }

    fn set_message(&mut self, result: Result<String>) {
        self.message = Some(match result {
            Ok(text) => (true, text),
            Err(error) => (false, format!("{error:#}")),
        });
    }

    fn mask(&mut self, ui: &mut Ui, session: &mut Session, brush: &mut Brush) {
        // Painting starts from the robot's own mask.
        if brush.mask.is_none()
            && let Some(scene) = &session.scene
        {
            brush.mask = scene.mask.as_deref().cloned();
        }
        ui.horizontal_wrapped(|ui| {
            ui.selectable_value(&mut brush.tool, Tool::Mask, "Paint own parts");
            ui.selectable_value(&mut brush.tool, Tool::EraseMask, "Erase");
            if ui.button("Clear mask").clicked() {
                (brush.mask, brush.dirty) = (None, true);
            }
            let masked = brush
                .mask
                .iter()
                .flatten()
                .filter(|&&visible| !visible)
                .count();
            ui.label(format!(
                "{masked} pixels masked (shown by the camera layer Mask)"
            ));
        });
        ui.label("Or rotate the robot in place, and find the pixels that do not change:");
        ui.horizontal(|ui| {
            ui.toggle_value(&mut self.collecting, "Collect images");
            ui.label(format!("{} images", self.mask_images.len()));
            if ui.button("Compute mask").clicked() {
                let mask = find_mask(session, &self.mask_images);
                self.set_message(mask.map(|mask| {
                    let own = mask.iter().filter(|&&visible| !visible).count();
                    (brush.mask, brush.dirty) = (Some(mask), true);
                    format!("{own} pixels masked")
                }));
            }
            if ui.button("Discard images").clicked() {
                self.mask_images.clear();
            }
        });
    }

    /// Adds the shown image while collecting; halves the images when there are too many.
    fn collect_mask_image(&mut self, session: &Session) {
        let Some(now) = session.shown.as_ref().filter(|_| self.collecting) else {
            return;
        };
        let (stamp, image) = (now.cycle.stamp, rgb_image(&now.cycle));
        if self.last_collected == Some(stamp) {
            return;
        }
        self.last_collected = Some(stamp);
        self.mask_images
            .extend(image.map(|image| (**image).clone()));
        if self.mask_images.len() > MASK_IMAGES {
            let mut number = 0;
            self.mask_images.retain(|_| {
                number += 1;
                number % 2 == 1
            });
        }
    }

    fn map(&mut self, ui: &mut Ui) {
        ui.horizontal_wrapped(|ui| {
            for (method, name) in [
                (CalibrationMethod::Strip, "Bar strip"),
                (
                    CalibrationMethod::StripWithProfile,
                    "Bar strip, fixed profile",
                ),
                (CalibrationMethod::Lines, "Drive over the field"),
            ] {
                ui.selectable_value(&mut self.method, method, name);
            }
        });
        ui.horizontal(|ui| {
            ui.label("Folder");
            ui.add(egui::TextEdit::singleline(&mut self.dir).desired_width(180.0))
                .with_accessible_label("Folder");
            ui.label("map");
            ui.add(egui::TextEdit::singleline(&mut self.map_path).desired_width(120.0))
                .with_accessible_label("map");
        });
        let idle = self.job.is_none();
        let button = egui::Button::new(if idle { "Calibrate" } else { "Calibrating…" });
        if ui.add_enabled(idle, button).clicked() {
            let (dir, out) = (PathBuf::from(&self.dir), PathBuf::from(&self.map_path));
            match CalibrationJob::start(self.method, dir, out) {
                Ok(job) => self.job = Some(job),
                Err(error) => self.set_message(Err(error.into())),
            }
        }
        if let Some(result) = self.job.as_ref().and_then(CalibrationJob::poll) {
            self.job = None;
            match result {
                Ok(calibration) => {
                    self.message =
                        Some((true, format!("wrote map {}", calibration.0.map.display())));
                    self.result = Some(calibration);
                }
                Err(error) => self.set_message(Err(error)),
            }
        }
        if self.job.is_some() {
            ui.spinner();
        }
        if let Some((outcome, images)) = &self.result {
            show_residuals(ui, outcome, images);
        }
    }

    fn write_robot_folder(
        &self,
        session: &Session,
        brush: &Brush,
        parameters: &ParametersPanel,
    ) -> Result<()> {
        let dir = Path::new(&self.output_dir);
        std::fs::create_dir_all(dir).with_context(|| format!("cannot create {}", dir.display()))?;
        let scene = session
            .scene
            .as_ref()
            .context("no robot configuration to write")?;
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
        let overlay = settings::diff_overlay(&Default::default(), parameters.config());
        header
            .with_file(PIPELINE_FILE, overlay.to_string())
            .write_files(dir)?;
        if !brush.labels.is_empty() {
            write_labels(dir, brush)?;
        }
        Ok(())
    }
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

fn find_mask(session: &Session, images: &[Image]) -> Result<Vec<bool>> {
    let scene = session.scene.as_ref().context("no camera")?;
    let camera = scene.camera.as_ref().context("no camera")?;
    Ok(calibrate_mask(&camera.config, images)?)
}

/// Draws the class tools and the label counts.
fn colours(ui: &mut Ui, session: &Session, brush: &mut Brush) {
    ui.label("Choose a class and paint on the camera image. The layer Classes shows the result.");
    ui.horizontal_wrapped(|ui| {
        ui.selectable_value(&mut brush.tool, Tool::Pan, "Pan");
        for (class, name) in CLASS_NAMES.iter().enumerate() {
            let colour = palette::class_colour(ColourClass(class as u8));
            let text = RichText::new(format!("# {name}")).color(colour);
            // Black and white are invisible in one of the themes.
            let text = match *name {
                "black" | "white" => RichText::new(*name),
                _ => text,
            };
            ui.selectable_value(&mut brush.tool, Tool::Class(class), text);
        }
    });
    ui.horizontal(|ui| {
        ui.add(egui::Slider::new(&mut brush.radius_px, 0..=40).text("brush, pixels"));
        if ui.button("Delete labels").clicked() {
            brush.clear_labels();
        }
    });
    let mut counts = [0usize; CLASS_NAMES.len()];
    for label in brush.labels.values() {
        counts[label.class] += 1;
    }
    let label_counts = counts
        .iter()
        .zip(CLASS_NAMES)
        .filter(|(count, _)| **count > 0);
    let label_counts: Vec<String> = label_counts
        .map(|(count, name)| format!("{name} {count}"))
        .collect();
    if label_counts.is_empty() {
        let own = session
            .scene
            .as_ref()
            .is_some_and(|scene| scene.colour_table.is_some());
        ui.weak(if own {
            "No labels: the robot's colour table is used."
        } else {
            "No labels: the carpet colour is learned from the images."
        });
    } else {
        let images = brush.labelled_images.len();
        ui.label(format!(
            "labelled pixels in {images} images: {}",
            label_counts.join(", ")
        ));
    }
    if let Some(fault) = &session.rendered_layers.error {
        ui.colored_label(palette::VERMILION, fault);
    }
}

/// Edits the windows of the virtual sensors. Windows that are not set are laid out by the ground map.
fn virtual_sensor_section(ui: &mut Ui, session: &mut Session, parameters: &mut ParametersPanel) {
    let layout = session
        .rendered_layers
        .virtual_sensors
        .clone()
        .unwrap_or_default();
    ui.horizontal_wrapped(|ui| {
        let button = egui::Button::new("Copy current layout");
        if ui.add_enabled(!layout.is_empty(), button).clicked() {
            let of = |kind: &str| -> Vec<ImageRect> {
                let named = layout.iter().filter(|(name, _)| *name == kind);
                named.map(|(_, window)| *window).collect()
            };
            parameters.edit_config(session, |config| {
                let windows = &mut config.vision.virtual_sensors;
                (windows.bumpers, windows.goals) = (of("bumper"), of("goal"));
                windows.ball = of("ball").first().copied();
                windows.kick = of("kick").first().copied();
                windows.lens = of("lens").first().copied();
            });
        }
        if ui.button("Reset layout").clicked() {
            parameters.edit_config(session, |config| {
                let windows = &mut config.vision.virtual_sensors;
                (windows.bumpers, windows.goals) = (Vec::new(), Vec::new());
                (windows.ball, windows.kick, windows.lens) = (None, None, None);
            });
        }
    });
    if layout.is_empty() {
        ui.weak("Switch on the camera layer Windows to compute the layout.");
    }
    let mut windows = parameters.config().vision.virtual_sensors.clone();
    let mut changed = false;
    let single = [
        ("ball", windows.ball.as_mut()),
        ("kick", windows.kick.as_mut()),
        ("lens", windows.lens.as_mut()),
    ];
    let single = single
        .into_iter()
        .filter_map(|(name, w)| w.map(|w| (name, w)));
    let bumpers = windows.bumpers.iter_mut().map(|w| ("bumper", w));
    let goals = windows.goals.iter_mut().map(|w| ("goal", w));
    egui::Grid::new("windows").show(ui, |ui| {
        for (name, window) in bumpers.chain(goals).chain(single) {
            ui.label(name);
            for (prefix, value) in [
                ("left ", &mut window.left_px),
                ("top ", &mut window.top_px),
                ("width ", &mut window.width_px),
                ("height ", &mut window.height_px),
            ] {
                let drag = egui::DragValue::new(value).prefix(prefix).suffix(" px");
                changed |= ui
                    .add(drag.max_decimals(1))
                    .with_accessible_label(name)
                    .changed();
            }
            ui.end_row();
        }
    });
    if changed {
        parameters.edit_config(session, |config| config.vision.virtual_sensors = windows);
    }
}

/// Applies labels and mask to the session once a stroke has ended.
fn apply_labels(session: &mut Session, brush: &mut Brush) {
    brush.dirty = false;
    session.colour_table = brush.learn_colour_table().map(Arc::new);
    session.mask = brush.mask.clone().map(Arc::new);
    session.revision += 1;
}

fn show_residuals(
    ui: &mut Ui,
    outcome: &crate::commands::calibrate::Outcome,
    images: &[vision::calibrate::ImageResidual],
) {
    ui.label(format!(
        "{} of {} images used",
        outcome.used, outcome.images
    ));
    if let Some(rms) = outcome.rms_px {
        ui.label(format!("residual {rms:.3} px"));
    }
    if let (Some(rms), Some(share)) = (outcome.rms_m, outcome.inlier_share) {
        let (cm, percent) = (100.0 * rms, 100.0 * share);
        ui.label(format!(
            "residual {cm:.2} cm, {percent:.0} % of the line points are inliers"
        ));
    }
    let bars = images
        .iter()
        .enumerate()
        .map(|(number, image)| Bar::new(number as f64, image.rms_px))
        .collect();
    Plot::new("residuals")
        .height(110.0)
        .allow_scroll(false)
        .y_axis_label("px")
        .show(ui, |plot| {
            plot.bar_chart(BarChart::new("residual of each image", bars).color(palette::SKY));
        });
    egui::Grid::new("residual table")
        .striped(true)
        .show(ui, |ui| {
            for image in images {
                ui.label(&image.name);
                match &image.left_out {
                    Some(reason) => {
                        ui.colored_label(palette::ORANGE, format!("excluded: {reason}"));
                    }
                    None => {
                        ui.monospace(format!("{} points, {:.2} px", image.points, image.rms_px));
                    }
                }
                ui.end_row();
            }
        });
}
