//! Simulator panel: scenario, seed, kidnaps, pushes, kicks, light, camera, occlusion, faults and manual driving.

use std::path::{Path, PathBuf};

use eframe::egui::{self, Ui};
use localize::Pose;
use localize::omni::Twist;
use sim::Sector;
use sim::scenario::FaultKind;

use crate::view::accessibility::AccessibleLabel;
use crate::view::palette;
use crate::view::session::Session;
use crate::view::source::sim_worker::{SimWorker, SourceRequest};

/// Sensor faults that can be switched on.
const FAULTS: [(FaultKind, &str); 7] = [
    (FaultKind::FramesDropped, "Frames dropped"),
    (FaultKind::FramesFrozen, "Frames frozen"),
    (FaultKind::CompassSilent, "Compass silent"),
    (FaultKind::CompassFrozen, "Compass frozen"),
    (FaultKind::OdometrySilent, "Odometry silent"),
    (FaultKind::WheelStuck, "Wheel stuck"),
    (FaultKind::ImuSilent, "IMU silent"),
];
/// Folder of the scenarios, relative to the working directory.
const SCENARIO_DIR: &str = "config/scenarios";
/// Speed (m/s) and yaw rate (rad/s) of manual driving.
const MANUAL_SPEED: f32 = 2.0;
const MANUAL_YAW_RATE: f32 = 2.0;

/// State of the panel.
pub(crate) struct SimulatorPanel {
    kidnap_pose: [f32; 3],
    impulse: f32,
    impulse_deg: f32,
    kick_speed: f32,
    kick_deg: f32,
    light: Option<f32>,
    occlusion_deg: Option<(f32, f32)>,
    faults: [bool; FAULTS.len()],
    wheel: usize,
    manual_drive: bool,
    seed: Option<u64>,
    scenarios: Option<Vec<PathBuf>>,
    /// Scenario that the user chose to open.
    pub(crate) open_request: Option<PathBuf>,
}

impl Default for SimulatorPanel {
    fn default() -> Self {
        SimulatorPanel {
            kidnap_pose: [0.0; 3],
            impulse: 60.0,
            impulse_deg: 0.0,
            kick_speed: 6.0,
            kick_deg: 0.0,
            light: None,
            occlusion_deg: None,
            faults: [false; FAULTS.len()],
            wheel: 0,
            manual_drive: false,
            seed: None,
            scenarios: None,
            open_request: None,
        }
    }
}

impl SimulatorPanel {
    /// Draws the panel.
    pub(crate) fn show(&mut self, ui: &mut Ui, session: &mut Session) {
        egui::ScrollArea::vertical()
            .auto_shrink(false)
            .show(ui, |ui| {
                self.scenario(ui, session);
                let Some(worker) = session.source.simulation() else {
                    ui.weak("No simulation is running. Choose a scenario.");
                    return;
                };
                let status = worker.status();
                ui.label(format!(
                    "{:.1} of {:.0} s, seed {}",
                    status.time, status.duration, status.seed
                ));
                if let Some(error) = &status.error {
                    ui.colored_label(palette::VERMILION, error);
                }
                let paused = status.paused;
                ui.horizontal(|ui| {
                    let name = if paused { "Resume" } else { "Pause" };
                    if ui.button(name).clicked() {
                        worker.request(SourceRequest::Pause(!paused));
                    }
                    let seed = self.seed.get_or_insert(status.seed);
                    ui.label("seed");
                    ui.add(egui::DragValue::new(seed))
                        .with_accessible_label("seed");
                    if ui.button("Restart").clicked() {
                        worker.request(SourceRequest::Restart(*seed));
                        self.faults = [false; FAULTS.len()];
                        (self.light, self.occlusion_deg) = (None, None);
                    }
                });
                ui.separator();
                self.disturbance_controls(ui, session, worker);
                ui.separator();
                self.light(ui, worker, status.image_sensor);
                ui.separator();
                self.fault_controls(ui, worker);
                self.manual_drive_controls(ui, worker);
            });
    }

