//! Calibration panel: colour labels, mask, virtual sensor windows, ground map calibration and its residuals.

use std::path::Path;

use eframe::egui::{self, RichText, Ui};
use egui_plot::{Bar, BarChart, Plot};
use localize::map_correction::{MapCorrectionEstimate, Unit};
use vision::colour::lookup_table::{CLASS_NAMES, ColourClass};
use vision::config::ImageRect;

use crate::view::accessibility::AccessibleLabel;
use crate::view::brush::Tool;
use crate::view::calibration_job::CalibrationMethod;
use crate::view::calibration_state::CalibrationState;
use crate::view::palette;
use crate::view::robot_folder::write_robot_folder;
use crate::view::session::Session;
use crate::view::status_message::StatusMessage;

/// State of the panel.
pub(crate) struct CalibrationPanel {
    method: CalibrationMethod,
    dir: String,
    map_path: String,
    output_dir: String,
}

impl Default for CalibrationPanel {
    fn default() -> Self {
        CalibrationPanel {
            method: CalibrationMethod::default(),
            dir: "samples/calibration".to_owned(),
            map_path: "map.npz".to_owned(),
            output_dir: "calibrated".to_owned(),
        }
    }
}

impl CalibrationPanel {
    /// Draws the panel.
    pub(crate) fn show(&mut self, ui: &mut Ui, session: &mut Session) {
        egui::ScrollArea::vertical().auto_shrink(false).show(ui, |ui| {
            if let Some(message) = &session.calibration.message {
                ui.colored_label(palette::message_colour(message), &message.text);
            }
            egui::CollapsingHeader::new("Colours")
                .default_open(true)
                .show(ui, |ui| colours(ui, session));
            egui::CollapsingHeader::new("Mask")
                .default_open(true)
                .show(ui, |ui| mask(ui, session));
            egui::CollapsingHeader::new("Windows of the virtual sensors")
                .show(ui, |ui| virtual_sensor_section(ui, session));
            egui::CollapsingHeader::new("Map")
                .default_open(true)
                .show(ui, |ui| self.map(ui, &mut session.calibration));
            if let Some(map) = session.map_correction() {
                egui::CollapsingHeader::new("Learned map errors")
                    .default_open(true)
                    .show(ui, |ui| show_learned_errors(ui, map));
            }
            egui::CollapsingHeader::new("Write the configuration")
                .default_open(true)
                .show(ui, |ui| {
                    ui.label("Writes a folder with robot.toml, field.toml, map.npz (masked pixels show no ground), the colour table, the labels with their images, and the settings.");
                    ui.horizontal(|ui| {
                        ui.add(egui::TextEdit::singleline(&mut self.output_dir).desired_width(180.0)).with_accessible_label("Folder to write");
                        if ui.button("Write").clicked() {
                            let result = write_robot_folder(session, Path::new(&self.output_dir));
                            let result = result.map(|()| format!("wrote {}", self.output_dir));
                            session.calibration.message = Some(StatusMessage::from_result(result));
                        }
                    });
                });
        });
    }

    fn map(&mut self, ui: &mut Ui, calibration: &mut CalibrationState) {
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
        let idle = !calibration.is_running();
        let button = egui::Button::new(if idle { "Calibrate" } else { "Calibrating…" });
        if ui.add_enabled(idle, button).clicked() {
            calibration.start_map(self.method, (&self.dir).into(), (&self.map_path).into());
        }
        if !idle {
            ui.spinner();
        }
        if let Some((outcome, images)) = &calibration.result {
            show_residuals(ui, outcome, images);
        }
    }
}

/// Shows what localization learned about the ground map while the robot drove.
fn show_learned_errors(ui: &mut Ui, map: &MapCorrectionEstimate) {
    ui.label(format!(
        "{} images, {} knocks; points 3 m away moved by {:.1} ± {:.1} cm",
        map.images,
        map.knocks,
        100.0 * map.displacement_at_3_m,
        100.0 * map.displacement_std_at_3_m,
    ));
    egui::Grid::new("learned map errors")
        .striped(true)
        .show(ui, |ui| {
            for term in &map.terms {
                let (scale, unit) = match term.kind.unit() {
                    Unit::Radian => (1f32.to_degrees(), "°"),
                    Unit::Metre => (1e3, "mm"),
                    Unit::Share => (1e2, "%"),
                };
                ui.label(term.kind.name());
                ui.monospace(format!(
                    "{:+.2} ± {:.2} {unit}",
                    scale * term.value,
                    scale * term.std
                ));
                ui.end_row();
            }
        });
}

/// Draws the mask tools.
fn mask(ui: &mut Ui, session: &mut Session) {
    let own_mask = session.scene.as_ref().and_then(|scene| scene.mask.clone());
    let calibration = &mut session.calibration;
    calibration.begin_mask(own_mask.as_ref());
    let brush = &mut calibration.brush;
    ui.horizontal_wrapped(|ui| {
        ui.selectable_value(&mut brush.tool, Tool::Mask, "Paint own parts");
        ui.selectable_value(&mut brush.tool, Tool::EraseMask, "Erase");
        if ui.button("Clear mask").clicked() {
            (brush.mask, brush.dirty) = (None, true);
        }
        let visible = brush.mask.iter().flatten();
        let masked = visible.filter(|&&visible| !visible).count();
        ui.label(format!(
            "{masked} pixels masked (shown by the camera layer Mask)"
        ));
    });
    ui.label("Or rotate the robot in place, and find the pixels that do not change:");
    let mut compute = false;
    ui.horizontal(|ui| {
        ui.toggle_value(&mut calibration.collecting, "Collect images");
        ui.label(format!("{} images", calibration.mask_images.len()));
        compute = ui.button("Compute mask").clicked();
        if ui.button("Discard images").clicked() {
            calibration.mask_images.clear();
        }
    });
    if compute {
        session.compute_mask();
    }
}

/// Draws the class tools and the label counts.
fn colours(ui: &mut Ui, session: &mut Session) {
    let brush = &mut session.calibration.brush;
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
fn virtual_sensor_section(ui: &mut Ui, session: &mut Session) {
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
            session.edit_config(|config| {
                let windows = &mut config.vision.virtual_sensors;
                (windows.bumpers, windows.goals) = (of("bumper"), of("goal"));
                windows.ball = of("ball").first().copied();
                windows.kick = of("kick").first().copied();
                windows.lens = of("lens").first().copied();
            });
        }
        if ui.button("Reset layout").clicked() {
            session.edit_config(|config| {
                let windows = &mut config.vision.virtual_sensors;
                (windows.bumpers, windows.goals) = (Vec::new(), Vec::new());
                (windows.ball, windows.kick, windows.lens) = (None, None, None);
            });
        }
    });
    if layout.is_empty() {
        ui.weak("Switch on the camera layer Windows to compute the layout.");
    }
    let mut windows = session.settings.config().vision.virtual_sensors.clone();
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
        session.edit_config(|config| config.vision.virtual_sensors = windows);
    }
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
