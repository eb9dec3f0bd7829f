//! What do this camera's colours and pixels mean? Labels and mask painted on its images, map calibrations and their residuals.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use anyhow::{Context, Result, ensure};
use eframe::egui::{self, RichText, Ui};
use egui_plot::{Bar, BarChart, Plot};
use vision::calibrate::calibrate_mask;
use vision::colour::lookup_table::{CLASS_NAMES, ColourClass};
use vision::config::ImageRect;
use vision::image::Image;

use super::parameters::ParametersPanel;
use crate::view::accessibility::AccessibleLabel;
use crate::view::brush::{Brush, Tool};
use crate::view::calibration_job::{CalibrationJob, CalibrationMethod, MapCalibration};
use crate::view::palette;
use crate::view::session::Session;
use crate::view::settings;
use crate::view::source::rgb_image;
use pipeline::config::PIPELINE_FILE;
use pipeline::log::Header;

/// Images of a turning robot that the mask is found from, at most: spread over what is at hand.
const MASK_IMAGES: usize = 60;

/// The panel's memory.
pub(crate) struct CalibrationPanel {
    method: CalibrationMethod,
    dir: String,
    map_path: String,
    job: Option<CalibrationJob>,
    result: Option<MapCalibration>,
    output_dir: String,
    /// Images gathered for the mask.
    mask_images: Vec<Image>,
    collecting: bool,
    last_collected: Option<localize::Stamp>,
    /// What came of the last step; true if it went well.
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
            if let Some((well, word)) = &self.message {
                ui.colored_label(if *well { palette::GREEN } else { palette::VERMILION }, word);
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
                    ui.label("A folder with robot.toml, field.toml, map.npz (masked pixels show no ground), the colour table, the labels with their images, and settings.");
                    ui.horizontal(|ui| {
                        ui.add(egui::TextEdit::singleline(&mut self.output_dir).desired_width(180.0)).with_accessible_label("Folder to write");
                        if ui.button("Write").clicked() {
                            let written = self.write_robot_folder(session, brush, parameters);
                            self.set_message(written.map(|()| format!("written: {}", self.output_dir)));
                        }
                    });
                });
        });
        // A table takes a moment to learn: not while the pointer still paints.
        if brush.dirty && !ui.input(|input| input.pointer.any_down()) {
            apply_labels(session, brush);
        }
    }

    fn set_message(&mut self, result: Result<String>) {
        self.message = Some(match result {
            Ok(word) => (true, word),
            Err(error) => (false, format!("{error:#}")),
        });
    }

    fn mask(&mut self, ui: &mut Ui, session: &mut Session, brush: &mut Brush) {
        // Painting goes on from the robot's own mask.
        if brush.mask.is_none()
            && let Some(stage) = &session.scene
        {
            brush.mask = stage.mask.as_deref().cloned();
        }
        ui.horizontal_wrapped(|ui| {
            ui.selectable_value(&mut brush.tool, Tool::Mask, "Paint own parts");
            ui.selectable_value(&mut brush.tool, Tool::EraseMask, "Erase");
            if ui.button("Clear mask").clicked() {
                (brush.mask, brush.dirty) = (None, true);
            }
            let masked = brush.mask.iter().flatten().filter(|&&sees| !sees).count();
            ui.label(format!("{masked} pixels masked (layer Mask shows them)"));
        });
        ui.label("Or let the robot turn in place, and find what stays the same:");
        ui.horizontal(|ui| {
            ui.toggle_value(&mut self.collecting, "Gather images");
            ui.label(format!("{} images", self.mask_images.len()));
            if ui.button("Find the mask").clicked() {
                let found = find_mask(session, &self.mask_images);
                self.set_message(found.map(|mask| {
                    let own = mask.iter().filter(|&&sees| !sees).count();
                    (brush.mask, brush.dirty) = (Some(mask), true);
                    format!("{own} pixels are the robot's own")
                }));
            }
            if ui.button("Drop images").clicked() {
                self.mask_images.clear();
            }
        });
    }

    /// Keeps the shown images while gathering; of many, every other one.
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
            for (kind, name) in [
                (CalibrationMethod::Strip, "Strip of bars"),
                (
                    CalibrationMethod::StripWithProfile,
                    "Strip, profile trusted",
                ),
                (CalibrationMethod::Lines, "Drive over the field"),
            ] {
                ui.selectable_value(&mut self.method, kind, name);
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
        let button = egui::Button::new(if idle { "Calibrate" } else { "Calibrating" });
        if ui.add_enabled(idle, button).clicked() {
            let (dir, out) = (PathBuf::from(&self.dir), PathBuf::from(&self.map_path));
            match CalibrationJob::start(self.method, dir, out) {
                Ok(running) => self.job = Some(running),
                Err(error) => self.set_message(Err(error.into())),
            }
        }
        if let Some(found) = self.job.as_ref().and_then(CalibrationJob::poll) {
            self.job = None;
            match found {
                Ok(found) => {
                    self.message = Some((true, format!("map written: {}", found.0.map.display())));
                    self.result = Some(found);
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
        let folder = Path::new(&self.output_dir);
        std::fs::create_dir_all(folder)
            .with_context(|| format!("cannot create {}", folder.display()))?;
        let stage = session
            .scene
            .as_ref()
            .context("there is no robot to write")?;
        let mut map = stage.camera.as_ref().map(|eye| (*eye.map).clone());
        if let (Some(map), Some(mask)) = (&mut map, &brush.mask) {
            ensure!(
                mask.len() == map.x.len(),
                "the mask was painted on images of another size"
            );
            for (pixel, sees) in mask.iter().enumerate() {
                if !sees {
                    (map.x[pixel], map.y[pixel]) = (f32::NAN, f32::NAN);
                }
            }
        }
        let table = session
            .colour_table
            .as_deref()
            .or(stage.colour_table.as_ref());
        let header = Header::new("view", None).with_robot(&stage.robot, map.as_ref(), table)?;
        let overlay = settings::diff_overlay(&Default::default(), parameters.config());
        header
            .with_file(PIPELINE_FILE, overlay.to_string())
            .write_files(folder)?;
        if !brush.labels.is_empty() {
            write_labels(folder, brush)?;
        }
        Ok(())
    }
}

/// The labels as `labels.csv` with the images they are in.
fn write_labels(folder: &Path, brush: &Brush) -> Result<()> {
    for (number, (_, image)) in brush.labelled_images.iter().enumerate() {
        image.save(&folder.join(format!("label_{number}.png")))?;
    }
    let mut text = "file,u,v,class\n".to_owned();
    for ((stamp, [u, v]), stroke) in &brush.labels {
        let place = brush
            .labelled_images
            .iter()
            .position(|(known, _)| known == stamp);
        let Some(number) = place else { continue };
        text += &format!("label_{number}.png,{u},{v},{}\n", CLASS_NAMES[stroke.class]);
    }
    let path = folder.join("labels.csv");
    std::fs::write(&path, text).with_context(|| format!("cannot write {}", path.display()))
}

fn find_mask(session: &Session, images: &[Image]) -> Result<Vec<bool>> {
    let stage = session.scene.as_ref().context("no camera")?;
    let eye = stage.camera.as_ref().context("no camera")?;
    Ok(calibrate_mask(&eye.config, images)?)
}

/// Classes to paint with, and what was painted.
fn colours(ui: &mut Ui, session: &Session, brush: &mut Brush) {
    ui.label("Choose a class, paint on the camera's image, and watch the layer Classes.");
    ui.horizontal_wrapped(|ui| {
        ui.selectable_value(&mut brush.tool, Tool::Pan, "Hand");
        for (class, name) in CLASS_NAMES.iter().enumerate() {
            let colour = palette::class_colour(ColourClass(class as u8));
            let text = RichText::new(format!("# {name}")).color(colour);
            // Black and white vanish on one theme or the other.
            let text = match *name {
                "black" | "white" => RichText::new(*name),
                _ => text,
            };
            ui.selectable_value(&mut brush.tool, Tool::Class(class), text);
        }
    });
    ui.horizontal(|ui| {
        ui.add(egui::Slider::new(&mut brush.radius_px, 0..=40).text("brush, pixels"));
        if ui.button("Forget labels").clicked() {
            brush.clear_labels();
        }
    });
    let mut counts = [0usize; CLASS_NAMES.len()];
    for stroke in brush.labels.values() {
        counts[stroke.class] += 1;
    }
    let told = counts
        .iter()
        .zip(CLASS_NAMES)
        .filter(|(count, _)| **count > 0);
    let told: Vec<String> = told
        .map(|(count, name)| format!("{name} {count}"))
        .collect();
    if told.is_empty() {
        let own = session
            .scene
            .as_ref()
            .is_some_and(|stage| stage.colour_table.is_some());
        ui.weak(if own {
            "No labels painted: the robot's own colour table is in use."
        } else {
            "No labels: the carpet's colour is learned from the images themselves."
        });
    } else {
        let images = brush.labelled_images.len();
        ui.label(format!(
            "labelled pixels in {images} images: {}",
            told.join(", ")
        ));
    }
    if let Some(fault) = &session.rendered_layers.error {
        ui.colored_label(palette::VERMILION, fault);
    }
}

/// The virtual sensors' windows: laid out by the map until somebody moves one.
fn virtual_sensor_section(ui: &mut Ui, session: &mut Session, parameters: &mut ParametersPanel) {
    let laid = session
        .rendered_layers
        .virtual_sensors
        .clone()
        .unwrap_or_default();
    ui.horizontal_wrapped(|ui| {
        let take = egui::Button::new("Take as laid out");
        if ui.add_enabled(!laid.is_empty(), take).clicked() {
            let of = |kind: &str| -> Vec<ImageRect> {
                let named = laid.iter().filter(|(name, _)| *name == kind);
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
        if ui.button("Lay out anew").clicked() {
            parameters.edit_config(session, |config| {
                let windows = &mut config.vision.virtual_sensors;
                (windows.bumpers, windows.goals) = (Vec::new(), Vec::new());
                (windows.ball, windows.kick, windows.lens) = (None, None, None);
            });
        }
    });
    if laid.is_empty() {
        ui.weak("The camera's layer Windows shows them, and makes them known here.");
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

/// Takes what was painted into the session, once a stroke has ended.
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
            "residual {cm:.2} cm, {percent:.0} % of the points on markings"
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
                        ui.colored_label(palette::ORANGE, format!("left out: {reason}"));
                    }
                    None => {
                        ui.monospace(format!("{} points, {:.2} px", image.points, image.rms_px));
                    }
                }
                ui.end_row();
            }
        });
}