    fn scenario(&mut self, ui: &mut Ui, session: &Session) {
        let scenarios = self.scenarios.get_or_insert_with(|| {
            let files = std::fs::read_dir(SCENARIO_DIR).into_iter().flatten();
            let mut scenarios: Vec<PathBuf> = files
                .filter_map(|entry| Some(entry.ok()?.path()))
                .filter(|path| path.extension().is_some_and(|end| end == "toml"))
                .collect();
            scenarios.sort();
            scenarios
        });
        let short = |path: &Path| {
            path.file_stem()
                .map_or(String::new(), |stem| stem.to_string_lossy().into_owned())
        };
        let worker = session.source.simulation();
        let current = worker.map_or("choose a scenario".to_owned(), |worker| {
            short(&worker.scenario)
        });
        ui.horizontal(|ui| {
            ui.label("Scenario");
            egui::ComboBox::from_id_salt("scenario")
                .selected_text(current)
                .show_ui(ui, |ui| {
                    for path in scenarios {
                        if ui.selectable_label(false, short(path)).clicked() {
                            self.open_request = Some(path.clone());
                        }
                    }
                })
                .response
                .with_accessible_label("Scenario");
        });
    }

    fn disturbance_controls(&mut self, ui: &mut Ui, session: &Session, worker: &SimWorker) {
        ui.horizontal_wrapped(|ui| {
            let [x, y, degrees] = &mut self.kidnap_pose;
            ui.add(
                egui::DragValue::new(x)
                    .speed(0.05)
                    .prefix("x ")
                    .suffix(" m"),
            )
            .with_accessible_label("kidnap x");
            ui.add(
                egui::DragValue::new(y)
                    .speed(0.05)
                    .prefix("y ")
                    .suffix(" m"),
            )
            .with_accessible_label("kidnap y");
            ui.add(egui::DragValue::new(degrees).suffix("°"))
                .with_accessible_label("kidnap heading");
            if ui.button("Kidnap").clicked() {
                worker.request(SourceRequest::Kidnap(Pose::new(
                    *x,
                    *y,
                    degrees.to_radians(),
                )));
            }
        });
        ui.horizontal_wrapped(|ui| {
            ui.add(egui::DragValue::new(&mut self.impulse).suffix(" N s"))
                .with_accessible_label("impulse of the push");
            ui.add(egui::DragValue::new(&mut self.impulse_deg).suffix("°"))
                .with_accessible_label("direction of the push");
            if ui.button("Push").clicked() {
                let (sin, cos) = self.impulse_deg.to_radians().sin_cos();
                worker.request(SourceRequest::ApplyImpulse([
                    self.impulse * cos,
                    self.impulse * sin,
                ]));
            }
        });
        ui.horizontal_wrapped(|ui| {
            ui.add(
                egui::DragValue::new(&mut self.kick_speed)
                    .speed(0.1)
                    .suffix(" m/s"),
            )
            .with_accessible_label("speed of the kick");
            ui.add(egui::DragValue::new(&mut self.kick_deg).suffix("°"))
                .with_accessible_label("direction of the kick");
            let now = session.shown.as_ref();
            let truth = now.and_then(|now| now.cycle.inputs.truth.as_ref());
            let ball = truth.and_then(|truth| truth.ball);
            let button = ui.add_enabled(ball.is_some(), egui::Button::new("Kick"));
            if let (true, Some(at)) = (button.clicked(), ball) {
                let (sin, cos) = self.kick_deg.to_radians().sin_cos();
                worker.request(SourceRequest::PlaceBall(
                    at,
                    [self.kick_speed * cos, self.kick_speed * sin],
                ));
            }
        });
    }

