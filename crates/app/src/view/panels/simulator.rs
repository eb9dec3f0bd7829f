//! What is done to the simulation? Kidnaps, pushes and kicks, light, camera, occlusion, faults, seed and scenario.

use std::path::{Path, PathBuf};

use eframe::egui::{self, Ui};
use localize::Pose;
use localize::omni::Twist;
use sim::scenario::FaultKind;

use crate::view::ink;
use crate::view::named::Named;
use crate::view::session::Session;
use crate::view::source::worker::{Order, SimWorker};

/// Sensors that may be made to fail.
const FAULTS: [(FaultKind, &str); 7] = [
    (FaultKind::FramesDropped, "Frames dropped"),
    (FaultKind::FramesFrozen, "Frames frozen"),
    (FaultKind::CompassSilent, "Compass silent"),
    (FaultKind::CompassFrozen, "Compass frozen"),
    (FaultKind::OdometrySilent, "Odometry silent"),
    (FaultKind::WheelStuck, "Wheel stuck"),
    (FaultKind::ImuSilent, "IMU silent"),
];
/// Where scenarios are sought, from the working folder.
const SCENARIOS: &str = "config/scenarios";
/// Top speed when driving by hand, m/s and rad/s.
const HAND_SPEED: f32 = 2.0;
const HAND_TURN: f32 = 2.0;

/// The panel's memory.
pub(crate) struct Simulator {
    kidnap: [f32; 3],
    push: f32,
    push_deg: f32,
    kick: f32,
    kick_deg: f32,
    light: Option<f32>,
    occlusion: Option<(f32, f32)>,
    faults: [bool; FAULTS.len()],
    wheel: usize,
    by_hand: bool,
    seed: Option<u64>,
    scenarios: Option<Vec<PathBuf>>,
    /// A scenario that is to be opened.
    pub(crate) open: Option<PathBuf>,
}

impl Default for Simulator {
    fn default() -> Self {
        Simulator {
            kidnap: [0.0; 3],
            push: 60.0,
            push_deg: 0.0,
            kick: 6.0,
            kick_deg: 0.0,
            light: None,
            occlusion: None,
            faults: [false; FAULTS.len()],
            wheel: 0,
            by_hand: false,
            seed: None,
            scenarios: None,
            open: None,
        }
    }
}

impl Simulator {
    /// Draws the panel.
    pub(crate) fn show(&mut self, ui: &mut Ui, session: &mut Session) {
        egui::ScrollArea::vertical()
            .auto_shrink(false)
            .show(ui, |ui| {
                self.scenario(ui, session);
                let Some(worker) = session.source.simulation() else {
                    ui.weak(
                        "These controls move a simulation of the view's own: choose a scenario.",
                    );
                    return;
                };
                let status = worker.status();
                ui.label(format!(
                    "{:.1} of {:.0} s, seed {}",
                    status.time, status.duration, status.seed
                ));
                if let Some(refused) = &status.refused {
                    ui.colored_label(ink::VERMILION, refused);
                }
                let paused = status.paused;
                ui.horizontal(|ui| {
                    let name = if paused { "Go on" } else { "Pause" };
                    if ui.button(name).clicked() {
                        worker.order(Order::Pause(!paused));
                    }
                    let seed = self.seed.get_or_insert(status.seed);
                    ui.label("seed");
                    ui.add(egui::DragValue::new(seed)).named("seed");
                    if ui.button("Restart").clicked() {
                        worker.order(Order::Restart(*seed));
                        self.faults = [false; FAULTS.len()];
                        (self.light, self.occlusion) = (None, None);
                    }
                });
                ui.separator();
                self.moves(ui, session, worker);
                ui.separator();
                self.light(ui, worker, status.film);
                ui.separator();
                self.failures(ui, worker);
                self.hand(ui, worker);
            });
    }

    fn scenario(&mut self, ui: &mut Ui, session: &Session) {
        let scenarios = self.scenarios.get_or_insert_with(|| {
            let files = std::fs::read_dir(SCENARIOS).into_iter().flatten();
            let mut found: Vec<PathBuf> = files
                .filter_map(|entry| Some(entry.ok()?.path()))
                .filter(|path| path.extension().is_some_and(|end| end == "toml"))
                .collect();
            found.sort();
            found
        });
        let short = |path: &Path| {
            path.file_stem()
                .map_or(String::new(), |stem| stem.to_string_lossy().into_owned())
        };
        let own = session.source.simulation();
        let current = own.map_or("choose one".to_owned(), |worker| short(&worker.scenario));
        ui.horizontal(|ui| {
            ui.label("Scenario");
            egui::ComboBox::from_id_salt("scenario")
                .selected_text(current)
                .show_ui(ui, |ui| {
                    for path in scenarios {
                        if ui.selectable_label(false, short(path)).clicked() {
                            self.open = Some(path.clone());
                        }
                    }
                })
                .response
                .named("Scenario");
        });
    }