    fn light(
        &mut self,
        ui: &mut Ui,
        worker: &SimWorker,
        image_sensor: sim::image_sensor::ImageSensorConfig,
    ) {
        let mut manual = self.light.is_some();
        ui.horizontal(|ui| {
            let toggled = ui.checkbox(&mut manual, "Manual light").changed();
            if toggled {
                self.light = manual.then_some(1.0);
            }
            if let Some(level) = &mut self.light {
                let slider = egui::Slider::new(level, 0.02..=4.0).logarithmic(true);
                if ui.add(slider).with_accessible_label("light").changed() || toggled {
                    worker.request(SourceRequest::SetLightLevel(Some(*level)));
                }
            } else if toggled {
                worker.request(SourceRequest::SetLightLevel(None));
            }
        });
        let mut edited = image_sensor;
        ui.horizontal_wrapped(|ui| {
            let exposure = egui::Slider::new(&mut edited.exposure, 0.05..=8.0);
            ui.add(exposure.logarithmic(true).text("exposure"));
            let gain = egui::Slider::new(&mut edited.gain, 0.25..=8.0);
            ui.add(gain.logarithmic(true).text("gain"));
        });
        ui.horizontal_wrapped(|ui| {
            ui.label("white balance");
            for (gain, channel) in edited
                .white_balance
                .iter_mut()
                .zip(["red", "green", "blue"])
            {
                ui.add(egui::DragValue::new(gain).speed(0.01).range(0.2..=4.0))
                    .with_accessible_label(channel);
            }
        });
        if edited != image_sensor {
            worker.request(SourceRequest::SetImageSensor(edited));
        }
        ui.horizontal(|ui| {
            let mut enabled = self.occlusion_deg.is_some();
            let mut changed = ui.checkbox(&mut enabled, "Occlusion").changed();
            if changed {
                self.occlusion_deg = enabled.then_some((0.0, 90.0));
            }
            if let Some((centre, width)) = &mut self.occlusion_deg {
                let centre = egui::DragValue::new(centre).suffix("°").prefix("at ");
                changed |= ui
                    .add(centre)
                    .with_accessible_label("centre of the occlusion")
                    .changed();
                let width = egui::DragValue::new(width).suffix("°").prefix("wide ");
                changed |= ui
                    .add(width.range(0.0..=360.0))
                    .with_accessible_label("width of the occlusion")
                    .changed();
            }
            if changed {
                let sector = self
                    .occlusion_deg
                    .map(|(centre, width)| Sector::from_degrees(centre, width));
                worker.request(SourceRequest::SetOcclusion(sector));
            }
        });
    }

    fn fault_controls(&mut self, ui: &mut Ui, worker: &SimWorker) {
        ui.strong("Faults");
        ui.horizontal_wrapped(|ui| {
            for ((kind, name), active) in FAULTS.into_iter().zip(&mut self.faults) {
                if ui.checkbox(active, name).changed() {
                    worker.request(SourceRequest::SetFault(kind, self.wheel, *active));
                }
            }
            ui.add(
                egui::DragValue::new(&mut self.wheel)
                    .range(0..=3)
                    .prefix("wheel "),
            )
            .with_accessible_label("wheel that fails");
        });
    }

    /// Drives the robot with W, A, S, D, Q and E while switched on.
    fn manual_drive_controls(&mut self, ui: &mut Ui, worker: &SimWorker) {
        let text = "Manual drive (W A S D, rotate with Q E)";
        let toggled = ui.checkbox(&mut self.manual_drive, text).changed();
        if toggled && !self.manual_drive {
            worker.request(SourceRequest::Drive(None));
        }
        if !self.manual_drive || ui.ctx().egui_wants_keyboard_input() {
            return;
        }
        let pressed = |key| ui.input(|input| input.key_down(key));
        let axis =
            |more, less| f32::from(u8::from(pressed(more))) - f32::from(u8::from(pressed(less)));
        worker.request(SourceRequest::Drive(Some(Twist {
            x: MANUAL_SPEED * axis(egui::Key::W, egui::Key::S),
            y: MANUAL_SPEED * axis(egui::Key::A, egui::Key::D),
            theta: MANUAL_YAW_RATE * axis(egui::Key::Q, egui::Key::E),
        })));
        ui.request_repaint();
    }
}