    fn moves(&mut self, ui: &mut Ui, session: &Session, worker: &SimWorker) {
        ui.horizontal_wrapped(|ui| {
            let [x, y, degrees] = &mut self.kidnap;
            ui.add(
                egui::DragValue::new(x)
                    .speed(0.05)
                    .prefix("x ")
                    .suffix(" m"),
            )
            .named("kidnapped to x");
            ui.add(
                egui::DragValue::new(y)
                    .speed(0.05)
                    .prefix("y ")
                    .suffix(" m"),
            )
            .named("kidnapped to y");
            ui.add(egui::DragValue::new(degrees).suffix("°"))
                .named("kidnapped to heading");
            if ui.button("Kidnap").clicked() {
                worker.order(Order::Kidnap(Pose::new(*x, *y, degrees.to_radians())));
            }
        });
        ui.horizontal_wrapped(|ui| {
            ui.add(egui::DragValue::new(&mut self.push).suffix(" N s"))
                .named("strength of the push");
            ui.add(egui::DragValue::new(&mut self.push_deg).suffix("°"))
                .named("direction of the push");
            if ui.button("Push").clicked() {
                let (sin, cos) = self.push_deg.to_radians().sin_cos();
                worker.order(Order::Push([self.push * cos, self.push * sin]));
            }
        });
        ui.horizontal_wrapped(|ui| {
            ui.add(
                egui::DragValue::new(&mut self.kick)
                    .speed(0.1)
                    .suffix(" m/s"),
            )
            .named("speed of the kick");
            ui.add(egui::DragValue::new(&mut self.kick_deg).suffix("°"))
                .named("direction of the kick");
            let now = session.now.as_ref();
            let truth = now.and_then(|now| now.cycle.inputs.truth.as_ref());
            let ball = truth.and_then(|truth| truth.ball);
            let button = ui.add_enabled(ball.is_some(), egui::Button::new("Kick"));
            if let (true, Some(at)) = (button.clicked(), ball) {
                let (sin, cos) = self.kick_deg.to_radians().sin_cos();
                worker.order(Order::Ball(at, [self.kick * cos, self.kick * sin]));
            }
        });
    }

    fn light(&mut self, ui: &mut Ui, worker: &SimWorker, film: sim::film::FilmConfig) {
        let mut own = self.light.is_some();
        ui.horizontal(|ui| {
            let switched = ui.checkbox(&mut own, "Light by hand").changed();
            if switched {
                self.light = own.then_some(1.0);
            }
            if let Some(level) = &mut self.light {
                let slider = egui::Slider::new(level, 0.02..=4.0).logarithmic(true);
                if ui.add(slider).named("light").changed() || switched {
                    worker.order(Order::Light(Some(*level)));
                }
            } else if switched {
                worker.order(Order::Light(None));
            }
        });
        let mut changed = film;
        ui.horizontal_wrapped(|ui| {
            let exposure = egui::Slider::new(&mut changed.exposure, 0.05..=8.0);
            ui.add(exposure.logarithmic(true).text("exposure"));
            let gain = egui::Slider::new(&mut changed.gain, 0.25..=8.0);
            ui.add(gain.logarithmic(true).text("gain"));
        });
        ui.horizontal_wrapped(|ui| {
            ui.label("white balance");
            for (gain, channel) in changed
                .white_balance
                .iter_mut()
                .zip(["red", "green", "blue"])
            {
                ui.add(egui::DragValue::new(gain).speed(0.01).range(0.2..=4.0))
                    .named(channel);
            }
        });
        if changed != film {
            worker.order(Order::Film(changed));
        }
        ui.horizontal(|ui| {
            let mut hangs = self.occlusion.is_some();
            let mut changed = ui.checkbox(&mut hangs, "Occlusion").changed();
            if changed {
                self.occlusion = hangs.then_some((0.0, 90.0));
            }
            if let Some((middle, width)) = &mut self.occlusion {
                let middle = egui::DragValue::new(middle).suffix("°").prefix("at ");
                changed |= ui.add(middle).named("middle of the occlusion").changed();
                let width = egui::DragValue::new(width).suffix("°").prefix("wide ");
                changed |= ui
                    .add(width.range(0.0..=360.0))
                    .named("width of the occlusion")
                    .changed();
            }
            if changed {
                worker.order(Order::Occlude(self.occlusion));
            }
        });
    }

    fn failures(&mut self, ui: &mut Ui, worker: &SimWorker) {
        ui.strong("Faults");
        ui.horizontal_wrapped(|ui| {
            for ((kind, name), fails) in FAULTS.into_iter().zip(&mut self.faults) {
                if ui.checkbox(fails, name).changed() {
                    worker.order(Order::Fault(kind, self.wheel, *fails));
                }
            }
            ui.add(
                egui::DragValue::new(&mut self.wheel)
                    .range(0..=3)
                    .prefix("wheel "),
            )
            .named("wheel that fails");
        });
    }

    /// Drives with W, A, S, D and Q, E while switched on.
    fn hand(&mut self, ui: &mut Ui, worker: &SimWorker) {
        let text = "Drive by hand (W A S D, turn with Q E)";
        let switched = ui.checkbox(&mut self.by_hand, text).changed();
        if switched && !self.by_hand {
            worker.order(Order::Drive(None));
        }
        if !self.by_hand || ui.ctx().egui_wants_keyboard_input() {
            return;
        }
        let held = |key| ui.input(|input| input.key_down(key));
        let axis = |more, less| f32::from(u8::from(held(more))) - f32::from(u8::from(held(less)));
        worker.order(Order::Drive(Some(Twist {
            x: HAND_SPEED * axis(egui::Key::W, egui::Key::S),
            y: HAND_SPEED * axis(egui::Key::A, egui::Key::D),
            theta: HAND_TURN * axis(egui::Key::Q, egui::Key::E),
        })));
        ui.request_repaint();
    }
}
